/** Key frames, splines and tracks (docs/payloads/stages.md), which liu2006 uses. */

import type { Bits } from "../bytes.js";
import { halfToEven } from "../numbers.js";

/** Key frames among `frames` frames, level by level, ascending in each level. */
export function readKeyFrames(bits: Bits, frames: number): number[][] {
  const first = [...new Set([0, 1, 2, 3].map((i) => halfToEven((i * (frames - 1)) / 3)))].sort((a, b) => a - b);
  const levels = [first];
  let intervals = first.slice(1).map((right, i): [number, number] => [first[i]!, right]);
  for (;;) {
    const halves: [number, number][] = [];
    const middles: number[] = [];
    for (const [left, right] of intervals) {
      if (right - left < 2 || !bits.bit()) continue;
      const middle = Math.floor((left + right) / 2);
      middles.push(middle);
      halves.push([left, middle], [middle, right]);
    }
    if (middles.length === 0) return levels;
    levels.push(middles);
    intervals = halves;
  }
}

/** Trajectories (frames, lanes), stored as values at key frames. */
export class Track {
  /** Second derivatives at the key frames. */
  private readonly bends: Float64Array;

  /** keys ascending; values (keys, lanes). */
  constructor(
    readonly keys: number[],
    private readonly values: Float64Array,
    private readonly lanes: number,
  ) {
    this.bends = secondDerivatives(keys, values, lanes);
  }

  /** A track from its numbers (key frames, lanes), in the order of the levels. */
  static read(levels: number[][], numbers: Float64Array, lanes: number, step: number): Track {
    const first = levels[0]!;
    const values = numbers.slice(0, first.length * lanes).map((v) => v * step);
    for (let i = lanes; i < values.length; i++) values[i]! += values[i - lanes]!;
    let track = new Track(first, values, lanes);
    let at = first.length * lanes;
    for (const level of levels.slice(1)) {
      const more = new Float64Array(level.length * lanes);
      level.forEach((frame, i) => {
        track.at(frame, more, i * lanes);
        for (let c = 0; c < lanes; c++) more[i * lanes + c]! += numbers[at++]! * step;
      });
      track = track.with(level, more);
    }
    return track;
  }

  private with(level: number[], more: Float64Array): Track {
    const { lanes } = this;
    const both = [...this.keys.map((key, i) => ({ key, from: this.values, i })), ...level.map((key, i) => ({ key, from: more, i }))];
    both.sort((a, b) => a.key - b.key);
    const values = new Float64Array(both.length * lanes);
    both.forEach(({ from, i }, k) => values.set(from.subarray(i * lanes, (i + 1) * lanes), k * lanes));
    return new Track(both.map(({ key }) => key), values, lanes);
  }

  /** Writes the value of the natural cubic spline at a frame to `out`, from index `place` on. */
  at(frame: number, out: Float64Array, place: number): void {
    const { keys, values, lanes, bends } = this;
    if (keys.length < 2) {
      out.set(values, place);
      return;
    }
    let low = 0;
    let high = keys.length - 2;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (keys[middle]! <= frame) low = middle;
      else high = middle - 1;
    }
    const h = keys[low + 1]! - keys[low]!;
    const b = (frame - keys[low]!) / h;
    const a = 1 - b;
    const bendA = ((a * a * a - a) * h * h) / 6;
    const bendB = ((b * b * b - b) * h * h) / 6;
    const left = low * lanes;
    const right = left + lanes;
    for (let c = 0; c < lanes; c++) {
      out[place + c] = a * values[left + c]! + b * values[right + c]! + bendA * bends[left + c]! + bendB * bends[right + c]!;
    }
  }
}

/** Second derivatives of the natural spline at its keys: zero at both ends, a tridiagonal system between. */
function secondDerivatives(keys: number[], values: Float64Array, lanes: number): Float64Array {
  const n = keys.length;
  const bends = new Float64Array(n * lanes);
  const upper = new Float64Array(n);
  for (let i = 1; i < n - 1; i++) {
    const before = keys[i]! - keys[i - 1]!;
    const after = keys[i + 1]! - keys[i]!;
    const pivot = (before + after) / 3 - (before / 6) * upper[i - 1]!;
    upper[i] = after / 6 / pivot;
    for (let c = 0; c < lanes; c++) {
      const at = i * lanes + c;
      const right = (values[at + lanes]! - values[at]!) / after - (values[at]! - values[at - lanes]!) / before;
      bends[at] = (right - (before / 6) * bends[at - lanes]!) / pivot;
    }
  }
  for (let i = n - 2; i > 0; i--) for (let c = 0; c < lanes; c++) bends[i * lanes + c]! -= upper[i]! * bends[(i + 1) * lanes + c]!;
  return bends;
}
