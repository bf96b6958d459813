/** Inter prediction of a part (ITU-T H.265, 8.5.3.3), for samples of 8 bits in 4:4:4. */

import type { Motion, Part } from "./motion.js";
import type { Weight } from "./slice.js";

/** Interpolation filters at quarter samples (tables 8-11 and 8-12), for luma and chroma. */
const LUMA = [[0, 0, 0, 64, 0, 0, 0, 0], [-1, 4, -10, 58, 17, -5, 1, 0], [-1, 4, -11, 40, 40, -11, 4, -1], [0, 1, -5, 17, 58, -10, 4, -1]];
const CHROMA = [[0, 64, 0, 0], [-4, 54, 16, -2], [-4, 36, 36, -4], [-2, 16, 54, -4]];
const LARGEST = 64;
const MOST_TAPS = 8;
/** Extra bits of filtered samples. */
const FINER = 6;

/** Buffers: lines filtered along x, and their source samples. */
const lines = new Int32Array(LARGEST * (LARGEST + MOST_TAPS));
const sources = new Uint8Array((LARGEST + MOST_TAPS) * (LARGEST + MOST_TAPS));

/** Writes the predicted samples of a part. plane: 0 is luma. */
export function predictFrom(source: Uint8Array, target: Uint8Array, plane: number, size: { width: number; height: number }, part: Part, motion: Motion, weight: Weight | null): void {
  const { x, y, width, height } = part;
  const filters = plane ? CHROMA : LUMA;
  const [across, down] = [filters[motion.x & 3]!, filters[motion.y & 3]!];
  const taps = across.length;
  const before = taps / 2 - 1;
  const stride = width + taps - 1;
  const rows = height + taps - 1;
  fetch(source, size.width, size.height, x + (motion.x >> 2) - before, y + (motion.y >> 2) - before, stride, rows);
  const [isMovedX, isMovedY] = [(motion.x & 3) > 0, (motion.y & 3) > 0];
  for (let row = 0; row < rows; row++) {
    for (let i = 0; i < width; i++) {
      const at = row * stride + i;
      let sum = 0;
      if (isMovedX) for (let k = 0; k < taps; k++) sum += across[k]! * sources[at + k]!;
      else sum = sources[at + before]! << FINER;
      lines[row * width + i] = sum;
    }
  }
  const { denominatorLog2, factor, offset } = weight ?? { denominatorLog2: 0, factor: 1, offset: 0 };
  const shift = denominatorLog2 + FINER;
  const half = 1 << (shift - 1);
  for (let row = 0; row < height; row++) {
    for (let i = 0; i < width; i++) {
      const at = row * width + i;
      let sum = 0;
      if (isMovedY) {
        for (let k = 0; k < taps; k++) sum += down[k]! * lines[at + k * width]!;
        sum >>= FINER;
      } else sum = lines[at + before * width]!;
      const value = ((sum * factor + half) >> shift) + offset;
      target[(y + row) * size.width + x + i] = value < 0 ? 0 : value > 255 ? 255 : value;
    }
  }
}

/** Copies samples to `sources`; beyond the edges it repeats the samples at the edges. */
function fetch(source: Uint8Array, width: number, height: number, left: number, top: number, columns: number, rows: number): void {
  for (let row = 0; row < rows; row++) {
    const from = width * Math.min(Math.max(top + row, 0), height - 1);
    for (let i = 0; i < columns; i++) sources[row * columns + i] = source[from + Math.min(Math.max(left + i, 0), width - 1)]!;
  }
}
