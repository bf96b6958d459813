/** The codec `lossless`: float32 or float64, bit for bit (docs/payloads/lossless.md). */

import { Bytes } from "../bytes.js";
import { check } from "../errors.js";
import { inflateZlib } from "../inflate.js";
import { readIntegersWithin } from "../integers/read.js";
import { halfToEven } from "../numbers.js";
import { Gaps } from "../stages.js";
import type { ChunkDecoder, Decoded, Facts, StoredChunk } from "./codec.js";

const GRID = 1;
const FLOAT64 = 2;
const TAPS = 7;
const MOST_RESIDUAL = 2 ** 38;
const MOST_RANK = 2 ** 37;
const MOST_LEVEL = 2 ** 40;
const MOST_GRID_RANK = 2 ** 36;

export class Lossless implements ChunkDecoder {
  private readonly form: number;
  private readonly unit: number;
  private readonly steps: number;
  private readonly taps: number[];
  private readonly scale: number;

  constructor(private readonly facts: Facts) {
    const part = new Bytes(facts.shared[0]!, "lossless");
    this.form = part.byte();
    check(this.form <= FLOAT64, "lossless: a reserved form");
    this.unit = part.float64();
    this.steps = part.float64();
    this.taps = Array.from({ length: TAPS }, () => part.int32());
    this.scale = (part.byte() << 24) >> 24;
    part.uint32();
    part.end();
    if (facts.rotations) check(facts.shared.length === 2 && facts.shared[1]!.length === 1 && facts.shared[1]![0] === 1, "lossless: rotations of an unknown form");
    else check(facts.shared.length === 1, "lossless: too many shared blobs");
  }

  decode(window: StoredChunk[], which: number): Decoded {
    const { frames, payload } = window[which]!;
    const { points } = this.facts;
    const part = new Bytes(payload, "lossless");
    const rotations = this.facts.rotations ? readRotations(part.take(part.uint32()), frames, this.facts.skeleton!.parents.length) : undefined;
    const gaps = Gaps.read(part.take(part.uint32()), frames, points);
    let positions: Float64Array;
    if (this.form === FLOAT64) {
      positions = doubles(readIntegersWithin(part.rest(), frames, 12 * points, 0, 65535, "lossless"), frames, 3 * points);
    } else {
      const residuals = readIntegersWithin(part.rest(), frames, 3 * points, -MOST_RESIDUAL, MOST_RESIDUAL, "lossless");
      positions = this.form === GRID ? this.onGrid(residuals, frames, 3 * points) : this.floats(residuals, frames, 3 * points);
    }
    gaps.restore(positions);
    return rotations ? { positions, rotations } : { positions };
  }

  private onGrid(residuals: Float64Array, frames: number, channels: number): Float64Array {
    const ranks = this.ranks(residuals, frames, channels, (level) => level, (rank) => clip(rank, MOST_GRID_RANK));
    return ranks.map((rank) => (rank / this.steps) * this.unit);
  }

  private floats(residuals: Float64Array, frames: number, channels: number): Float64Array {
    const up = 2 ** this.scale;
    const down = 2 ** -this.scale;
    const fromLevel = (level: number) => rankOf(level * down);
    const toLevel = (rank: number) => {
      const level = floatOf(rank) * up;
      return Number.isNaN(level) ? 0 : clip(halfToEven(level), MOST_LEVEL);
    };
    return this.ranks(residuals, frames, channels, fromLevel, toLevel).map((rank) => floatOf(rank) * this.unit);
  }

  /** Ranks from their residuals, with a linear predictor over eight earlier samples of each channel. */
  private ranks(
    residuals: Float64Array,
    frames: number,
    channels: number,
    fromLevel: (level: number) => number,
    toLevel: (rank: number) => number,
  ): Float64Array {
    const ranks = residuals;
    const past = new Float64Array(TAPS + 1);
    for (let c = 0; c < channels; c++) {
      for (let t = 0; t < frames; t++) {
        const at = t * channels + c;
        let rank = residuals[at]!;
        if (t > 0) rank += fromLevel(clip(past[0]! + this.drift(past), MOST_LEVEL));
        rank = clip(rank, MOST_RANK);
        ranks[at] = rank;
        const level = toLevel(rank);
        if (t === 0) past.fill(level);
        else {
          past.copyWithin(1, 0, TAPS);
          past[0] = level;
        }
      }
    }
    return ranks;
  }

  /** (Σ tap · (past − latest) + 2^13) >> 14, in big integers if float64 would not be exact. */
  private drift(past: Float64Array): number {
    let sum = 8192;
    let size = 8192;
    for (let k = 1; k <= TAPS; k++) {
      const product = this.taps[k - 1]! * (past[k]! - past[0]!);
      sum += product;
      size += Math.abs(product);
    }
    if (size <= Number.MAX_SAFE_INTEGER) return Math.floor(sum / 16384);
    let exact = 8192n;
    for (let k = 1; k <= TAPS; k++) exact += BigInt(this.taps[k - 1]!) * BigInt(past[k]! - past[0]!);
    return Number(exact >> 14n);
  }
}

function clip(value: number, most: number): number {
  return value < -most ? -most : value > most ? most : value;
}

const FLOAT = new Float32Array(1);
const BITS = new Int32Array(FLOAT.buffer);

/** The float32 of a rank, modulo 2^32. */
function floatOf(rank: number): number {
  BITS[0] = rank < 0 ? rank ^ 0x7fffffff : rank; // modulo 2^32: |rank| is at most 2^37
  return FLOAT[0]!;
}

/** The rank of a number, rounded to float32. */
function rankOf(value: number): number {
  FLOAT[0] = value;
  const bits = BITS[0]!;
  return bits < 0 ? bits ^ 0x7fffffff : bits;
}

/** Form 2: 64-bit ranks, stored as differences along time modulo 2^64, in four words each. Computed as pairs of 32 bits. */
function doubles(words: Float64Array, frames: number, channels: number): Float64Array {
  const bits = new Uint32Array(2 * frames * channels);
  const high = new Uint32Array(channels);
  const low = new Uint32Array(channels);
  for (let t = 0; t < frames; t++) {
    for (let c = 0; c < channels; c++) {
      const at = 4 * (t * channels + c);
      const zHigh = words[at]! * 65536 + words[at + 1]!;
      const zLow = words[at + 2]! * 65536 + words[at + 3]!;
      const sign = -(zLow & 1);
      const sum = low[c]! + (((((zLow >>> 1) | (zHigh << 31)) ^ sign) >>> 0));
      low[c] = sum;
      high[c] = high[c]! + (((zHigh >>> 1) ^ sign) >>> 0) + (sum >= 4294967296 ? 1 : 0);
      const negative = high[c]! >>> 31;
      const out = 2 * (t * channels + c);
      bits[out] = negative ? ~low[c]! : low[c]!;
      bits[out + 1] = negative ? high[c]! ^ 0x7fffffff : high[c]!;
    }
  }
  const values = new Float64Array(bits.buffer);
  check(values.every(Number.isFinite), "lossless: a position is not finite");
  return values;
}

/** Quaternions (frames, joints, 4): byte planes of 64-bit numbers, each XORed with the number before it in time. */
function readRotations(data: Uint8Array, frames: number, joints: number): Float64Array {
  const numbers = 4 * joints * frames;
  const bytes = inflateZlib(data, 8 * numbers);
  check(bytes.length === 8 * numbers, "lossless: rotations of a wrong size");
  const out = new Uint8Array(8 * numbers);
  const lanes = 4 * joints;
  for (let digit = 0; digit < 8; digit++) {
    for (let lane = 0; lane < lanes; lane++) {
      let byte = 0;
      for (let t = 0; t < frames; t++) {
        byte ^= bytes[digit * numbers + lane * frames + t]!;
        out[8 * (t * lanes + lane) + digit] = byte;
      }
    }
  }
  return new Float64Array(out.buffer);
}
