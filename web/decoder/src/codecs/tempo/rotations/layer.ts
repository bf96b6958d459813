/** The second shared blob of a stream with rotations (docs/payloads/tempo-rotations.md). */

import { Bytes } from "../../../bytes.js";
import { ORDERS } from "../../../container/orders.js";
import type { Skeleton } from "../../../container/skeleton.js";
import { check } from "../../../errors.js";
import { NO_ROTATION, type Quaternion, type Vector, aboutAxis, lengthOf, matrixOf } from "../../../geometry.js";
import { readIntegers } from "../../../integers/read.js";
import { completedBasis, readStoredBasis, statisticsOf } from "../model.js";
import type { Statistics } from "../coefficients.js";
import { type Matrix, cholesky, divide, matrix } from "../ordered.js";
import type { Prior } from "../prior.js";
import {
  FIXED,
  FREE_ANGLES,
  FREE,
  Form,
  HINGE,
  HINGE_CODED,
  HUB,
  type JointRule,
  SIDE_VALUES,
  SWING,
  UNIVERSAL,
  UNIVERSAL_CODED,
  UNIVERSAL_REFINED,
  carriedVectors,
} from "./joints.js";
import { REFERENCE_RULES } from "./reference.js";
import { type Rules, forward, solve, worldOf } from "./solve.js";

const LIMITS_FORM = 7;
const MOST_USUAL = 64;
const DIFFERENCE = 1e-4;
const RIDGE = 1e-5;
const NOTHING = -4000;
const NUMBER_COLUMNS = 5;

export interface Layer {
  rules: Rules;
  /** Distance of shell points from their joints, metres. */
  reach: number;
  /** Nominal side values. */
  nominal: Float64Array;
  statistics: Statistics;
  /** Maps coefficients to side values minus the nominal ones: (side values, side values). */
  toSide: Matrix;
}

/** Constants of joints, read one after the other. */
class Constants {
  constructor(
    private readonly floats: number[],
    private readonly angles: number[],
  ) {}

  float(): number {
    const value = this.floats.shift();
    check(value !== undefined && Number.isFinite(value), "tempo: a constant of a rotation is missing");
    return value;
  }

  angle(): number {
    const value = this.angles.shift();
    check(value !== undefined, "tempo: a constant angle of a rotation is missing");
    return value;
  }

  end(): void {
    check(this.floats.length === 0 && this.angles.length === 0, "tempo: more constants than the joints' rotations have");
  }
}

/** Reads the layer. priorOf: loads the prior with an identifier. */
export async function readLayer(data: Uint8Array, skeleton: Skeleton | undefined, priorOf: (id: string) => Promise<Prior>): Promise<Layer> {
  check(skeleton !== undefined, "tempo: rotations without a skeleton");
  const joints = skeleton.parents.length;
  const part = new Bytes(data, "tempo");
  const ownFrame = part.varintWithin(0, 1, "the convention") === 1;
  const units = part.varintWithin(0, 2 ** 20, "the reach");
  const reach = units ? units / 10_000 : part.float64();
  check(reach > 0 && Number.isFinite(reach), "tempo: a reach that is not positive");
  const reference = part.varintWithin(0, joints === REFERENCE_RULES.length ? 1 : 0, "the reference");
  const digits = part.varintWithin(0, 6, "the digits of angles");
  const numberCount = part.varint();
  const angleCount = part.varint();
  const sizes = Array.from({ length: 4 }, () => part.varint());
  const table = readIntegers(part.take(sizes[0]!), joints, NUMBER_COLUMNS);
  const usual = readIntegers(part.take(sizes[1]!), joints, 3);
  check(angleCount <= 3 * joints && numberCount <= 4 * joints, "tempo: more constants than the joints' rotations have");
  const angles = Array.from(readIntegers(part.take(sizes[2]!), angleCount, 1), (step) => (step / 10 ** digits) * (Math.PI / 180));
  check(sizes[3] === 8 * numberCount, "tempo: constants of a wrong size");
  const constants = new Constants(Array.from({ length: numberCount }, () => part.float64()), angles);
  const found: JointRule[] = [];
  for (let j = 0; j < joints; j++) {
    const known = reference ? REFERENCE_RULES[j]! : [];
    const row = Array.from({ length: NUMBER_COLUMNS }, (_, i) => table[NUMBER_COLUMNS * j + i]! + (known[i] ?? 0));
    const turn = Array.from({ length: 3 }, (_, i) => usual[3 * j + i]! + (known[NUMBER_COLUMNS + i] ?? 0)) as Vector;
    found.push(ruleOf(row, turn, constants, skeleton, j));
  }
  constants.end();
  const rules = rulesOf(found, skeleton, ownFrame);
  const nominal = Float64Array.from(found.flatMap(nominalOf));
  const id = Array.from(part.take(4), (byte) => byte.toString(16).padStart(2, "0")).join("");
  const prior = await priorOf(id);
  return { rules, reach, nominal, ...basisOf(part, nominal, rules, reach, prior) };
}

function ruleOf(row: number[], turn: Vector, constants: Constants, skeleton: Skeleton, j: number): JointRule {
  const [rule, flags, form, locked, pair] = row as [number, number, number, number, number];
  const joints = skeleton.parents.length;
  check(row.every((v) => v >= 0) && rule < SIDE_VALUES.length && flags <= 3 && form <= LIMITS_FORM, "tempo: an unknown rule for a rotation");
  const placed = (flags & 1) === 1;
  const common = { rule, placed, branch: (flags & 2 ? -1 : 1) as 1 | -1, first: 0 };
  if (rule === FIXED) return { ...common, usual: fixedRotation(form, constants, skeleton, j), pair: [0, 0], form: undefined };
  check(turn.every((v) => Math.abs(v) <= MOST_USUAL), "tempo: a usual rotation that is out of range");
  const found = form ? formOf(form, locked, constants, skeleton, j) : undefined;
  check((found ? found.free.length : 3) === FREE_ANGLES[rule], "tempo: the number of axes does not match the rule");
  return { ...common, usual: usualRotation(turn), pair: [Math.floor(pair / joints), pair % joints], form: found };
}

/** The rotation of a rotation vector in 1/16 rad. */
function usualRotation(turn: Vector): Quaternion {
  const vector = turn.map((v) => v / 16) as Vector;
  const size = lengthOf(vector);
  return size ? aboutAxis(vector.map((v) => v / size) as Vector, size) : NO_ROTATION;
}

function fixedRotation(form: number, constants: Constants, skeleton: Skeleton, j: number): Quaternion {
  if (form === LIMITS_FORM) {
    const found = formOf(form, 0, constants, skeleton, j);
    return found.rotation(found.free.map(() => constants.angle()));
  }
  check(form <= 1, "tempo: a constant rotation of an unknown form");
  const q: Quaternion = form ? [constants.float(), constants.float(), constants.float(), constants.float()] : NO_ROTATION;
  check(Math.abs(q.reduce((sum, v) => sum + v * v, 0) - 1) <= 1e-6, "tempo: a constant rotation that is not a unit quaternion");
  return q;
}

function formOf(form: number, locked: number, constants: Constants, skeleton: Skeleton, j: number): Form {
  if (form === LIMITS_FORM) {
    const { limits } = skeleton;
    check(limits !== undefined, "tempo: rotations that need the joint limits of the skeleton");
    const isLocked = [0, 1, 2].map((axis) => limits.ranges[6 * j + 2 * axis] === 0 && limits.ranges[6 * j + 2 * axis + 1] === 0);
    const frame = limits.axes.slice(4 * j, 4 * j + 4);
    return new Form(ORDERS[limits.orders[j]!]!, Array.from(frame) as Quaternion, isLocked.map((zero) => (zero ? 0 : null)));
  }
  const kinds = [Math.floor(locked / 9), Math.floor(locked / 3) % 3, locked % 3];
  check(kinds[0]! <= 2, "tempo: an unknown kind of angle");
  return new Form(ORDERS[form - 1]!, NO_ROTATION, kinds.map((kind) => (kind === 0 ? null : kind === 1 ? 0 : constants.float())));
}

function rulesOf(joints: JointRule[], skeleton: Skeleton, ownFrame: boolean): Rules {
  const { parents } = skeleton;
  const offsets = parents.map((_, j) => Array.from(skeleton.offsets.subarray(3 * j, 3 * j + 3)) as Vector);
  const children: number[][] = parents.map(() => []);
  let first = 0;
  parents.forEach((parent, j) => {
    check(parent < j, "tempo: rotations of a skeleton whose parents do not come first");
    if (parent >= 0) children[parent]!.push(j);
    joints[j]!.first = first;
    first += SIDE_VALUES[joints[j]!.rule]!;
  });
  const carried = carriedVectors(joints, parents, offsets, children, ownFrame);
  joints.forEach(({ rule, pair }, j) => {
    const count = carried[j]!.vectors.length;
    if (rule === HUB) check(Math.max(...pair) < count && pair[0] !== pair[1], "tempo: a hub without two vectors");
    if ([SWING, HINGE, UNIVERSAL, UNIVERSAL_REFINED].includes(rule)) check(count > 0, "tempo: a rotation without a carried vector");
  });
  return { parents, children, offsets, ownFrame, joints, carried };
}

function nominalOf({ rule, form, usual }: JointRule): number[] {
  if (rule === SWING) return [0];
  if (rule === FREE) return [1, 0, 0, 0];
  if (rule === HINGE_CODED || rule === UNIVERSAL_CODED) return form!.angles(usual);
  return rule === UNIVERSAL_REFINED ? form!.angles(usual).slice(1) : [];
}

/** Statistics of the side values, and the map from their coefficients. */
function basisOf(part: Bytes, nominal: Float64Array, rules: Rules, reach: number, prior: Prior): { statistics: Statistics; toSide: Matrix } {
  const count = nominal.length;
  let statistics: Statistics;
  let toSide = matrix(0, 0);
  if (count === 0) {
    part.end();
    statistics = statisticsOf(prior, "", 0);
  } else {
    const stored = readStoredBasis(part, count, null, prior);
    statistics = stored.statistics;
    toSide = divide(completedBasis(stored.known), factorOf(rules, nominal, reach));
  }
  statistics.spreads.fill(NOTHING, 0, 4 * 18);
  statistics.means.fill(NOTHING, 0, 4);
  return { statistics, toSide };
}

/** L: the Cholesky factor of JᵀJ + ridge, J the derivatives of joints and shell points by side values at the usual pose. */
function factorOf(rules: Rules, nominal: Float64Array, reach: number): Matrix {
  const count = nominal.length;
  const targets = forward(rules, rules.joints.map((joint) => joint.usual), rules.offsets, true);
  const derivatives = Array.from({ length: count }, (_, i) => {
    const [after, before] = [DIFFERENCE, -DIFFERENCE].map((change) => {
      const side = nominal.slice();
      side[i]! += change;
      return shellPoints(rules, targets, side, reach);
    });
    return after!.map((v, k) => (v - before![k]!) / (2 * DIFFERENCE));
  });
  const g = matrix(count, count);
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < count; k++) g.data[i * count + k] = derivatives[i]!.reduce((sum, v, n) => sum + v * derivatives[k]![n]!, 0);
  }
  let largest = reach * reach;
  for (let i = 0; i < count; i++) largest = Math.max(largest, g.data[i * count + i]!);
  for (let i = 0; i < count; i++) g.data[i * count + i]! += RIDGE * largest;
  return cholesky(g);
}

/** Each joint and its three shell points in a frame, (joints, 4, 3). */
function shellPoints(rules: Rules, targets: Vector[], side: Float64Array, reach: number): Float64Array {
  const { local, positions } = solve(rules, targets, side);
  const out = new Float64Array(12 * positions.length);
  worldOf(rules, local).forEach((q, j) => {
    const m = matrixOf(q);
    for (let c = 0; c < 3; c++) {
      out[12 * j + c] = positions[j]![c]!;
      for (let k = 0; k < 3; k++) out[12 * j + 3 + 3 * k + c] = positions[j]![c]! + reach * m[3 * c + k]!;
    }
  });
  return out;
}
