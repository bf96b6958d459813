import { describe, expect, test } from "vitest";
import { BodycastPoints } from "../src/codecs/clouds/bodycast.js";
import { type Header, payloadOf } from "../src/container/header.js";
import { MocodecError, open } from "../src/index.js";
import { goldenBytes, goldenTwin } from "./golden.js";

/** The twins have six decimals. */
const TOLERANCE_M = 0.6e-6;

describe("points match the twins", () => {
  const names = ["jumper", "jumper-bounded", "jumper-learned", "jumper-smoothed", "jumper-cubes", "covered", "exact", "exact-steps"].map((name) => `bodycast-${name}`);
  test.each([...names, "lien2006-jumper", "lien2006-lines"])("%s", async (name) => {
    const twin = goldenTwin(name) as unknown as { positions: number[][][]; colours: number[][][] };
    const file = await open(goldenBytes(name));
    let frame = 0;
    for await (const { positions, colours } of file.clouds()) {
      const wanted = twin.positions[frame]!.flat();
      expect(positions.length).toBe(wanted.length);
      expect(Math.max(...wanted.map((v, i) => Math.abs(v - positions[i]!)))).toBeLessThanOrEqual(TOLERANCE_M);
      expect([...colours!]).toEqual(twin.colours[frame]!.flat());
      frame++;
    }
    expect(frame).toBe(twin.positions.length);
    for await (const { positions } of file.clouds(1, 2)) expect(positions.length).toBe(twin.positions[1]!.flat().length);
  });
});

test("damaged chunks end in a named error or in points", async () => {
  const bytes = goldenBytes("bodycast-jumper-smoothed");
  const file = await open(bytes);
  const { header } = file as unknown as { header: Header };
  const decoder = new BodycastPoints(header.shared, true);
  const { offset, size, frames } = file.info.chunks[0]!;
  const payload = payloadOf(bytes.subarray(offset, offset + size), file.info.chunks[0]!, 0);
  let errors = 0;
  for (let i = 0; i < payload.length; i += 37) {
    const damaged = payload.slice();
    damaged[i]! ^= 1 << (i % 8);
    try {
      for (const { positions } of decoder.decode({ frames, payload: damaged })) expect(positions.length % 3).toBe(0);
    } catch (error) {
      errors++;
      expect(error).toBeInstanceOf(MocodecError);
    }
  }
  expect(errors).toBeGreaterThan(0);
}, 60_000);

test("bytes left after the repeats or colours of exact points are corrupt", async () => {
  const bytes = goldenBytes("bodycast-exact");
  const file = await open(bytes);
  const { header } = file as unknown as { header: Header };
  const { offset, size, frames } = file.info.chunks[0]!;
  const payload = payloadOf(bytes.subarray(offset, offset + size), file.info.chunks[0]!, 0);
  payload[5027]! ^= 1;
  expect(() => [...new BodycastPoints(header.shared, true).decode({ frames, payload })]).toThrow("left over");
});

test("with salvage, a damaged chunk has frames without points", async () => {
  const bytes = goldenBytes("bodycast-jumper-learned");
  const { offset, size } = (await open(bytes)).info.chunks[0]!;
  bytes[offset + Math.floor(size / 2)]! ^= 255;
  const file = await open(bytes, { salvage: true });
  const counts: number[] = [];
  for await (const { positions } of file.clouds()) counts.push(positions.length);
  expect(counts).toEqual([0, 0, 0]);
  expect(file.damage).toMatchObject([{ start: 0, frames: 3 }]);
});
