/** Frames stored point by point (docs/payloads/lien2006.md, "Raw frames"). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { inflateZlib } from "../../inflate.js";
import { type Cloud, checkCounts } from "./cloud.js";

export function readRawFrames(data: Uint8Array, frames: number, coloured: boolean): Cloud[] {
  if (frames === 0) return [];
  const part = new Bytes(data, "raw frames");
  const counts = Array.from({ length: frames }, () => part.varint());
  checkCounts(counts, data.length);
  const total = counts.reduce((sum, count) => sum + count, 0);
  const size = (coloured ? 15 : 12) * total;
  const content = new Bytes(inflateZlib(part.rest(), size), "raw frames");
  check(content.left === size, "raw frames have a wrong size");
  return counts.map((count) => {
    const bytes = content.take(12 * count);
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
    const cloud: Cloud = { positions: Float64Array.from({ length: 3 * count }, (_, i) => view.getFloat32(4 * i, true)) };
    if (coloured) cloud.colours = content.take(3 * count).slice();
    return cloud;
  });
}
