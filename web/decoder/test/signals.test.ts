import { describe, expect, test } from "vitest";
import { open } from "../src/index.js";
import { goldenBytes, goldenNames, goldenTwin } from "./golden.js";

const WITH_SIGNALS = goldenNames().filter((name) => goldenTwin(name).signals);

describe("signals of golden files", () => {
  test.each(WITH_SIGNALS)("%s", async (name) => {
    const file = await open(goldenBytes(name));
    const { signals } = await file.extras();
    const twins = goldenTwin(name).signals!;
    expect(signals.map((signal) => signal.path).sort()).toEqual(Object.keys(twins).sort());
    for (const signal of signals) {
      const { values, ...facts } = twins[signal.path]!;
      expect(signal).toMatchObject(facts);
      const wanted = (values as unknown[]).flat(Infinity).map(Number);
      const found = Array.from(await signal.read());
      expect(found.length).toBe(wanted.length);
      expect(found.every((v, i) => Object.is(v, wanted[i]))).toBe(true);
      const channels = found.length / signal.shape[0]!;
      const [a, b] = [Math.floor(signal.shape[0]! / 3), Math.floor(signal.shape[0]! / 2)];
      expect(Array.from(await signal.read(a, b))).toEqual(found.slice(a * channels, b * channels));
    }
  });
});
