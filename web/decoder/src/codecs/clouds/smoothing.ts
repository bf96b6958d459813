/** Moves lattice points towards the surface around them (docs/payloads/bodycast-points.md, "Smoothing"). */

import { clip } from "../../numbers.js";
import type { MixedBits } from "./mixed.js";
import { NEIGHBOURS } from "./surface.js";

/** Shifts are in 1/256 of a lattice unit. */
export const FINE = 256;

const PER_SAMPLE = 4;
const MOST_SPACING = 2 ** 16;
const NORMAL = 2 ** 10;
const LEAST_COSINE = 315 * NORMAL;
const GAIN_AT_UNIT = 48_000;
const GAIN_LOSS = 90;
const MOST_MOVE = 128;
const CONTEXTS = 2 ** 20;
const WEIGHT_SET = 1024;

/** The samples of a frame. */
export interface Samples {
  normals: Float64Array;
  neighbours: Int32Array;
  spacing: number;
}

/** Shifts (points, 3) of a frame. cells (points, 3): lattice coordinates; near: the sample near each point, −1: none. */
export function readShifts(bits: MixedBits, cells: Int32Array, near: Int32Array, samples: Samples): Float64Array {
  const references = referencesOf(near, samples.normals.length / 3);
  const shifts = new Float64Array(cells.length);
  near.forEach((sample, i) => {
    if (sample < 0) return;
    const { move, deviation } = moveOf(i, cells, near, samples, references);
    if (move === 0) return;
    const [length, around] = [Math.abs(move), Math.min(Math.floor(deviation / 16), 15)];
    const coarse = length >> 3;
    const stays = bits.bit(CONTEXTS + coarse, CONTEXTS + 32 + around, CONTEXTS + 64 + 16 * coarse + around, CONTEXTS + 1024 + (length >> 1), CONTEXTS + 2048, WEIGHT_SET);
    if (!stays) for (let c = 0; c < 3; c++) shifts[3 * i + c] = Math.floor((move * samples.normals[3 * sample + c]! + NORMAL / 2) / NORMAL);
  });
  return shifts;
}

/** Points of each sample, at most PER_SAMPLE, which show the surface to other points. */
function referencesOf(near: Int32Array, samples: number): number[][] {
  const own: number[][] = Array.from({ length: samples }, () => []);
  near.forEach((sample, i) => sample >= 0 && own[sample]!.push(i));
  return own.map((rows) => (rows.length <= PER_SAMPLE ? rows : [0, 1, 2, 3].map((k) => rows[Math.floor((k * rows.length) / PER_SAMPLE)]!)));
}

function moveOf(i: number, cells: Int32Array, near: Int32Array, { normals, neighbours, spacing }: Samples, references: number[][]): { move: number; deviation: number } {
  const square = Math.min(spacing, MOST_SPACING) ** 2;
  const weights: number[] = [];
  const distances: number[] = [];
  const own = near[i]!;
  for (let k = -1; k < NEIGHBOURS; k++) {
    const other = k < 0 ? own : neighbours[NEIGHBOURS * own + k]!;
    let cosine = 0;
    for (let c = 0; c < 3; c++) cosine += normals[3 * own + c]! * normals[3 * other + c]!;
    if (cosine < LEAST_COSINE) continue;
    for (const row of references[other]!) {
      if (row === i) continue;
      let [away, along] = [0, 0];
      for (let c = 0; c < 3; c++) {
        const apart = cells[3 * row + c]! - cells[3 * i + c]!;
        away += apart * apart;
        along += apart * (normals[3 * own + c]! + normals[3 * other + c]!);
      }
      weights.push(Math.floor((square * 1024) / (256 * away + Math.floor(square / 4) + 1)));
      distances.push(Math.floor((along * FINE) / (2 * NORMAL)));
    }
  }
  let [total, largest, sum] = [0, 0, 0];
  weights.forEach((weight, k) => {
    total += weight;
    largest = Math.max(largest, weight);
    sum += weight * distances[k]!;
  });
  const mean = Math.floor(sum / Math.max(total + largest, 1));
  const deviation = Math.floor(weights.reduce((all, weight, k) => all + weight * Math.abs(distances[k]! - mean), 0) / Math.max(total, 1));
  const gain = clip(Math.floor(GAIN_AT_UNIT / Math.max(deviation, 1)) - GAIN_LOSS, 0, 256);
  return { move: clip(Math.floor((mean * gain) / 256), -MOST_MOVE, MOST_MOVE), deviation };
}
