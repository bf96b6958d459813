/** Positions from coefficients: steps 1 to 6 of "Decoding" (docs/payloads/tempo.md). */

import { check } from "../../errors.js";
import { inverseDct } from "../../dct.js";
import { type Coefficients, headingStep } from "./coefficients.js";
import { FIRST_ROWS, type Model, bandEdges } from "./model.js";
import type { Matrix } from "./ordered.js";
import { positionsOf } from "./pose.js";

const SHRINK = 0.05;

/** Positions (frames, points, 3), y up, without corrections. */
export function synthesised(coefficients: Coefficients, model: Model, frames: number, points: number, millihertz: number): Float64Array {
  const { frequencies } = coefficients;
  const lanes = FIRST_ROWS + model.dimensions;
  const y = new Float64Array(frequencies * lanes);
  const step = 2 ** (coefficients.step / 32);
  const turn = 2 ** (headingStep(frames) / 32);
  const { values } = coefficients;
  const { rows } = model.statistics;
  for (let f = 0; f < frequencies; f++) {
    y[f * lanes] = values[f * rows]! * turn;
    for (let r = 1; r < FIRST_ROWS; r++) y[f * lanes + r] = values[f * rows + r]! * step;
  }
  addComponents(coefficients, model, bandEdges(frames, millihertz), step, y, lanes);
  return positionsOf(inverseDct(y, frequencies, frames, lanes), frames, points, model.pose);
}

/** y[f] = c[f, 4 …] · basis of the band of f, from lane 4 on. */
function addComponents({ values, frequencies }: Coefficients, model: Model, edges: number[], step: number, y: Float64Array, lanes: number): void {
  const { rows } = model.statistics;
  for (let band = 0; band < 4; band++) {
    const from = edges[band]!;
    const to = Math.min(edges[band + 1]!, frequencies);
    if (from >= to) continue;
    const basis = model.bases[band]!.rows(usedComponents(values, rows, from, to));
    for (let f = from; f < to; f++) multiply(values, f * rows + FIRST_ROWS, rows - FIRST_ROWS, step, basis, y, f * lanes + FIRST_ROWS);
  }
}

/** 1 + the last component with a coefficient in frequencies from … to − 1; 0: none. */
function usedComponents(values: Float64Array, rows: number, from: number, to: number): number {
  let used = 0;
  for (let f = from; f < to; f++) {
    for (let r = rows - 1; r >= FIRST_ROWS + used; r--) {
      if (values[f * rows + r] !== 0) used = r + 1 - FIRST_ROWS;
    }
  }
  return used;
}

function multiply(values: Float64Array, at: number, count: number, step: number, basis: Matrix, y: Float64Array, out: number): void {
  for (let i = 0; i < count; i++) {
    const v = values[at + i]!;
    if (v === 0) continue;
    const c = (v > 0 ? v - SHRINK : v + SHRINK) * step;
    const row = i * basis.columns;
    for (let d = 0; d < basis.columns; d++) y[out + d]! += c * basis.data[row + d]!;
  }
}

/** Step 6: adds the waves of the corrections to positions. */
export function addWaves(
  positions: Float64Array,
  { corrections, lists }: Coefficients,
  frames: number,
  points: number,
  grid: number,
  weights: Float64Array | undefined,
): void {
  let at = 0;
  for (let i = 0; i < corrections; i++) {
    at += lists[3 * corrections + i]!;
    const length = lists[4 * corrections + i]! + 1;
    const point = Math.floor(at / frames);
    const frame = at - point * frames;
    check(point < points && frame + length <= frames, "tempo: a correction beyond its point");
    const scale = grid / (weights ? weights[point]! : 1);
    for (let k = 0; k < length; k++) {
      const wave = scale * Math.sin((Math.PI * (k + 1)) / (length + 1));
      const out = 3 * ((frame + k) * points + point);
      for (let c = 0; c < 3; c++) positions[out + c]! += lists[c * corrections + i]! * wave;
    }
    at += length;
  }
}
