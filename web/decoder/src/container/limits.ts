/** Joint limits of a skeleton with rotations (docs/format.md, "With rotations"). */

import { Bytes } from "../bytes.js";
import { check } from "../errors.js";
import { readIntegers } from "../integers/read.js";
import { fromEuler } from "../geometry.js";
import { type Limits, ORDERS } from "./orders.js";
import { LIMIT_FRAMES, LIMIT_RANGES, REFERENCE_LIMITS } from "./tables.js";

const LOCKED = 0;
const UNLIMITED = 1;
const RANGE = 2;
const MOST = 2 ** 48;

interface Reference {
  orders: number[];
  kinds: number[];
  ranges: number[];
  frames: number[];
}

export function readLimits(data: Uint8Array, joints: number): Limits {
  const part = new Bytes(data, "joint limits");
  const exact = part.varintWithin(0, 1, "the form") === 1;
  const of = reference(part.varint(), joints);
  const digits = part.varintWithin(0, 7, "the number of digits");
  const sizes = Array.from({ length: exact ? 2 : 4 }, () => part.varint());
  sizes.push(...(exact ? [part.varint(), part.varint()] : []));
  const field = (i: number, lanes: number) => within(readIntegers(part.take(sizes[i]!), joints, lanes), MOST);
  const orders = Array.from(field(0, 1), (v, j) => (within1(v, 5) + of.orders[j]!) % 6);
  const kinds = Array.from(field(1, 3), (v, i) => (within1(v, 2) + of.kinds[i]!) % 3);
  let result: Limits;
  if (exact) {
    result = { orders, ranges: floats(part.take(sizes[2]!), 6 * joints), axes: floats(part.take(sizes[3]!), 4 * joints) };
  } else {
    const ten = 10 ** digits;
    const radians = (v: number) => (v / ten) * (Math.PI / 180);
    const ranges = Float64Array.from(field(2, 6), (v, i) => radians(v + ten * of.ranges[i]!));
    kinds.forEach((kind, i) => {
      if (kind !== RANGE) ranges.set(kind === LOCKED ? [0, 0] : [-Infinity, Infinity], 2 * i);
    });
    const angles = Float64Array.from(field(3, 3), (v, i) => radians(v + ten * of.frames[i]!));
    const axes = new Float64Array(4 * joints);
    for (let j = 0; j < joints; j++) axes.set(fromEuler(ORDERS[orders[j]!]!, angles.subarray(3 * j, 3 * j + 3)), 4 * j);
    result = { orders, ranges, axes };
  }
  part.end();
  for (let i = 0; i < 3 * joints; i++) check(result.ranges[2 * i]! <= result.ranges[2 * i + 1]!, "joint limits: an empty range");
  return result;
}

function reference(number: number, joints: number): Reference {
  if (number === 0) {
    const zeros = new Array<number>(6 * joints).fill(0);
    return { orders: zeros, kinds: zeros, ranges: zeros, frames: zeros };
  }
  const table = REFERENCE_LIMITS[number];
  check(table !== undefined && table.length === joints, "joint limits: a reference to another skeleton");
  const ranges = table.flatMap(([, entry]) => LIMIT_RANGES[entry!]!);
  const kinds = ranges.map(([least, greatest], i) => (i < 3 ? UNLIMITED : least === 0 && greatest === 0 ? LOCKED : RANGE));
  return { orders: table.map(([order]) => order!), kinds, ranges: ranges.flat(), frames: table.flatMap(([, , frame]) => LIMIT_FRAMES[frame!]!) };
}

function within(values: Float64Array, most: number): Float64Array {
  check(values.every((v) => Math.abs(v) <= most), "joint limits: a number is out of range");
  return values;
}

function within1(value: number, most: number): number {
  check(value >= 0 && value <= most, "joint limits: a number is out of range");
  return value;
}

function floats(data: Uint8Array, count: number): Float64Array {
  check(data.length === 8 * count, "joint limits: a wrong number of floats");
  const part = new Bytes(data, "joint limits");
  return Float64Array.from({ length: count }, () => part.float64());
}
