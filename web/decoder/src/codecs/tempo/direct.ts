/** Direct coding: samples on a grid, predicted from frames before and after (docs/payloads/tempo.md, "Direct coding"). */

import { check } from "../../errors.js";
import { readIntegers } from "../../integers/read.js";

interface Order {
  /** Frames in the order of coding. */
  frames: Int32Array;
  levels: Int32Array;
  /** Distance to the frames of the prediction; 0 for levels 0 and 1. */
  distances: Int32Array;
}

function orderOf(frames: number): Order {
  const order = { frames: new Int32Array(frames), levels: new Int32Array(frames), distances: new Int32Array(frames) };
  let next = 0;
  const add = (frame: number, level: number, distance: number): void => {
    order.frames[next] = frame;
    order.levels[next] = level;
    order.distances[next++] = distance;
  };
  add(0, 0, 0);
  if (frames > 1) add(frames - 1, 1, 0);
  let distance = 1;
  while (distance < frames - 1) distance *= 2;
  for (let level = 2; distance > 1; level++) {
    distance /= 2;
    for (let t = distance; t < frames - 1; t += 2 * distance) add(t, level, distance);
  }
  return order;
}

/** Decodes integers (frames, columns). */
export function readDirect(data: Uint8Array, frames: number, columns: number): Float64Array {
  const order = orderOf(frames);
  const residuals = readIntegers(data, frames, columns, order.levels);
  const values = new Float64Array(frames * columns);
  const last = frames - 1;
  for (let i = 0; i < frames; i++) {
    const t = order.frames[i]!;
    const d = order.distances[i]!;
    const out = t * columns;
    const before = (t - d) * columns;
    const after = Math.min(t + d, last) * columns;
    const wide = order.levels[i]! >= 2 && t >= 3 * d && t + 3 * d <= last;
    for (let c = 0; c < columns; c++) {
      let predicted = 0;
      if (order.levels[i] === 1) predicted = values[c]!;
      else if (wide) {
        const far = values[(t - 3 * d) * columns + c]! + values[(t + 3 * d) * columns + c]!;
        predicted = Math.floor((9 * (values[before + c]! + values[after + c]!) - far + 8) / 16);
      } else if (i > 0) predicted = Math.floor((values[before + c]! + values[after + c]! + 1) / 2);
      values[out + c] = predicted + residuals[i * columns + c]!;
    }
  }
  for (const v of values) check(Number.isSafeInteger(v), "tempo: a sample is out of range");
  return values;
}
