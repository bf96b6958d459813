/** Models of tempo: bases, statistics and reconstruction of positions (docs/payloads/tempo-models.md). */

import { Bytes } from "../../bytes.js";
import { check, Unsupported } from "../../errors.js";
import { readIntegersWithin } from "../../integers/read.js";
import { readBasis } from "../../stages.js";
import type { Facts } from "../codec.js";
import type { Statistics } from "./coefficients.js";
import { BAND_LOGS, BAND_STARTS, SPREADS, log2, square } from "./logarithms.js";
import { type Matrix, complete, matrix, transposed } from "./ordered.js";
import type { PoseMap } from "./pose.js";
import { type Prior, jointsByName } from "./prior.js";

/** Rows of coefficients before the components: heading (1) and place (3). */
export const FIRST_ROWS = 4;
const MOST_BASIS_VALUES = 2 ** 26;

export interface Model {
  statistics: Statistics;
  /** The basis (components, dimensions) of each of four bands, L⁻¹ included. */
  bases: Basis[];
  dimensions: number;
  pose: PoseMap;
}

/** A basis with known first rows; the others are computed when a coefficient needs them. */
export class Basis {
  private all: Matrix | undefined;

  constructor(
    private readonly known: Matrix,
    private readonly completed: () => Matrix,
  ) {}

  static of(rows: Matrix): Basis {
    return new Basis(rows, () => rows);
  }

  /** The basis with at least `count` rows. */
  rows(count: number): Matrix {
    if (count <= this.known.rows) return this.known;
    return (this.all ??= this.completed());
  }
}

/** A basis stored in the file, with its spreads and means. */
export interface StoredBasis {
  /** The stored rows (k, dimensions). */
  known: Matrix;
  statistics: Statistics;
}

/** Reads the stored basis at the end of a model. */
export function readStoredBasis(part: Bytes, dimensions: number, alike: Int32Array | null, prior: Prior): StoredBasis {
  const count = part.varintWithin(2, dimensions + 1, "the number of gains") - 1;
  const gainBytes = part.varint();
  const precisionBytes = part.varint();
  const gains = cumulative(readIntegersWithin(part.take(gainBytes), count + 1, 1, -4000, 4000, "gains"), -4000, 4000);
  cumulative(readIntegersWithin(part.take(precisionBytes), count, 1, -96, 96, "precisions"), 0, 96);
  const columns = matrix(dimensions, count, readBasis(part.rest(), dimensions, count, alike));
  const shapes = prior.arrays.numbers("spreads").data;
  const most = shapes.length / SPREADS - FIRST_ROWS;
  const statistics = statisticsOf(prior, "", dimensions);
  for (let i = 0; i < dimensions; i++) {
    const shape = (FIRST_ROWS + Math.min(i, count, most - 1)) * SPREADS;
    const row = (FIRST_ROWS + i) * SPREADS;
    for (let f = 0; f < SPREADS; f++) statistics.spreads[row + f] = shapes[shape + f]! - shapes[shape + 5]! + 8 * gains[Math.min(i, count)]!;
    statistics.means[FIRST_ROWS + i] = statistics.spreads[row + 2]! - 128;
  }
  return { known: transposed(columns), statistics };
}

function cumulative(values: Float64Array, least: number, most: number): Float64Array {
  let sum = 0;
  return values.map((v) => {
    sum += v;
    check(sum >= least && sum <= most, "tempo: a sum that is out of range");
    return sum;
  });
}

/** Completes a basis to a square matrix. Throws Unsupported if it needs too much memory. */
export function completedBasis(known: Matrix, excluded?: Matrix): Matrix {
  if (known.columns * known.columns > MOST_BASIS_VALUES) throw new Unsupported(`tempo: a basis of ${known.columns} dimensions`);
  return complete(known, excluded);
}

/** Statistics with the prior's heading and place, and `components` rows for the caller to fill. */
export function statisticsOf(prior: Prior, prefix: string, components: number): Statistics {
  const rows = FIRST_ROWS + components;
  const spreads = new Int32Array(rows * SPREADS);
  spreads.set(prior.arrays.numbers(`${prefix}spreads`).data.subarray(0, FIRST_ROWS * SPREADS));
  const means = new Int32Array(rows);
  means.set(prior.arrays.numbers(`${prefix}means`).data.subarray(0, FIRST_ROWS));
  return { rows, spreads, means, prior };
}

/** The prior's bases and statistics. */
export function priorBases(prior: Prior): { bases: Matrix[]; statistics: Statistics } {
  const { shape, data } = prior.arrays.numbers("bases");
  const [bands, rows, columns] = shape as [number, number, number];
  check(bands === 4, "a prior: a wrong number of bands");
  const bases = Array.from({ length: 4 }, (_, b) => matrix(rows, columns, data.subarray(b * rows * columns, (b + 1) * rows * columns)));
  const spreads = Int32Array.from(prior.arrays.numbers("spreads").data);
  const means = Int32Array.from(prior.arrays.numbers("means").data);
  check(means.length === FIRST_ROWS + rows && spreads.length === SPREADS * means.length, "a prior: arrays that do not match");
  return { bases, statistics: { rows: means.length, spreads, means, prior } };
}

/** Levels of a model that a prior predicts. */
export interface Levels {
  gain: number;
  gainRise: number;
  rest: number;
  restRise: number;
  white: number;
}

/** "Predicted spreads" of components, from their variances (components, 18) in each band, in ordered arithmetic. */
export function predictSpreads(statistics: Statistics, variances: Matrix[], median: ArrayLike<number>, levels: Levels): void {
  for (let f = 0; f < SPREADS; f++) {
    const octave = BAND_LOGS[Math.max(f, 1)]! - log2(1000);
    const gain = square(4 * levels.gain + Math.floor((4 * levels.gainRise * octave) / 32));
    const noise = square(median[f]! + 4 * levels.rest + Math.floor((4 * levels.restRise * octave) / 32)) + square(4 * levels.white);
    const { data, rows } = variances[bandOf(f)]!;
    for (let i = 0; i < rows; i++) {
      const power = data[i * SPREADS + f]! * gain + noise;
      check(power > 0 && Number.isFinite(power), "tempo: a predicted spread that is not finite");
      statistics.spreads[(FIRST_ROWS + i) * SPREADS + f] = Math.floor(log2(power) / 2);
    }
  }
}

/** The band of a spread. */
export function bandOf(spread: number): number {
  return spread < BAND_STARTS[1] ? 0 : spread < BAND_STARTS[2] ? 1 : spread < BAND_STARTS[3] ? 2 : 3;
}

/** Lowers the statistics of the place by log₂(priorPoints / points) / 2. */
export function scalePlace(statistics: Statistics, priorPoints: number, points: number): void {
  const less = Math.floor((log2(priorPoints) - log2(points)) / 2);
  for (let r = 1; r < FIRST_ROWS; r++) {
    for (let f = 0; f < SPREADS; f++) statistics.spreads[r * SPREADS + f]! -= less;
    statistics.means[r]! -= less;
  }
}

/** Where bands 1, 2 and 3 begin, millihertz. */
const EDGES = [700, 2000, 5000];

/** Frequencies of the DCT at which the bands begin, and the end. */
export function bandEdges(frames: number, millihertz: number): number[] {
  return [0, ...EDGES.map((edge) => Math.min(frames, Math.ceil((2 * frames * edge) / millihertz))), frames];
}

/** Model 0, kind 0: positions of joints with names of the prior. */
export function namedPoints(part: Bytes, prior: Prior, facts: Facts): Model {
  part.end();
  check(!prior.isOfDirections, "tempo: the model needs a prior of points");
  const joints = jointsByName(prior, facts.names);
  const { bases, statistics } = priorBases(prior);
  const pose = prior.arrays.numbers("pose").data;
  const arranged = bases.map((basis) => {
    const out = matrix(basis.rows, basis.columns);
    for (let r = 0; r < basis.rows; r++) {
      joints.forEach((joint, p) => {
        for (let c = 0; c < 3; c++) out.data[r * basis.columns + 3 * p + c] = basis.data[r * basis.columns + 3 * joint + c]!;
      });
    }
    return Basis.of(out);
  });
  const mean = Float64Array.from({ length: 3 * joints.length }, (_, i) => pose[3 * joints[Math.floor(i / 3)]! + (i % 3)]!);
  return { statistics, bases: arranged, dimensions: 3 * joints.length, pose: { kind: "points", mean } };
}

/** Model 1: positions, with stored basis and spreads. */
export function storedPoints(part: Bytes, prior: Prior, facts: Facts): Model {
  const { points } = facts;
  const noise = part.foldedWithin(-3000, 3000, "the step of the pose");
  const pose = readIntegersWithin(part.blob(), points, 3, -(2 ** 40), 2 ** 40, "the pose");
  for (let i = 3; i < pose.length; i++) {
    pose[i]! += pose[i - 3]!;
    check(Math.abs(pose[i]!) <= 2 ** 40, "tempo: a pose that is out of range");
  }
  const basis = readStoredBasis(part, 3 * points, nearestBefore(pose, points), prior);
  const step = 2 ** ((noise + 64) / 32);
  const one = new Basis(basis.known, () => completedBasis(basis.known));
  return { statistics: basis.statistics, bases: [one, one, one, one], dimensions: 3 * points, pose: { kind: "points", mean: pose.map((v) => v * step) } };
}

/** For each dimension, the same coordinate of the nearest earlier point in the pose, or −1. */
function nearestBefore(pose: Float64Array, points: number): Int32Array {
  const alike = new Int32Array(3 * points).fill(-1);
  for (let p = 1; p < points; p++) {
    let least = Infinity;
    let nearest = 0;
    for (let q = 0; q < p; q++) {
      const [x, y, z] = [pose[3 * q]! - pose[3 * p]!, pose[3 * q + 1]! - pose[3 * p + 1]!, pose[3 * q + 2]! - pose[3 * p + 2]!];
      const square = x * x + y * y + z * z;
      if (square < least) {
        least = square;
        nearest = q;
      }
    }
    for (let c = 0; c < 3; c++) alike[3 * p + c] = 3 * nearest + c;
  }
  return alike;
}
