/** Arrays of coded integers (docs/payloads/integers.md). */

import { check } from "../errors.js";
import { manyStates } from "./many_states.js";
import { oneState } from "./one_state.js";
import { tokenOf } from "./tables.js";

const MOST_VALUES = 2 ** 24;

/**
 * Decodes an array (steps, lanes), row by row. Every value is an exact integer.
 *
 * contexts: one magnitude for each step, which the mixtures 7 to 9 need. Throws Corrupt.
 */
export function readIntegers(data: Uint8Array, steps: number, lanes: number, contexts?: ArrayLike<number>): Float64Array {
  check(steps * lanes <= MOST_VALUES, `coded integers: ${steps} × ${lanes} values`);
  if (data.length === 0) return new Float64Array(steps * lanes);
  check(steps * lanes > 0 && data.length >= 2, "coded integers: bytes for an empty array, or too few bytes");
  if (isSparse(data)) return sparse(data, steps * lanes);
  const hints = contexts ? Uint8Array.from({ length: steps }, (_, t) => tokenOf(contexts[t]!)) : null;
  const many = data.length >= 6 && ((data[0]! | (data[1]! << 8)) & 0x3fff) < 64;
  const { fields, part, lanes: width } = (many ? manyStates : oneState)(data, steps, lanes, hints);
  const height = part.length / width;
  const result = width === lanes && height === steps ? part : padded(part, height, width, steps, lanes);
  for (let order = 0; order < fields.order; order++) {
    for (let i = lanes; i < result.length; i++) result[i]! += result[i - lanes]!;
  }
  if (fields.order) for (const v of result) check(Number.isSafeInteger(v), "coded integers: a number is too large");
  return result;
}

/** `readIntegers` with limits for every value. */
export function readIntegersWithin(data: Uint8Array, steps: number, lanes: number, least: number, greatest: number, what: string): Float64Array {
  const values = readIntegers(data, steps, lanes);
  for (const v of values) check(v >= least && v <= greatest, `${what}: ${v} is out of range`);
  return values;
}

function isSparse(data: Uint8Array): boolean {
  return data[0] === 0 && data[1] === 0;
}

function padded(part: Float64Array, height: number, width: number, steps: number, lanes: number): Float64Array {
  const result = new Float64Array(steps * lanes);
  for (let t = 0; t < height; t++) result.set(part.subarray(t * width, t * width + width), t * lanes);
  return result;
}

function sparse(data: Uint8Array, size: number): Float64Array {
  check(data.length >= 8, "coded integers: the stream ends too early");
  const count = data[2]! | (data[3]! << 8) | (data[4]! << 16);
  const bytes = data[5]! | (data[6]! << 8) | (data[7]! << 16);
  check(count >= 1 && count <= size && 8 + bytes <= data.length, "coded integers: a field is out of range");
  const gapBytes = data.subarray(8, 8 + bytes);
  const valueBytes = data.subarray(8 + bytes);
  check(!isSparse(gapBytes) && !isSparse(valueBytes), "coded integers: a sparse array within another");
  const gaps = readIntegers(gapBytes, count, 1);
  const values = readIntegers(valueBytes, count, 1);
  const result = new Float64Array(size);
  let place = -1;
  for (let i = 0; i < count; i++) {
    check(gaps[i]! >= 1, "coded integers: a place is out of range");
    place += gaps[i]!;
    check(place < size, "coded integers: a place is out of range");
    result[place] = values[i]!;
  }
  return result;
}
