/** Model 0, kind 1 of tempo: markers on bones of the prior. Spreads are computed in ordered arithmetic. */

import type { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegersWithin } from "../../integers/read.js";
import type { Facts } from "../codec.js";
import { BAND_STARTS, SPREADS, square } from "./logarithms.js";
import { Basis, FIRST_ROWS, type Levels, type Model, completedBasis, predictSpreads, scalePlace, statisticsOf } from "./model.js";
import { type Matrix, matrix, principal, product, rowOf, sum, transposed } from "./ordered.js";
import type { Prior } from "./prior.js";

const AXIS_M = 0.15;
const MOST_LEVEL = 2000;

export function readLevel(part: Bytes, usual = 0): number {
  return part.foldedWithin(-MOST_LEVEL, MOST_LEVEL, "a level") + usual;
}

export function readLevels(part: Bytes, usual = { rest: 0, white: 0 }): Levels {
  return {
    gain: readLevel(part),
    gainRise: readLevel(part),
    rest: readLevel(part, usual.rest),
    restRise: readLevel(part),
    white: readLevel(part, usual.white),
  };
}

/** Markers as weighted sums of the four points of their bones. */
class Markers {
  /** Weights (points, 4). */
  private readonly weights: Float64Array;
  private readonly buffer: Float64Array;

  constructor(
    private readonly bones: Float64Array,
    offsets: Float64Array,
    scale: number,
  ) {
    const points = bones.length;
    this.weights = new Float64Array(4 * points);
    this.buffer = new Float64Array(points);
    for (let p = 0; p < points; p++) {
      if (bones[p]! < 0) continue;
      const [x, y, z] = [0, 1, 2].map((c) => offsets[3 * p + c]! / 32 / AXIS_M) as [number, number, number];
      this.weights.set([scale / 64 - (x + y + z), x, y, z], 4 * p);
    }
  }

  /** Maps a pose or component of the prior to the markers (3 · points), minus their mean. */
  moved(of: Float64Array, out: Float64Array): void {
    const { bones, weights, buffer } = this;
    const points = bones.length;
    for (let c = 0; c < 3; c++) {
      for (let p = 0; p < points; p++) {
        const at = 12 * Math.max(bones[p]!, 0) + c;
        const w = 4 * p;
        buffer[p] = weights[w]! * of[at]! + weights[w + 1]! * of[at + 3]! + weights[w + 2]! * of[at + 6]! + weights[w + 3]! * of[at + 9]!;
        out[3 * p + c] = buffer[p]!;
      }
      const mean = sum(buffer) / points;
      for (let p = 0; p < points; p++) out[3 * p + c]! -= mean;
    }
  }
}

export function markersOnBones(part: Bytes, prior: Prior, facts: Facts): Model {
  const { points } = facts;
  check(prior.arrays.has("bones.names"), "tempo: a prior without bones");
  const digits = part.foldedWithin(-60, 60, "the step of the pose");
  const onBody = part.byte();
  check(onBody <= 1, "tempo: a pose of an unknown form");
  const scale = part.varintWithin(1, 4096, "the scale of the body");
  const levels = readLevels(part);
  const sizes = [part.varint(), part.varint(), part.varint()] as const;
  const pose = readIntegersWithin(part.take(sizes[0]), points, 3, -(2 ** 40), 2 ** 40, "tempo: the pose");
  const boneCount = prior.arrays.numbers("bones.parents").data.length;
  const bones = readIntegersWithin(part.take(sizes[1]), points, 1, 0, boneCount, "tempo: bones").map((v) => v - 1);
  const offsets = readIntegersWithin(part.take(sizes[2]), points, 3, -(2 ** 16), 2 ** 16, "tempo: offsets");
  part.end();
  const markers = new Markers(bones, offsets, scale);
  const mean = meanPose(pose, digits, onBody === 1, markers, prior);
  const components = 3 * points - 3;
  check(components > 0, "tempo: markers on bones of one point");
  const statistics = statisticsOf(prior, "bones.", components);
  const { bases, variances } = predictedBases(markers, points, prior);
  predictSpreads(statistics, variances, prior.arrays.numbers("bones.median_spread").data, levels);
  for (let i = FIRST_ROWS; i < statistics.rows; i++) statistics.means[i] = statistics.spreads[i * SPREADS + 2]! - 128;
  scalePlace(statistics, 4 * boneCount, points);
  return { statistics, bases, dimensions: 3 * points, pose: { kind: "points", mean } };
}

function meanPose(pose: Float64Array, digits: number, onBody: boolean, markers: Markers, prior: Prior): Float64Array {
  if (!onBody) for (let i = 3; i < pose.length; i++) pose[i]! += pose[i - 3]!;
  const mean = pose.map((v) => v * 2 ** -digits);
  if (!onBody) return mean;
  const body = new Float64Array(pose.length);
  markers.moved(prior.arrays.numbers("bones.pose").data, body);
  return mean.map((v, i) => v + body[i]!);
}

/** For each band, the basis and the variances of its components (components, 18). */
function predictedBases(markers: Markers, points: number, prior: Prior): { bases: Basis[]; variances: Matrix[] } {
  const { shape, data } = prior.arrays.numbers("bones.bases");
  const [, rows, columns] = shape as [number, number, number];
  const spreads = prior.arrays.numbers("bones.spreads").data;
  const y = matrix(rows, SPREADS, spreads.slice(FIRST_ROWS * SPREADS).map(square));
  const most = 3 * points - 3;
  const translations = matrix(3, 3 * points);
  for (let i = 0; i < 3 * points; i++) translations.data[(i % 3) * 3 * points + i] = 1 / Math.sqrt(points);
  const bases: Basis[] = [];
  const variances: Matrix[] = [];
  for (let band = 0; band < 4; band++) {
    const a = matrix(rows, 3 * points);
    for (let r = 0; r < rows; r++) markers.moved(data.subarray((band * rows + r) * columns, (band * rows + r + 1) * columns), rowOf(a, r));
    const d = principal(weighted(a, y, BAND_STARTS[band]!, BAND_STARTS[band + 1]!), most);
    bases.push(new Basis(d, () => completedBasis(d, translations)));
    variances.push(variancesOf(d, a, y, most));
  }
  return { bases, variances };
}

/** Each row times the root of its largest squared spread among columns first … end − 1. */
export function weighted(a: Matrix, y: Matrix, first: number, end: number): Matrix {
  const out = matrix(a.rows, a.columns, a.data.slice());
  for (let r = 0; r < a.rows; r++) {
    let most = -Infinity;
    for (let f = first; f < end; f++) most = Math.max(most, y.data[r * y.columns + f]!);
    const root = Math.sqrt(most);
    const row = rowOf(out, r);
    for (let c = 0; c < row.length; c++) row[c]! *= root;
  }
  return out;
}

/** V = (D · Aᵀ, each entry squared) · Y, then rows of zeros up to `most`. */
export function variancesOf(d: Matrix, a: Matrix, y: Matrix, most: number): Matrix {
  const shares = product(d, transposed(a));
  for (let i = 0; i < shares.data.length; i++) shares.data[i] = shares.data[i]! * shares.data[i]!;
  const out = matrix(most, y.columns);
  out.data.set(product(shares, y).data);
  return out;
}
