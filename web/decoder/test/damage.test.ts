/** Damaged and forged files: named errors, no hang, no other exception. */

import { describe, expect, test } from "vitest";
import { MocodecError, type MoczFile, Truncated, open } from "../src/index.js";
import { crc32 } from "../src/bytes.js";
import { goldenBytes, goldenNames, priors } from "./golden.js";

const FILES = goldenNames();
const LIMIT_MS = 120_000;

async function everything(bytes: Uint8Array, salvage = false): Promise<MoczFile> {
  const file = await open(bytes, { priors, salvage });
  if (file.info.kind === "clouds") await file.poses();
  else await file.frames();
  const { signals } = await file.extras();
  for (const signal of signals) await signal.read();
  return file;
}

/** The MocodecError of decoding the whole file, or undefined. Throws any other exception. */
async function errorOf(bytes: Uint8Array, salvage = false): Promise<MocodecError | undefined> {
  try {
    await everything(bytes, salvage);
    return undefined;
  } catch (error) {
    if (error instanceof MocodecError) return error;
    throw error;
  }
}

/** Pseudo-random numbers below `limit`, equal in every run. */
function numbers(seed: number): (limit: number) => number {
  let state = seed >>> 0;
  return (limit) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * limit);
  };
}

function sign(bytes: Uint8Array, start: number, end: number): void {
  new DataView(bytes.buffer, bytes.byteOffset).setUint32(end - 4, crc32(bytes.subarray(start, end - 4)), true);
}

/** Fewer trials for files with slow models. */
function times(name: string, count: number): number {
  return name.includes("markers-on-bones") || name.includes("matched") ? Math.ceil(count / 8) : count;
}

describe("damaged files", { timeout: LIMIT_MS }, () => {
  test.each(FILES)("%s: prefixes", async (name) => {
    const bytes = goldenBytes(name);
    const step = Math.max(1, Math.floor(bytes.length / 60));
    for (let size = 0; size < bytes.length; size += step) expect(await errorOf(bytes.slice(0, size)), `${size} bytes`).toBeInstanceOf(MocodecError);
    expect(await errorOf(bytes.slice(0, -1))).toBeInstanceOf(Truncated);
  });

  test.each(FILES)("%s: flipped bytes", async (name) => {
    const bytes = goldenBytes(name);
    const next = numbers(1);
    for (let n = 0; n < times(name, 40); n++) {
      const damaged = bytes.slice();
      damaged[next(bytes.length)]! ^= 1 + next(255);
      expect(await errorOf(damaged)).toBeInstanceOf(MocodecError);
      await errorOf(damaged, true);
    }
  });

  test.each(FILES)("%s: forged bytes", async (name) => {
    const bytes = goldenBytes(name);
    const { info } = await open(bytes);
    const headerEnd = info.chunks[0]!.offset - (info.extras.section ? info.extras.section + 4 : 0) - info.extras.signals;
    const next = numbers(2);
    for (let n = 0; n < times(name, 60); n++) {
      const forged = bytes.slice();
      const chunk = info.chunks[next(info.chunks.length)]!;
      const [start, end] = n % 2 ? [chunk.offset, chunk.offset + chunk.size] : [0, headerEnd];
      for (let k = 1 + next(3); k > 0; k--) forged[start + next(end - start - 4)] = next(256);
      sign(forged, start, end);
      await errorOf(forged);
    }
  });
});
