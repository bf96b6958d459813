/** Intra prediction of a block (ITU-T H.265, 8.4.4.2). */

import { clip8 } from "../numbers.js";

export const PLANAR = 0;
export const MEAN = 1;
export const ACROSS = 10;
export const DOWN = 26;
/** First mode that predicts downwards; earlier angular modes predict across. */
const FIRST_DOWN = 18;

/** Table 8-5, from mode 2 on. */
const ANGLES = [32, 26, 21, 17, 13, 9, 5, 2, 0, -2, -5, -9, -13, -17, -21, -26, -32, -26, -21, -17, -13, -9, -5, -2, 0, 2, 5, 9, 13, 17, 21, 26, 32];
/** Table 8-6, from mode 11 on. */
const INVERSE_ANGLES = [-4096, -1638, -910, -630, -482, -390, -315, -256, -315, -390, -482, -630, -910, -1638, -4096];
/** Neighbours are smoothed if a mode is farther than this from across and down, by log₂ of the block size. */
const SMOOTHED_FROM = [Infinity, Infinity, Infinity, 7, 1, 0];
const FLAT = 8;
const LARGE = 32;

/** One plane of samples, and a mask of its decoded 4 × 4 blocks. */
export interface Plane {
  width: number;
  height: number;
  samples: Uint8Array;
  isDecoded: Uint8Array;
}

/** Writes the predicted samples of the block at (x, y) of 2^log2 × 2^log2. */
export function predict(plane: Plane, x: number, y: number, log2: number, mode: number, isLuma: boolean, hasStrongSmoothing: boolean): void {
  const size = 1 << log2;
  const beside = smoothed(neighbours(plane, x, y, size), size, log2, mode, isLuma && hasStrongSmoothing);
  const { samples, width } = plane;
  const at = y * width + x;
  const isEdged = isLuma && size < LARGE;
  if (mode === PLANAR) planar(samples, width, at, beside, size, log2);
  else if (mode === MEAN) mean(samples, width, at, beside, size, log2, isEdged);
  else angular(samples, width, at, beside, size, mode, isEdged);
}

/** Neighbour samples: from the lowest at the left up to the corner (index 2 · size), then to the right. */
function neighbours({ width, height, samples, isDecoded }: Plane, x: number, y: number, size: number): Int32Array {
  const corner = 2 * size;
  const values = new Int32Array(4 * size + 1).fill(-1);
  const blocks = width >> 2;
  const has = (px: number, py: number) => px >= 0 && py >= 0 && px < width && py < height && isDecoded[(py >> 2) * blocks + (px >> 2)] === 1;
  for (let i = 0; i < corner; i += 4) {
    if (has(x - 1, y + i)) for (let j = i; j < i + 4; j++) values[corner - 1 - j] = samples[(y + j) * width + x - 1]!;
    if (has(x + i, y - 1)) for (let j = i; j < i + 4; j++) values[corner + 1 + j] = samples[(y - 1) * width + x + j]!;
  }
  if (has(x - 1, y - 1)) values[corner] = samples[(y - 1) * width + x - 1]!;
  const first = values.find((value) => value >= 0) ?? 128;
  let last = first;
  for (let i = 0; i < values.length; i++) {
    if (values[i]! < 0) values[i] = last;
    last = values[i]!;
  }
  return values;
}

function smoothed(values: Int32Array, size: number, log2: number, mode: number, mayBeStrong: boolean): Int32Array {
  if (mode === MEAN || Math.min(Math.abs(mode - DOWN), Math.abs(mode - ACROSS)) <= SMOOTHED_FROM[log2]!) return values;
  const corner = 2 * size;
  const end = 4 * size;
  const [low, middle, high] = [values[0]!, values[corner]!, values[end]!];
  const out = values.slice();
  const isFlat = (outer: number, half: number) => Math.abs(middle + outer - 2 * half) < FLAT;
  if (mayBeStrong && size === LARGE && isFlat(high, values[corner + size]!) && isFlat(low, values[corner - size]!)) {
    for (let i = 1; i < corner; i++) {
      out[corner - i] = ((64 - i) * middle + i * low + 32) >> 6;
      out[corner + i] = ((64 - i) * middle + i * high + 32) >> 6;
    }
  } else for (let i = 1; i < end; i++) out[i] = (values[i - 1]! + 2 * values[i]! + values[i + 1]! + 2) >> 2;
  return out;
}

function planar(samples: Uint8Array, width: number, at: number, beside: Int32Array, size: number, log2: number): void {
  const corner = 2 * size;
  const right = beside[corner + 1 + size]!;
  const below = beside[corner - 1 - size]!;
  for (let y = 0; y < size; y++) {
    const left = beside[corner - 1 - y]!;
    for (let x = 0; x < size; x++) {
      const above = beside[corner + 1 + x]!;
      samples[at + y * width + x] = ((size - 1 - x) * left + (x + 1) * right + (size - 1 - y) * above + (y + 1) * below + size) >> (log2 + 1);
    }
  }
}

function mean(samples: Uint8Array, width: number, at: number, beside: Int32Array, size: number, log2: number, isEdged: boolean): void {
  const corner = 2 * size;
  let sum = size;
  for (let i = 1; i <= size; i++) sum += beside[corner - i]! + beside[corner + i]!;
  const value = sum >> (log2 + 1);
  for (let y = 0; y < size; y++) samples.fill(value, at + y * width, at + y * width + size);
  if (!isEdged) return;
  for (let i = 1; i < size; i++) {
    samples[at + i] = (beside[corner + 1 + i]! + 3 * value + 2) >> 2;
    samples[at + i * width] = (beside[corner - 1 - i]! + 3 * value + 2) >> 2;
  }
  samples[at] = (beside[corner - 1]! + 2 * value + beside[corner + 1]! + 2) >> 2;
}

function angular(samples: Uint8Array, width: number, at: number, beside: Int32Array, size: number, mode: number, isEdged: boolean): void {
  const corner = 2 * size;
  const isDown = mode >= FIRST_DOWN;
  const way = isDown ? 1 : -1;
  const angle = ANGLES[mode - 2]!;
  // reference[size + i]: the neighbour i − 1 steps along the mode's main side
  const reference = new Int32Array(3 * size + 1);
  for (let i = 0; i <= 2 * size; i++) reference[size + i] = beside[corner + way * i]!;
  const least = (size * angle) >> 5;
  if (angle < 0 && least < -1) {
    const inverse = INVERSE_ANGLES[mode - 11]!;
    for (let i = least; i <= -1; i++) reference[size + i] = beside[corner - way * ((i * inverse + 128) >> 8)]!;
  }
  const [along, across] = isDown ? [1, width] : [width, 1];
  for (let j = 0; j < size; j++) {
    const whole = ((j + 1) * angle) >> 5;
    const part = ((j + 1) * angle) & 31;
    for (let i = 0; i < size; i++) {
      const k = size + i + whole + 1;
      const value = part ? ((32 - part) * reference[k]! + part * reference[k + 1]! + 16) >> 5 : reference[k]!;
      samples[at + i * along + j * across] = value;
    }
  }
  if (angle !== 0 || !isEdged) return;
  const [first, start] = [reference[size + 1]!, beside[corner]!];
  for (let j = 0; j < size; j++) samples[at + j * across] = clip8(first + ((beside[corner - way * (j + 1)]! - start) >> 1));
}
