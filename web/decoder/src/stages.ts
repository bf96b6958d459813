/** Stages that several codecs share (docs/payloads/stages.md). */

import { Bytes } from "./bytes.js";
import { check } from "./errors.js";
import { readIntegers, readIntegersWithin } from "./integers/read.js";

/** Limit of the n k² steps that decoding a basis (n, k) takes: FREE_STEPS, plus STEPS_A_BYTE for each byte. */
const FREE_STEPS = 2 ** 28;
const STEPS_A_BYTE = 2 ** 14;

/** The quantisation step of a rung: 2^(rung / 64). */
export function stepOf(rung: number): number {
  return 2 ** (rung / 64);
}

interface FrozenRun {
  point: number;
  frame: number;
  frames: number;
  /** Index of the run's value, from 1; 0: the sample before the run. */
  value: number;
}

/** Missing samples of a chunk, and frozen runs, in which a point keeps one exact value. */
export class Gaps {
  private constructor(
    private readonly frames: number,
    private readonly points: number,
    /** (frames, points): 1 where a sample is missing; null: no gaps. */
    private readonly missing: Uint8Array | null,
    private readonly runs: FrozenRun[],
    private readonly values: Float64Array,
  ) {}

  /** Reads the gap mask or frozen runs of a chunk. */
  static read(data: Uint8Array, frames: number, points: number): Gaps {
    if (data.length === 0 || data[0] !== 0) return new Gaps(frames, points, gapMask(data, frames, points), [], new Float64Array(0));
    const part = new Bytes(data, "frozen runs");
    part.varint();
    const maskBytes = part.varint();
    const count = part.varintWithin(1, frames * points, "the number of runs");
    const runBytes = part.varint();
    const missing = gapMask(part.take(maskBytes), frames, points);
    const numbers = readIntegersWithin(part.take(runBytes), count, 3, 0, frames * points, "frozen runs");
    const runs: FrozenRun[] = [];
    let at = 0;
    let largest = 0;
    for (let i = 0; i < count; i++) {
      at += numbers[3 * i]!;
      const run = { point: Math.floor(at / frames), frame: at % frames, frames: numbers[3 * i + 1]! + 1, value: numbers[3 * i + 2]! };
      check(run.point < points && run.frame + run.frames <= frames, "frozen runs: a run ends beyond its point");
      runs.push(run);
      at += run.frames;
      largest = Math.max(largest, run.value);
    }
    check(largest <= count, "frozen runs: a value that does not exist");
    return new Gaps(frames, points, missing, runs, frozenValues(part.rest(), largest));
  }

  /** (frames, points): 1 where a sample is missing or frozen; null: none. */
  apart(): Uint8Array | null {
    if (this.runs.length === 0) return this.missing;
    const mask = this.missing?.slice() ?? new Uint8Array(this.frames * this.points);
    for (const run of this.runs) for (let t = run.frame; t < run.frame + run.frames; t++) mask[t * this.points + run.point] = 1;
    return mask;
  }

  /** Writes NaN into gaps and exact values into frozen runs of positions (frames, points, 3). */
  restore(positions: Float64Array): void {
    if (this.missing) {
      this.missing.forEach((missing, i) => {
        if (missing) positions.fill(NaN, 3 * i, 3 * i + 3);
      });
    }
    const values = this.runs.map((run) => {
      if (run.value) return this.values.slice(3 * (run.value - 1), 3 * run.value);
      check(run.frame > 0, "frozen runs: no sample before a run");
      const before = 3 * ((run.frame - 1) * this.points + run.point);
      const value = positions.slice(before, before + 3);
      check(!Number.isNaN(value[0]!), "frozen runs: the sample before a run is missing");
      return value;
    });
    this.runs.forEach((run, i) => {
      for (let t = run.frame; t < run.frame + run.frames; t++) positions.set(values[i]!, 3 * (t * this.points + run.point));
    });
  }
}

function frozenValues(data: Uint8Array, count: number): Float64Array {
  const numbers = readIntegersWithin(data, count, 24, 0, 255, "frozen runs");
  const values = new Float64Array(new Uint8Array(numbers).buffer);
  check(values.every(Number.isFinite), "frozen runs: a value is not finite");
  return values;
}

function gapMask(data: Uint8Array, frames: number, points: number): Uint8Array | null {
  if (data.length === 0) return null;
  const part = new Bytes(data, "gap mask");
  const number = part.varint();
  const count = Math.floor(number / 2);
  const byFrame = number % 2 === 1;
  check(count >= 1 && count <= frames * points, "gap mask: the number of runs is out of range");
  const runs = readIntegers(part.rest(), count, 2);
  const mask = new Uint8Array(frames * points);
  let at = 0;
  for (let i = 0; i < runs.length; i++) {
    const length = runs[i]!;
    check(length >= (i === 0 ? 0 : 1) && at + length <= mask.length, "gap mask: a run is out of range");
    if (i % 2) for (let k = at; k < at + length; k++) mask[byFrame ? k : (k % frames) * points + Math.floor(k / frames)] = 1;
    at += length;
  }
  return mask;
}

/**
 * Reads an orthonormal basis (dimensions, components), row by row.
 *
 * alike: for each dimension, an earlier one that predicts it in the first columns, or −1; null: no prediction.
 */
export function readBasis(data: Uint8Array, dimensions: number, components: number, alike: Int32Array | null): Float64Array {
  check(components <= dimensions, "basis: more components than dimensions");
  const part = new Bytes(data, "basis");
  const leading = part.varintWithin(0, components, "the number of differences");
  check(alike !== null || leading === 0, "basis: differences without a prediction");
  check(dimensions * components ** 2 <= FREE_STEPS + STEPS_A_BYTE * part.left, "basis: too large for its number of bytes");
  const entries = readIntegers(part.rest(), dimensions, components);
  for (let r = 0; alike && r < dimensions; r++) {
    const other = alike[r]!;
    if (other >= 0) for (let c = 0; c < leading; c++) entries[r * components + c]! += entries[other * components + c]!;
  }
  const basis = new Float64Array(dimensions * components);
  for (let i = 0; i < components; i++) basis[i * components + i] = 1;
  const u = new Float64Array(dimensions);
  const product = new Float64Array(components);
  for (let i = components - 1; i >= 0; i--) {
    reflector(entries, components, i, u);
    product.fill(0);
    for (let r = i; r < dimensions; r++) {
      for (let c = i; c < components; c++) product[c]! += u[r]! * basis[r * components + c]!;
    }
    for (let r = i; r < dimensions; r++) {
      for (let c = i; c < components; c++) basis[r * components + c]! -= 2 * u[r]! * product[c]!;
    }
  }
  return basis;
}

/** Writes the unit vector of the Householder reflection in column `i` of the entries to rows i … of `u`. */
function reflector(entries: Float64Array, columns: number, i: number, u: Float64Array): void {
  const rows = entries.length / columns;
  let any = false;
  for (let r = i; r < rows; r++) {
    u[r] = entries[r * columns + i]!;
    any ||= u[r] !== 0;
  }
  if (!any || u[i]! > 0) {
    u.fill(0, i);
    u[i] = -1;
  }
  normalise(u, i);
  u[i]! -= 1;
  normalise(u, i);
}

function normalise(u: Float64Array, from: number): void {
  let square = 0;
  for (let r = from; r < u.length; r++) square += u[r]! * u[r]!;
  const length = Math.sqrt(square);
  for (let r = from; r < u.length; r++) u[r]! /= length;
}
