/** Scaling and inverse transforms of a block (ITU-T H.265, 8.6.3 and 8.6.4), for samples of 8 bits. */

import type { Residual } from "./residual.js";

const LEVEL_SCALE = [40, 45, 51, 57, 64, 72];
const FIRST_SHIFT = 7;
const SECOND_SHIFT = 12;
/** Left shift of sample differences in blocks without a transform. */
const SKIP_SHIFT = 7;

/** 64 √2 cos(π i / 64), rounded as in the standard; 64 for i = 0. */
const COSINES = [64, 90, 90, 90, 89, 88, 87, 85, 83, 82, 80, 78, 75, 73, 70, 67, 64, 61, 57, 54, 50, 46, 43, 38, 36, 31, 25, 22, 18, 13, 9, 4, 0];
const SINES = Int32Array.of(29, 55, 74, 84, 74, 74, 0, -74, 84, -29, -74, 55, 55, -84, 74, -29);

function cosine(angle: number): number {
  const folded = angle % 128 > 64 ? 128 - (angle % 128) : angle % 128;
  return folded > 32 ? -COSINES[64 - folded]! : COSINES[folded]!;
}

/** Matrices [k · size + n] of the cosine transforms of 4, 8, 16 and 32 values. */
const MATRICES = [4, 8, 16, 32].map((size) => Int32Array.from({ length: size * size }, (_, i) => cosine(Math.floor(i / size) * (32 / size) * (2 * (i % size) + 1))));

function clip16(value: number): number {
  return value < -32768 ? -32768 : value > 32767 ? 32767 : value;
}

/** Turns quantised coefficients into sample differences, in place. */
export function inverse(values: Int32Array, log2: number, qp: number, isSine: boolean, { isSkipped, columns, rows }: Residual): void {
  const scale = 16 * LEVEL_SCALE[qp % 6]! * 2 ** Math.floor(qp / 6);
  const unit = 2 ** (log2 + 3);
  for (let y = 0; y <= rows; y++) {
    for (let x = 0; x <= columns; x++) {
      const at = (y << log2) + x;
      if (values[at]) values[at] = clip16(Math.floor((values[at]! * scale + unit / 2) / unit));
    }
  }
  if (isSkipped) for (let i = 0; i < values.length; i++) values[i] = ((values[i]! << SKIP_SHIFT) + (1 << (SECOND_SHIFT - 1))) >> SECOND_SHIFT;
  else transform(values, 1 << log2, isSine ? SINES : MATRICES[log2 - 2]!, columns, rows);
}

function transform(values: Int32Array, size: number, matrix: Int32Array, columns: number, rows: number): void {
  const sums = new Int32Array(size);
  for (let x = 0; x <= columns; x++) {
    sums.fill(1 << (FIRST_SHIFT - 1));
    for (let k = 0; k <= rows; k++) {
      const value = values[k * size + x]!;
      if (value) for (let n = 0; n < size; n++) sums[n]! += value * matrix[k * size + n]!;
    }
    for (let n = 0; n < size; n++) values[n * size + x] = clip16(sums[n]! >> FIRST_SHIFT);
  }
  for (let y = 0; y < size; y++) {
    sums.fill(1 << (SECOND_SHIFT - 1));
    for (let k = 0; k <= columns; k++) {
      const value = values[y * size + k]!;
      if (value) for (let n = 0; n < size; n++) sums[n]! += value * matrix[k * size + n]!;
    }
    for (let n = 0; n < size; n++) values[y * size + n] = clip16(sums[n]! >> SECOND_SHIFT);
  }
}
