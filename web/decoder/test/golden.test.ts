import { describe, expect, test } from "vitest";
import { open } from "../src/index.js";
import { goldenBytes, goldenNames, goldenTwin, priors } from "./golden.js";

const CLOUDS = new Set(["lien2006", "bodycast"]);
const MOTIONS = goldenNames().filter((name) => !CLOUDS.has(goldenTwin(name).codec));
/** The twins have ten decimals. */
const TOLERANCE_M = 1e-9;
/** Angles at stretched bones are square roots of rounding errors. */
const TOLERANCE_OF_ROTATIONS = 1e-7;

describe("golden files decode to their twins", () => {
  test.each(MOTIONS)("%s", async (name) => {
    const twin = goldenTwin(name);
    const file = await open(goldenBytes(name), { priors });
    expect(file.info).toMatchObject({ codec: twin.codec, rate: twin.rate, up: twin.up, names: twin.names, frames: twin.positions.length });
    const positions = await file.frames();
    expect(positions.length).toBe(3 * twin.names.length * twin.positions.length);
    let largest = 0;
    twin.positions.forEach((frame, t) => {
      frame.forEach((point, p) => {
        const at = 3 * (t * twin.names.length + p);
        if (point === null) return expect(Number.isNaN(positions[at])).toBe(true);
        for (let c = 0; c < 3; c++) {
          const error = Math.abs(positions[at + c]! - point[c]!);
          if (!(error <= largest)) largest = error;
        }
      });
    });
    expect(largest).toBeLessThanOrEqual(TOLERANCE_M);
    if (!twin.rotations) return expect(file.info.rotations).toBe(false);
    const rotations = await file.rotations();
    const wanted = twin.rotations.flat(2);
    expect(rotations.length).toBe(wanted.length);
    expect(Math.max(...wanted.map((v, i) => Math.abs(v - rotations[i]!)))).toBeLessThanOrEqual(TOLERANCE_OF_ROTATIONS);
  });
});
