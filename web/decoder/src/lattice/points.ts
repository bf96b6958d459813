/** Lattice points: their contexts and bits (docs/payloads/tempo-lattice.md, "Lattice points"). */

import { check } from "../errors.js";
import { AdaptiveBits } from "./bits.js";

const LOGS = 24;
const MOST_BITS_WITHIN = 42;
const FIRST_BUCKET_WITH_BITS = 5;

/** Logarithm of an integer in half octaves, 0 to 23. */
export function halfOctaves(v: number): number {
  if (v <= 0) return 0;
  const octave = 31 - Math.clz32(v);
  return Math.min(LOGS - 1, 2 * octave + 1 + (octave ? (v >> (octave - 1)) & 1 : 0));
}

function bitsWithin(bucket: number): number {
  return bucket < FIRST_BUCKET_WITH_BITS ? 0 : ((bucket - FIRST_BUCKET_WITH_BITS) >> 1) + 1;
}

/** The smallest magnitude of each bucket. */
const BUCKET_STARTS: number[] = [0];
while (bitsWithin(BUCKET_STARTS.length - 1) <= MOST_BITS_WITHIN) BUCKET_STARTS.push(BUCKET_STARTS.at(-1)! + 2 ** bitsWithin(BUCKET_STARTS.length - 1));

/** Activities around a sample, which give the contexts of its bits. */
export interface Surroundings {
  class: number;
  slow: number;
  before: number;
  before2: number;
  beside: Int32Array;
  after: number;
  around: number;
  /** 1 + log of the radial activities; 0: the direction to the partner is not used. */
  radial: number;
}

/** Reads a lattice point into `out`. */
export function readPoint(bits: AdaptiveBits, around: Surroundings, out: Float64Array): void {
  const c = around.class;
  setContexts(bits, around);
  const odd = bits.bit(0, c);
  for (let axis = 0; axis < 3; axis++) {
    const directed = axis === 0 && around.radial > 0;
    const magnitude = readMagnitude(bits, c, directed ? 2 + odd : odd, directed ? around.radial : 0);
    const coordinate = 2 * magnitude + odd;
    out[axis] = coordinate !== 0 && bits.evenBit() ? -coordinate : coordinate;
  }
}

function setContexts(bits: AdaptiveBits, around: Surroundings): void {
  const c = around.class;
  const beside0 = around.beside[0]!;
  const beside1 = around.beside[1]!;
  const beside2 = around.beside[2]!;
  const recent = 2 * around.before + around.before2;
  const mean = halfOctaves(around.slow >> 4);
  const own = halfOctaves(8 * recent);
  const near = halfOctaves(8 * (beside0 + beside1) + 4 * (beside2 + around.after));
  const outer = halfOctaves(8 * around.around);
  const all = halfOctaves((2 * (around.slow >> 4) + 10 * recent + 8 * (2 * beside0 + beside1 + beside2)) >> 2);
  const { contexts } = bits;
  contexts[0] = 257 * (LOGS * c + mean);
  contexts[1] = 257 * (200 + LOGS * own + near);
  contexts[2] = 257 * (1000 + LOGS * (LOGS * c + near) + mean);
  contexts[3] = 257 * (8000 + LOGS * (LOGS * c + outer) + near);
  contexts[4] = 257 * (14000 + LOGS * c + all);
}

function readMagnitude(bits: AdaptiveBits, c: number, h: number, radial: number): number {
  let bucket = 0;
  while (bits.bit(1 + 32 * h + Math.min(bucket, 30) + 65792 * radial, 8 * (1 + 8 * h + Math.min(bucket, 7)) + c)) {
    bucket++;
    check(bitsWithin(bucket) <= MOST_BITS_WITHIN, "tempo: a lattice point that is too far");
  }
  const count = bitsWithin(bucket);
  let within = 0;
  for (let i = 0; i < count; i++) within = 2 * within + (i === 0 ? bits.bit(140 + bucket, 320 + c) : bits.evenBit());
  return BUCKET_STARTS[bucket]! + within;
}
