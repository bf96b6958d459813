/** Points outside all bodies, in cells of a centimetre (docs/payloads/bodycast.md, "Outliers"). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegers } from "../../integers/read.js";
import { clip8 } from "../../numbers.js";
import { AdaptiveBits } from "./adaptive.js";
import { type Cloud, checkCounts } from "./cloud.js";
import { OctreeCounts, readOctree } from "./octree.js";

const CELL_M = 0.01;
const DEPTH = 13;
const ORIGIN = 2 ** (DEPTH - 1);
const COLOUR_STEP = 12;

/** The outliers of each frame of a chunk. Throws Corrupt. */
export function readOutliers(data: Uint8Array, frames: number, coloured: boolean): Cloud[] {
  if (data.length === 0) return Array.from({ length: frames }, () => ({ positions: new Float64Array(0) }));
  const part = new Bytes(data, "bodycast: outliers");
  const [countBytes, octreeBytes] = [part.varint(), part.varint()];
  const counts = [...readIntegers(part.take(countBytes), frames, 1)];
  check(counts.every((count) => count >= 0), "bodycast: outliers: a count is negative");
  checkCounts(counts, data.length);
  const bits = new AdaptiveBits(part.take(octreeBytes));
  const octrees = new OctreeCounts();
  const places = counts.map((count) => (count ? readOctree(bits, octrees, count, DEPTH) : new Int32Array(0)));
  bits.raw(0);
  const total = counts.reduce((sum, count) => sum + count, 0);
  const differences = coloured ? readIntegers(part.rest(), total, 3) : null;
  let first = 0;
  return places.map((cells) => {
    const cloud: Cloud = { positions: Float64Array.from(cells, (cell) => (cell - ORIGIN) * CELL_M) };
    if (differences) {
      const sums = [0, 0, 0];
      cloud.colours = Uint8Array.from(cells, (_, i) => clip8(COLOUR_STEP * (sums[i % 3]! += differences[first + i]!) + COLOUR_STEP / 2));
      first += cells.length;
    }
    return cloud;
  });
}
