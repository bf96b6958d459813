/** Exact points of a chunk, as floats or on a grid (docs/payloads/bodycast.md, "Exact points"). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegers } from "../../integers/read.js";
import { AdaptiveBits } from "./adaptive.js";
import { type Cloud, checkCounts, rgbOf } from "./cloud.js";
import { OctreeCounts, readOctree } from "./octree.js";

export const FLOATS = 0;
const BINARY_STEP = 1;
const DECIMAL_STEP = 2;
const CELLS_IN_METRE = 1024;
const FLOAT_EXPONENT = -10;
const MOST_EXPONENT = 40;
const MOST_DEPTH = 20;
export const MOST_CELL = 2 ** 40;
const LOWEST_CELL_BITS = 31;
const MOST_FLOAT_BITS = 0x7f7fffff;
const NANOMETRE_M = 1e-9;

/** The points of all frames of a chunk. Throws Corrupt. */
export function readExact(data: Uint8Array, frames: number, coloured: boolean): Cloud[] {
  const part = new Bytes(data, "bodycast: exact points");
  const grid = readGrid(part);
  const { spacing } = grid;
  const depth = part.varintWithin(0, MOST_DEPTH, "the depth");
  const corner = [0, 1, 2].map(() => part.foldedWithin(-MOST_CELL, MOST_CELL, "the corner"));
  const counts = Array.from({ length: frames }, () => part.varint());
  checkCounts(counts, data.length);
  const filled = counts.filter((count) => count > 0);
  const stops = filled.map(() => part.varintWithin(0, depth, "the last level of an octree"));
  const [octreeBytes, floatBytes] = [part.varint(), part.varint()];
  const cells = readCells(part.take(octreeBytes), filled, stops, depth).map((value, i) => corner[i % 3]! + spacing * value);
  const positions = positionsOf(grid, cells, part.take(floatBytes));
  const total = cells.length / 3;
  const differences = coloured ? readIntegers(part.rest(), total, 3) : undefined;
  let at = 0;
  return counts.map((count) => {
    const [from, to] = [3 * at, 3 * (at + count)];
    at += count;
    const cloud: Cloud = { positions: positions.slice(from, to) };
    if (differences) cloud.colours = rgbOf(sumsOf(differences.slice(from, to)));
    return cloud;
  });
}

/** Coordinates of cells: floats, or multiples of 2^exponent metres or of nanometres. Cells are multiples of `spacing`. */
export interface Grid {
  kind: number;
  nanometres: number;
  exponent: number;
  spacing: number;
}

export function readGrid(part: Bytes): Grid {
  const kind = part.varintWithin(FLOATS, DECIMAL_STEP, "the kind");
  const nanometres = part.varint();
  const exponent = part.foldedWithin(-MOST_EXPONENT, MOST_EXPONENT, "the exponent");
  check(kind !== FLOATS || exponent === FLOAT_EXPONENT, "bodycast: exact points have a wrong exponent");
  return { kind, nanometres, exponent, spacing: part.varintWithin(1, MOST_CELL - 1, "the spacing") };
}

/** Positions of cells, metres. floatBits: low bits of floats. */
export function positionsOf({ kind, nanometres, exponent }: Grid, cells: Float64Array, floatBits: Uint8Array): Float64Array {
  if (kind === FLOATS) return floatsOf(cells, floatBits);
  const step = kind === BINARY_STEP ? 2 ** exponent : nanometres * NANOMETRE_M;
  return cells.map((cell) => cell * step);
}

/** Octree coordinates (points, 3) of all frames, below 2^depth. */
function readCells(data: Uint8Array, filled: number[], stops: number[], depth: number): Float64Array {
  const total = filled.reduce((sum, count) => sum + count, 0);
  const cells = new Float64Array(3 * total);
  if (total === 0) return cells;
  const bits = new AdaptiveBits(data);
  const counts = new OctreeCounts();
  let at = 0;
  filled.forEach((count, k) => {
    cells.set(readOctree(bits, counts, count, stops[k]!), at);
    at += 3 * count;
  });
  const raw = bits.raw(filled.reduce((sum, count, k) => sum + 3 * count * (depth - stops[k]!), 0));
  let next = 0;
  let point = 0;
  filled.forEach((count, k) => {
    for (let i = 0; i < count; i++, point++) {
      for (let digit = 0; digit < depth - stops[k]!; digit++) {
        for (let axis = 2; axis >= 0; axis--) cells[3 * point + axis] = 2 * cells[3 * point + axis]! + raw[next++]!;
      }
    }
  });
  return cells;
}

const AS_FLOAT = new Float32Array(1);
const AS_BITS = new Uint32Array(AS_FLOAT.buffer);

function bitsOfFloat(value: number): number {
  AS_FLOAT[0] = value;
  return AS_BITS[0]!;
}

function floatsOf(cells: Float64Array, data: Uint8Array): Float64Array {
  const positions = new Float64Array(cells.length);
  if (cells.length === 0) return positions;
  const starts = new Float64Array(cells.length);
  const widths = new Uint8Array(cells.length);
  let total = 0;
  cells.forEach((cell, i) => {
    check(Math.abs(cell) <= MOST_CELL, "bodycast: cells of exact points are out of range");
    const size = cell >= 0 ? cell : -cell - 1;
    starts[i] = bitsOfFloat(size / CELLS_IN_METRE);
    const patterns = Math.max(bitsOfFloat((size + 1) / CELLS_IN_METRE) - starts[i]!, 1);
    widths[i] = size === 0 ? LOWEST_CELL_BITS : Math.ceil(Math.log2(patterns));
    total += widths[i]!;
  });
  const raw = new AdaptiveBits(data).raw(total);
  let next = 0;
  cells.forEach((cell, i) => {
    let rest = 0;
    for (let k = 0; k < widths[i]!; k++) rest = 2 * rest + raw[next++]!;
    AS_BITS[0] = Math.min(starts[i]! + rest, MOST_FLOAT_BITS);
    positions[i] = cell < 0 ? -AS_FLOAT[0]! : AS_FLOAT[0]!;
  });
  return positions;
}

function sumsOf(differences: Float64Array): Float64Array {
  for (let i = 3; i < differences.length; i++) differences[i]! += differences[i - 3]!;
  return differences;
}
