/** The deblocking filter at edges of blocks (ITU-T H.265, 8.7.2). */

import { clip } from "../numbers.js";
import type { Plane } from "./intra.js";
import type { MotionField } from "./motion.js";
import type { Parameters } from "./slice.js";

/** Table 8-12. */
const BETA = [...new Array<number>(16).fill(0), 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 20, 22, 24, 26, 28, 30, 32, 34, 36, 38, 40, 42, 44, 46, 48, 50, 52, 54, 56, 58, 60, 62, 64];
const TC = [
  ...new Array<number>(18).fill(0), ...new Array<number>(9).fill(1), 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 5, 5, 6, 6, 7, 8, 9, 10, 11, 13, 14, 16, 18, 20, 22, 24,
];
/** Added to the quantisation parameter at intra blocks. */
const INTRA_OFFSET = 2;
/** Strengths of edges: between inter blocks, and at an intra block. */
const WEAK = 1;
const STRONG = 2;

/** Edges of a block at its left and its top: of transforms and, shifted by PART_SHIFT, of prediction parts. */
export const LEFT = 1;
export const TOP = 2;
export const PART_SHIFT = 2;

/** Facts of each 4 × 4 block: edges, whether its luma has coefficients, and motion. */
export interface Blocks {
  edges: Uint8Array;
  isCoded: Uint8Array;
  motion: MotionField;
}
const GRID = 8;

export function deblock(planes: Plane[], blocks: Blocks, parameters: Parameters): void {
  const { width, height, qp, betaOffset, tcOffset, pictureQpOffsets } = parameters;
  const beta = BETA[clip(qp + betaOffset, 0, 51)]!;
  const steps = [qp, ...pictureQpOffsets.map((offset) => Math.min(clip(qp + offset, 0, 57), 51))];
  const tcs = steps.map((step) => TC[clip(step + INTRA_OFFSET + tcOffset, 0, 53)]!);
  const weakTc = TC[clip(qp + tcOffset, 0, 53)]!;
  for (const side of [LEFT, TOP]) {
    const [across, along] = side === LEFT ? [1, width] : [width, 1];
    for (let y = 0; y < height; y += side === LEFT ? 4 : GRID) {
      for (let x = 0; x < width; x += side === LEFT ? GRID : 4) {
        const block = (y >> 2) * (width >> 2) + (x >> 2);
        if ((side === LEFT ? x : y) === 0 || !(blocks.edges[block]! & (side | (side << PART_SHIFT)))) continue;
        const strength = strengthOf(blocks, block, side === LEFT ? block - 1 : block - (width >> 2), side);
        const at = y * width + x;
        if (strength > 0) luma(planes[0]!.samples, at, across, along, beta, strength === STRONG ? tcs[0]! : weakTc);
        if (strength < STRONG) continue;
        chroma(planes[1]!.samples, at, across, along, tcs[1]!);
        chroma(planes[2]!.samples, at, across, along, tcs[2]!);
      }
    }
  }
}

/** Boundary strength (8.7.2.4). */
function strengthOf({ edges, isCoded, motion }: Blocks, block: number, before: number, side: number): number {
  if (motion.references[block]! < 0 || motion.references[before]! < 0) return STRONG;
  if (edges[block]! & side && (isCoded[block] || isCoded[before])) return WEAK;
  return motion.isNear(block, before) ? 0 : WEAK;
}

/** Filters four lines of samples across an edge; s[at] is the first sample after it. */
function luma(s: Uint8Array, at: number, step: number, along: number, beta: number, tc: number): void {
  const bend = (i: number, far: number) => Math.abs(s[i + far * 2]! - 2 * s[i + far]! + s[i]!);
  const last = at + 3 * along;
  const [p0, p3] = [bend(at - step, -step), bend(last - step, -step)];
  const [q0, q3] = [bend(at, step), bend(last, step)];
  if (p0 + q0 + p3 + q3 >= beta) return;
  const isFlat = (i: number, bends: number) =>
    2 * bends < beta >> 2 &&
    Math.abs(s[i - 4 * step]! - s[i - step]!) + Math.abs(s[i]! - s[i + 3 * step]!) < beta >> 3 &&
    Math.abs(s[i - step]! - s[i]!) < (5 * tc + 1) >> 1;
  const isStrong = isFlat(at, p0 + q0) && isFlat(last, p3 + q3);
  const side = (beta + (beta >> 1)) >> 3;
  for (let k = 0; k < 4; k++) {
    const i = at + k * along;
    if (isStrong) strong(s, i, step, tc);
    else weak(s, i, step, tc, p0 + p3 < side, q0 + q3 < side);
  }
}

function strong(s: Uint8Array, i: number, step: number, tc: number): void {
  const [p3, p2, p1, p0] = [s[i - 4 * step]!, s[i - 3 * step]!, s[i - 2 * step]!, s[i - step]!];
  const [q0, q1, q2, q3] = [s[i]!, s[i + step]!, s[i + 2 * step]!, s[i + 3 * step]!];
  const near = (value: number, old: number) => clip(value, old - 2 * tc, old + 2 * tc);
  s[i - step] = near((p2 + 2 * p1 + 2 * p0 + 2 * q0 + q1 + 4) >> 3, p0);
  s[i - 2 * step] = near((p2 + p1 + p0 + q0 + 2) >> 2, p1);
  s[i - 3 * step] = near((2 * p3 + 3 * p2 + p1 + p0 + q0 + 4) >> 3, p2);
  s[i] = near((p1 + 2 * p0 + 2 * q0 + 2 * q1 + q2 + 4) >> 3, q0);
  s[i + step] = near((p0 + q0 + q1 + q2 + 2) >> 2, q1);
  s[i + 2 * step] = near((p0 + q0 + q1 + 3 * q2 + 2 * q3 + 4) >> 3, q2);
}

function weak(s: Uint8Array, i: number, step: number, tc: number, movesP: boolean, movesQ: boolean): void {
  const [p2, p1, p0] = [s[i - 3 * step]!, s[i - 2 * step]!, s[i - step]!];
  const [q0, q1, q2] = [s[i]!, s[i + step]!, s[i + 2 * step]!];
  let delta = (9 * (q0 - p0) - 3 * (q1 - p1) + 8) >> 4;
  if (Math.abs(delta) >= 10 * tc) return;
  delta = clip(delta, -tc, tc);
  s[i - step] = clip(p0 + delta, 0, 255);
  s[i] = clip(q0 - delta, 0, 255);
  const half = tc >> 1;
  if (movesP) s[i - 2 * step] = clip(p1 + clip((((p2 + p0 + 1) >> 1) - p1 + delta) >> 1, -half, half), 0, 255);
  if (movesQ) s[i + step] = clip(q1 + clip((((q2 + q0 + 1) >> 1) - q1 - delta) >> 1, -half, half), 0, 255);
}

function chroma(s: Uint8Array, at: number, step: number, along: number, tc: number): void {
  for (let k = 0; k < 4; k++) {
    const i = at + k * along;
    const [p1, p0, q0, q1] = [s[i - 2 * step]!, s[i - step]!, s[i]!, s[i + step]!];
    const delta = clip((((q0 - p0) << 2) + p1 - q1 + 4) >> 3, -tc, tc);
    s[i - step] = clip(p0 + delta, 0, 255);
    s[i] = clip(q0 - delta, 0, 255);
  }
}
