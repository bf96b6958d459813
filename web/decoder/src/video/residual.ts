/** Quantised coefficients of a transform block (ITU-T H.265, 7.3.8.11 and 9.3.4.2). */

import { check } from "../errors.js";
import { type Cabac, FIRST } from "./cabac.js";

/** Orders of coefficients: up-right diagonals, rows, columns. */
export const DIAGONAL = 0;
export const ROWS = 1;
export const COLUMNS = 2;
export type Scan = 0 | 1 | 2;

const MOST_PREFIX = 32;
const MOST_LEVEL = 32768;
/** Most flags "above one" in a 4 × 4 block. */
const FLAGS_ABOVE_ONE = 8;
/** Contexts of "significant" in 4 × 4 transform blocks, by position. */
const SMALL_CONTEXTS = [0, 1, 4, 5, 2, 3, 4, 5, 6, 6, 8, 8, 7, 7, 8];

/** Positions (x, y) in a square, in the order of a scan (6.5.3 to 6.5.5). */
function scanOrder(size: number, scan: Scan): Uint8Array {
  const places: [number, number][] = [];
  for (let y = 0; y < size; y++) for (let x = 0; x < size; x++) places.push([x, y]);
  if (scan === DIAGONAL) places.sort((a, b) => a[0] + a[1] - b[0] - b[1] || a[0] - b[0]);
  if (scan === COLUMNS) places.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  return Uint8Array.from(places.flat());
}

const ORDERS = [0, 1, 2, 3].map((log2) => ([DIAGONAL, ROWS, COLUMNS] as const).map((scan) => scanOrder(1 << log2, scan)));

export interface Residual {
  /** Whether the values are sample differences (transform skip), not coefficients. */
  isSkipped: boolean;
  /** Highest column with a value; `rows`: highest row. */
  columns: number;
  rows: number;
}

/** Reads a block of 2^log2 × 2^log2 into `out`, row by row. The caller fills `out` with 0. */
export function readResidual(cabac: Cabac, log2: number, plane: number, scan: Scan, options: { hidesSigns: boolean; skipsTransforms: boolean }, out: Int32Array): Residual {
  const isSkipped = options.skipsTransforms && log2 === 2 && cabac.bit(FIRST.skip + Number(plane > 0)) === 1;
  const [lastX, lastY] = readLast(cabac, log2, plane, scan);
  const blocks = ORDERS[log2 - 2]![scan]!;
  const places = ORDERS[2]![scan]!;
  const across = 1 << (log2 - 2);
  let block = 0;
  while (blocks[2 * block] !== lastX >> 2 || blocks[2 * block + 1] !== lastY >> 2) block++;
  let place = 0;
  while (places[2 * place] !== (lastX & 3) || places[2 * place + 1] !== (lastY & 3)) place++;
  const coded = new Uint8Array(across * across);
  const found = new Uint8Array(16);
  const found2 = { columns: 0, rows: 0 };
  let oneContext = 1;
  for (let i = block; i >= 0; i--) {
    const [bx, by] = [blocks[2 * i]!, blocks[2 * i + 1]!];
    const right = bx + 1 < across ? coded[by * across + bx + 1]! : 0;
    const below = by + 1 < across ? coded[(by + 1) * across + bx]! : 0;
    let mayInfer = i < block && i > 0;
    const isCoded = !mayInfer || cabac.bit(FIRST.codedBlock + (right | below) + (plane ? 2 : 0)) === 1;
    if (!isCoded) continue;
    coded[by * across + bx] = 1;
    let count = 0;
    let from = 15;
    if (i === block) {
      found[count++] = place;
      from = place - 1;
    }
    for (let n = from; n >= 0; n--) {
      if (n === 0 && mayInfer) {
        found[count++] = 0;
        break;
      }
      const [x, y] = [places[2 * n]!, places[2 * n + 1]!];
      if (cabac.bit(FIRST.significant + significantContext(log2, plane, scan, bx, by, x, y, right | (below << 1)))) {
        found[count++] = n;
        mayInfer = false;
      }
    }
    if (count === 0) continue;
    const set = (i === 0 || plane > 0 ? 0 : 2) + Number(i !== block && oneContext === 0);
    oneContext = readLevels(cabac, plane, set, found, count, options.hidesSigns, (n, level) => {
      const x = 4 * bx + places[2 * n]!;
      const y = 4 * by + places[2 * n + 1]!;
      found2.columns = Math.max(found2.columns, x);
      found2.rows = Math.max(found2.rows, y);
      out[(y << log2) + x] = level;
    });
  }
  return { isSkipped, ...found2 };
}

function readLast(cabac: Cabac, log2: number, plane: number, scan: Scan): [number, number] {
  const offset = plane ? 15 : 3 * (log2 - 2) + ((log2 - 1) >> 2);
  const shift = plane ? log2 - 2 : (log2 + 1) >> 2;
  const prefix = (first: number) => {
    let count = 0;
    while (count < 2 * log2 - 1 && cabac.bit(first + offset + (count >> shift))) count++;
    return count;
  };
  const suffix = (value: number) => (value > 3 ? (2 + (value & 1)) * 2 ** ((value >> 1) - 1) + cabac.number((value >> 1) - 1) : value);
  const [px, py] = [prefix(FIRST.lastX), prefix(FIRST.lastY)];
  const [x, y] = [suffix(px), suffix(py)];
  return scan === COLUMNS ? [y, x] : [x, y];
}

function significantContext(log2: number, plane: number, scan: Scan, bx: number, by: number, x: number, y: number, beside: number): number {
  let context: number;
  if (log2 === 2) context = SMALL_CONTEXTS[4 * y + x]!;
  else if (bx + by + x + y === 0) context = 0;
  else {
    if (beside === 0) context = x + y === 0 ? 2 : x + y < 3 ? 1 : 0;
    else if (beside === 1) context = y === 0 ? 2 : y === 1 ? 1 : 0;
    else if (beside === 2) context = x === 0 ? 2 : x === 1 ? 1 : 0;
    else context = 2;
    if (plane) context += log2 === 3 ? 9 : 12;
    else context += (bx + by > 0 ? 3 : 0) + (log2 === 3 ? (scan === DIAGONAL ? 9 : 15) : 21);
  }
  return plane ? 27 + context : context;
}

/** Reads the levels at the `count` significant positions `found` of a 4 × 4 block; returns the last context of "above one". */
function readLevels(cabac: Cabac, plane: number, set: number, found: Uint8Array, count: number, hidesSigns: boolean, put: (n: number, level: number) => void): number {
  const levels = new Array<number>(count).fill(1);
  let context = 1;
  let first = -1;
  for (let k = 0; k < Math.min(count, FLAGS_ABOVE_ONE); k++) {
    if (cabac.bit(FIRST.aboveOne + (plane ? 16 : 0) + 4 * set + context)) {
      levels[k] = 2;
      context = 0;
      if (first < 0) first = k;
    } else if (context > 0 && context < 3) context++;
  }
  if (first >= 0 && cabac.bit(FIRST.aboveTwo + (plane ? 4 : 0) + set)) levels[first] = 3;
  const isHidden = hidesSigns && found[0]! - found[count - 1]! > 3;
  const signs = count - Number(isHidden);
  const negative = cabac.number(signs) * 2 ** (count - signs);
  let rice = 0;
  let sum = 0;
  for (let k = 0; k < count; k++) {
    const most = k < FLAGS_ABOVE_ONE ? (k === first ? 3 : 2) : 1;
    if (levels[k] === most) {
      levels[k]! += readRemaining(cabac, rice);
      if (levels[k]! > 3 * (1 << rice)) rice = Math.min(rice + 1, 4);
    }
    const level = Math.min(levels[k]!, MOST_LEVEL);
    sum += level;
    let isNegative = ((negative >> (count - 1 - k)) & 1) === 1;
    if (isHidden && k === count - 1) isNegative = sum % 2 === 1;
    put(found[k]!, isNegative ? -level : level);
  }
  return context;
}

function readRemaining(cabac: Cabac, rice: number): number {
  const prefix = cabac.ones(MOST_PREFIX);
  check(prefix < MOST_PREFIX, "picture: a coefficient is too large");
  if (prefix <= 3) return prefix * 2 ** rice + cabac.number(rice);
  return (2 ** (prefix - 3) + 2) * 2 ** rice + cabac.number(prefix - 3 + rice);
}
