/** The skeleton of a recording (docs/format.md, "Skeleton"). Offsets are in steps of 10 µm unless they are exact. */

import type { Bytes } from "../bytes.js";
import { check } from "../errors.js";
import type { Limits } from "./orders.js";
import { readNames } from "./names.js";
import { REFERENCE_OFFSETS, TREES } from "./tables.js";

export interface Skeleton {
  names: string[];
  /** Index of each joint's parent, −1 for a root. Parents come before their children. */
  parents: number[];
  /** Offsets from the parent in the rest pose (joints, 3), metres. */
  offsets: Float64Array;
  limits?: Limits;
}

const STEPS_A_METRE = 100_000;
const MOST_STEPS = 2 ** 31;
const EXTENDED = 112;

/** Reads the skeleton of the header, and whether the file has rotations of its joints. */
export async function readSkeleton(part: Bytes, pointNames: string[]): Promise<{ skeleton: Skeleton; rotations: boolean }> {
  if (part.left === 0 || part.data[part.at] !== EXTENDED) return { skeleton: await plain(part, pointNames), rotations: false };
  part.byte();
  const facts = part.byte();
  check(facts < 4, `${part.what}: a skeleton with parts that this version does not know`);
  const limits = facts & 2 ? (await import("./limits.js")).readLimits(part.blob(), pointNames.length) : undefined;
  const skeleton = await plain(part, pointNames);
  if (limits) skeleton.limits = limits;
  return { skeleton, rotations: (facts & 1) === 1 };
}

async function plain(part: Bytes, pointNames: string[]): Promise<Skeleton> {
  const flags = part.byte();
  const mirror = (flags >> 2) & 3;
  const tree = (flags >> 4) & 7;
  const names = flags & 2 ? readNames(part) : pointNames;
  const joints = pointNames.length;
  check(
    names.length === joints && tree < TREES.length && (tree === 0 || TREES[tree]!.length === joints),
    `${part.what}: the skeleton does not match the points, or its tree is unknown`,
  );
  const bits = new LowBits(part);
  const parents = tree ? TREES[tree]! : readParents(bits, joints);
  if (flags & 1) {
    bits.end();
    const { readArray, toNumbers } = await import("./arrays.js");
    const array = readArray(part, 24 * joints);
    check(
      array.dtype === "<f8" && array.shape.length === 2 && array.shape[0] === joints && array.shape[1] === 3,
      `${part.what}: the skeleton's offsets do not match its joints`,
    );
    const offsets = toNumbers(array);
    check(offsets.every(Number.isFinite), `${part.what}: an offset is not finite`);
    return { names, parents, offsets };
  }
  const offsets = readOffsets(bits, predictors(names, tree, mirror), (flags & 128) !== 0);
  bits.end();
  return { names, parents, offsets };
}

/** Reads bits, the lowest of each byte first, padded with zeros to a whole byte. */
class LowBits {
  private byte = 0;
  private remaining = 0;

  constructor(readonly part: Bytes) {}

  bit(): number {
    if (this.remaining === 0) {
      this.byte = this.part.byte();
      this.remaining = 8;
    }
    const bit = this.byte & 1;
    this.byte >>= 1;
    this.remaining--;
    return bit;
  }

  /** Reads a number of `count` bits, the lowest first. */
  number(count: number): number {
    let value = 0;
    for (let i = 0, factor = 1; i < count; i++, factor *= 2) value += this.bit() * factor;
    return value;
  }

  /** Reads an exponential Golomb code of order k. */
  golomb(k: number): number {
    let zeros = 0;
    while (this.bit() === 0) {
      zeros++;
      check(k + zeros < 48, `${this.part.what}: a number of too many digits`);
    }
    return this.number(k + zeros) + 2 ** (k + zeros) - 2 ** k;
  }

  end(): void {
    check(this.byte === 0, `${this.part.what}: a padding bit is not 0`);
    this.remaining = 0;
  }
}

function readParents(bits: LowBits, joints: number): number[] {
  const parents = Array.from({ length: joints }, (_, joint) => joint - 1 - bits.golomb(0));
  check(parents.every((parent) => parent >= -1), `${bits.part.what}: a joint's parent is out of range`);
  return parents;
}

/** Prediction of a joint's offset: the mirrored offset of an earlier joint, or a fixed offset. */
type Predictor = { partner: number; axis: number } | { offset: number[] };

function predictors(names: string[], tree: number, mirror: number): Predictor[] {
  const indexOf = new Map<string, number>();
  return names.map((name, joint) => {
    const other = mirror ? otherSides(name).find((candidate) => indexOf.has(candidate)) : undefined;
    const partner = other === undefined ? undefined : indexOf.get(other)!;
    if (!indexOf.has(name)) indexOf.set(name, joint);
    if (partner !== undefined) return { partner, axis: mirror - 1 };
    return { offset: REFERENCE_OFFSETS[tree]?.[joint] ?? [0, 0, 0] };
  });
}

const SIDES = [
  ["left", "right"],
  ["right", "left"],
  ["Left", "Right"],
  ["Right", "Left"],
  ["l", "r"],
  ["r", "l"],
  ["L", "R"],
  ["R", "L"],
] as const;

/** Possible names of the joint on the other side, in the order of trial. */
function otherSides(name: string): string[] {
  const found: string[] = [];
  for (const [side, other] of SIDES) {
    const at = name.indexOf(side);
    if (at < 0 || (side.length === 1 && /\p{L}$/u.test(name.slice(0, at)))) continue;
    found.push(name.slice(0, at) + other + name.slice(at + side.length));
  }
  return found;
}

/** Reads offsets (joints, 3) in metres. */
function readOffsets(bits: LowBits, predicted: Predictor[], chained: boolean): Float64Array {
  const orders = [bits.number(4), bits.number(4)] as const;
  const steps: number[][] = [];
  let ratio: readonly [number, number] = [1, 1];
  for (const predictor of predicted) {
    const unscaled = "offset" in predictor ? predictor.offset : steps[predictor.partner]!.map((v, c) => (c === predictor.axis ? -v : v));
    const [numerator, denominator] = ratio;
    const scaled = unscaled.map((v) => roundedQuotient(v, numerator, denominator));
    const main = largest(scaled);
    const value = scaled[main]! + residual(bits, orders[0]);
    const divisor = scaled[main]!;
    const offset = scaled.map((v) => (divisor ? roundedQuotient(v, value, divisor) : v));
    for (let c = 0; c < 3; c++) offset[c] = c === main ? value : offset[c]! + residual(bits, orders[1]);
    check(offset.every((v) => Math.abs(v) <= MOST_STEPS), `${bits.part.what}: an offset is out of range`);
    if (chained) {
      const axis = largest(unscaled);
      ratio = offset[axis]! * unscaled[axis]! > 0 ? [offset[axis]!, unscaled[axis]!] : [1, 1];
    }
    steps.push(offset);
  }
  return Float64Array.from(steps.flat(), (step) => step / STEPS_A_METRE);
}

function residual(bits: LowBits, order: number): number {
  if (bits.bit() === 0) return 0;
  const number = bits.golomb(order) + 1;
  return number % 2 ? -(number + 1) / 2 : number / 2;
}

/** Axis of the first coordinate of the largest magnitude. */
function largest(vector: number[]): number {
  let main = 0;
  for (let c = 1; c < 3; c++) if (Math.abs(vector[c]!) > Math.abs(vector[main]!)) main = c;
  return main;
}

/** a · b / c, rounded half up. */
function roundedQuotient(a: number, b: number, c: number): number {
  const product = 2 * a * b;
  if (Math.abs(product) + Math.abs(c) < 2 ** 52) return Math.floor((product + c) / (2 * c));
  const numerator = 2n * BigInt(a) * BigInt(b) + BigInt(c);
  const denominator = 2n * BigInt(c);
  const quotient = numerator / denominator;
  const exact = quotient * denominator === numerator;
  return Number(exact || numerator < 0n === denominator < 0n ? quotient : quotient - 1n);
}
