/** Colours of points on a lattice (docs/payloads/bodycast-points.md, "Colours"). */

import { clip } from "../../numbers.js";
import type { MixedBits } from "./mixed.js";

const STRIDES = [0, 32, 16, 8, 4, 2, 1];
const FIRST_STRIDE = 64;
const GREY = [128, 0, 0] as const;
const SEARCHED = 16;
const AVERAGED = 4;
const EDGES = [1, 2, 3, 5, 8, 12, 18, 28];
const CLASSES = [1, 2, 4, 8, 16];
const KINDS = 37;
const NEGATIVE = 1;
const FIRST_DIGIT = 26;
const MOST_UNARY = 24;
const DIGITS = 11;
const FULL_SHARE = 16;

function atMost(edges: readonly number[], value: number): number {
  let count = 0;
  while (count < edges.length && edges[count]! <= value) count++;
  return count;
}

/** Numbers of the points of a pass, out of `count`. */
function pass(count: number, stride: number): number[] {
  const rows: number[] = [];
  for (let i = stride; i < count; i += stride ? 2 * stride : FIRST_STRIDE) rows.push(i);
  return rows;
}

/** Reads a value for each row, bit by bit across rows; bit(i, kind) reads one bit for row i. */
export function readValues(rows: number[], bit: (i: number, kind: number) => number): Int32Array {
  const values = new Int32Array(rows.length);
  let some = rows.flatMap((row, k) => {
    values[k] = bit(row, 0);
    return values[k] ? [k] : [];
  });
  const negative = some.filter((k) => bit(rows[k]!, NEGATIVE));
  for (let size = 1; size <= MOST_UNARY; size++) {
    some = some.filter((k) => bit(rows[k]!, 1 + size));
    for (const k of some) values[k]!++;
  }
  for (let digit = 0; digit < DIGITS; digit++) for (const k of some) values[k]! += bit(rows[k]!, FIRST_DIGIT + digit) << digit;
  for (const k of negative) values[k] = -values[k]!;
  return values;
}

/** Decodes the colours of the frames of a chunk. */
export class Colours {
  private readonly shares = [8, 8, 8];
  private readonly first = [0, 0, 0];
  private readonly second = [0, 0, 0];

  /** steps: quantisation steps of Y, Co, Cg. */
  constructor(
    private readonly bits: MixedBits,
    private readonly steps: readonly [number, number, number],
  ) {}

  /** Y, Co, Cg (points, 3) of points at cells (points, 3). rows: not negative where a point has an expected colour. */
  frame(cells: Int32Array, rows: Int32Array, expected: Int32Array): Int32Array {
    const count = rows.length;
    const colours = new Int32Array(3 * count);
    const bases = new Int32Array(3 * count);
    STRIDES.forEach((stride, number) => {
      const own = pass(count, stride);
      // each (points of the pass, 3)
      const [corrections, activities, spreads] = [0, 1, 2].map(() => new Int32Array(3 * own.length)) as [Int32Array, Int32Array, Int32Array];
      own.forEach((i, k) => {
        const base = rows[i]! >= 0 ? expected.subarray(3 * i, 3 * i + 3) : GREY;
        bases.set(base, 3 * i);
        if (stride) this.around(i, k, stride, cells, rows[i]! >= 0, colours, bases, corrections, activities, spreads);
      });
      const coded = new Int32Array(own.length);
      for (let c = 0; c < 3; c++) {
        const values = this.channel(own, c, number, coded, activities, spreads);
        own.forEach((i, k) => {
          const correction = rows[i]! >= 0 ? (corrections[3 * k + c]! * this.shares[c]!) >> 4 : 0;
          colours[3 * i + c] = clip(bases[3 * i + c]! + correction + values[k]! * this.steps[c]!, -512, 511);
          coded[k] = Math.max(coded[k]!, atMost(CLASSES, Math.abs(values[k]!)));
          if (rows[i]! < 0) return;
          this.first[c]! += (colours[3 * i + c]! - bases[3 * i + c]!) * corrections[3 * k + c]!;
          this.second[c]! += corrections[3 * k + c]! ** 2;
        });
      }
    });
    for (let c = 0; c < 3; c++) {
      const [first, second] = [this.first[c]!, this.second[c]!];
      if (second > 0) this.shares[c] = clip(Math.floor((FULL_SHARE * first + Math.floor(second / 2)) / second), 0, FULL_SHARE);
      this.first[c] = Math.floor(first / 2);
      this.second[c] = Math.floor(second / 2);
    }
    return colours;
  }

  /** Sets correction, activity and spread of point i, the k-th of its pass, from its nearest decoded points; without a sample also
   * its base. */
  private around(
    i: number, k: number, stride: number, cells: Int32Array, hasSample: boolean,
    colours: Int32Array, bases: Int32Array, corrections: Int32Array, activities: Int32Array, spreads: Int32Array,
  ): void {
    const apart = 2 * stride;
    const known = Math.ceil(cells.length / 3 / apart);
    const searched = Math.min(SEARCHED, known);
    const start = clip(Math.floor(i / apart) - 7, 0, known - searched);
    const near: number[] = [];
    const squares: number[] = [];
    for (let n = start; n < start + searched; n++) {
      const j = n * apart;
      const [x, y, z] = [cells[3 * j]! - cells[3 * i]!, cells[3 * j + 1]! - cells[3 * i + 1]!, cells[3 * j + 2]! - cells[3 * i + 2]!];
      const square = x * x + y * y + z * z;
      if (near.length === AVERAGED && square >= squares[AVERAGED - 1]!) continue;
      let at = near.length < AVERAGED ? near.length : AVERAGED - 1;
      for (; at > 0 && squares[at - 1]! > square; at--) [near[at], squares[at]] = [near[at - 1]!, squares[at - 1]!];
      [near[at], squares[at]] = [j, square];
    }
    const weights = squares.map((square) => Math.max(Math.floor(2 ** 20 / (square + 2)), 1));
    const total = weights.reduce((sum, weight) => sum + weight, 0);
    for (let c = 0; c < 3; c++) {
      const mean = (value: (j: number) => number) => Math.floor(near.reduce((sum, j, n) => sum + weights[n]! * value(j), 0) / total);
      const middle = mean((j) => colours[3 * j + c]!);
      const error = (j: number) => colours[3 * j + c]! - bases[3 * j + c]!;
      corrections[3 * k + c] = mean(error);
      activities[3 * k + c] = mean((j) => Math.abs(error(j)));
      spreads[3 * k + c] = near.reduce((most, j) => Math.max(most, Math.abs(colours[3 * j + c]! - middle)), 0);
      if (!hasSample) bases[3 * i + c] = middle;
    }
  }

  /** Reads the values of a channel in a pass. coded: classes of the magnitudes in earlier channels. */
  private channel(own: number[], c: number, number: number, coded: Int32Array, activities: Int32Array, spreads: Int32Array): Int32Array {
    const step = this.steps[c]!;
    const a = own.map((_, k) => atMost(EDGES, Math.floor((2 * activities[3 * k + c]!) / step)));
    const r = own.map((_, k) => atMost(EDGES, Math.floor(spreads[3 * k + c]! / step)));
    const known = Int32Array.from(coded);
    return readValues([...own.keys()], (k, kind) => {
      const b = c * KINDS + kind;
      const [activity, spread, class_] = [a[k]!, r[k]!, known[k]!];
      return this.bits.bit(
        b * 9 + activity,
        b * 6 + class_,
        (b * 9 + spread) * 7 + number,
        (b * 9 + activity) * 6 + class_,
        (b * 9 + spread) * 9 + activity,
        b * 6 + class_,
      );
    });
  }
}

/** Colours of a frame of kind 3, predicted by the atlas (points, 3); grey for negative rows. */
export function readTexturedColours(bits: MixedBits, rows: Int32Array, atlas: Int32Array, step: number): Int32Array {
  const count = rows.length;
  const values = new Int32Array(3 * count);
  STRIDES.forEach((stride, number) => {
    const own = pass(count, stride);
    const coded = new Int32Array(own.length);
    for (let c = 0; c < 3; c++) {
      const before = own.map((i) => (stride ? values[3 * (i - stride) + c]! : 0));
      const behind = own.map((i, k) => (!stride ? 0 : i + stride < count ? values[3 * (i + stride) + c]! : before[k]!));
      const differences = readValues([...own.keys()], (k, kind) => {
        const base = c * KINDS + kind;
        const apart = atMost(CLASSES, Math.abs(before[k]! - behind[k]!));
        const large = atMost(CLASSES, Math.abs(before[k]!) + Math.abs(behind[k]!));
        const class_ = coded[k]!;
        return bits.bit(base * 6 + apart, base * 6 + class_, base * 7 + number, (base * 6 + apart) * 6 + class_, (base * 6 + large) * 6 + class_, base);
      });
      own.forEach((i, k) => {
        values[3 * i + c] = differences[k]! + ((before[k]! + behind[k]!) >> 1);
        coded[k] = Math.max(coded[k]!, atMost(CLASSES, Math.abs(differences[k]!)));
      });
    }
  });
  return values.map((value, i) => {
    const row = rows[Math.floor(i / 3)]!;
    return (row < 0 ? GREY[i % 3]! : atlas[3 * row + (i % 3)]!) + value * step;
  });
}
