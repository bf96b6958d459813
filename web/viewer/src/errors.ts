/** Distances between decoded and original points. */

import type { ErrorFacts } from "./session.ts";
import type { Frame } from "./frames.ts";

/** The distance of each point, metres; NaN at gaps. */
export function distances(decoded: Frame, original: Frame, out: Float32Array): Float32Array {
  const a = decoded.positions;
  const b = original.positions;
  for (let i = 0; i < out.length; i++) {
    out[i] = Math.hypot(a[3 * i] - b[3 * i], a[3 * i + 1] - b[3 * i + 1], a[3 * i + 2] - b[3 * i + 2]);
  }
  return out;
}

/** Mean and largest distance in a frame, and the point of the largest (−1 without points). */
export function summary(errors: Float32Array): { mean: number; max: number; at: number } {
  let sum = 0;
  let count = 0;
  let max = 0;
  let at = -1;
  for (let i = 0; i < errors.length; i++) {
    const error = errors[i];
    if (Number.isNaN(error)) continue;
    sum += error;
    count++;
    if (at < 0 || error > max) {
      max = error;
      at = i;
    }
  }
  return { mean: count ? sum / count : NaN, max: count ? max : NaN, at };
}

const BINS = 2048;

/** Errors over all frames of two dropped files. Reports progress and lets the page draw in between. */
export async function measure(
  frames: number,
  points: number,
  pairs: (a: number, b: number) => Promise<[Frame[], Frame[]]>,
  progress: (share: number) => void,
): Promise<ErrorFacts> {
  const binFrames = Math.max(1, Math.ceil(frames / BINS));
  const bins = Math.ceil(frames / binFrames);
  const facts: ErrorFacts = {
    mean: 0,
    p99: 0,
    max: 0,
    maxAt: null,
    binFrames,
    binMean: new Array(bins).fill(0),
    binMax: new Array(bins).fill(0),
    binWorst: Array.from({ length: bins }, (_, i) => i * binFrames),
    pointMean: new Array(points).fill(0),
    pointMax: new Array(points).fill(0),
  };
  const pointCount = new Float64Array(points);
  const binCount = new Float64Array(bins);
  const all = new Float32Array(frames * points);
  let used = 0;
  const errors = new Float32Array(points);
  for (let start = 0; start < frames; start += 240) {
    const stop = Math.min(frames, start + 240);
    const [decoded, original] = await pairs(start, stop);
    for (let f = start; f < stop; f++) {
      distances(decoded[f - start], original[f - start], errors);
      const bin = Math.floor(f / binFrames);
      for (let p = 0; p < points; p++) {
        const error = errors[p];
        if (Number.isNaN(error)) continue;
        all[used++] = error;
        facts.pointMean[p] += error;
        pointCount[p]++;
        facts.pointMax[p] = Math.max(facts.pointMax[p], error);
        facts.binMean[bin] += error;
        binCount[bin]++;
        if (error > facts.binMax[bin]) {
          facts.binMax[bin] = error;
          facts.binWorst[bin] = f;
        }
        if (facts.maxAt === null || error > facts.max) {
          facts.max = error;
          facts.maxAt = [f, p];
        }
      }
    }
    progress(stop / frames);
  }
  const sorted = all.subarray(0, used).sort();
  facts.mean = sorted.reduce((sum, error) => sum + error, 0) / Math.max(1, used);
  const place = 0.99 * (used - 1);
  const below = sorted[Math.floor(place)] ?? 0;
  facts.p99 = below + (place - Math.floor(place)) * ((sorted[Math.ceil(place)] ?? below) - below);
  facts.pointMean = facts.pointMean.map((sum, p) => sum / Math.max(1, pointCount[p]));
  facts.binMean = facts.binMean.map((sum, b) => sum / Math.max(1, binCount[b]));
  return facts;
}
