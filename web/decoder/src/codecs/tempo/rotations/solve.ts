/** "Rotations from targets" (docs/payloads/tempo-rotations.md): one frame at a time, joints in their order. */

import {
  NO_ROTATION,
  type Quaternion,
  type Vector,
  aboutAxis,
  cross,
  dot,
  fromMatrix,
  inverse,
  lengthOf,
  matrixOf,
  minus,
  multiplied,
  normalised,
  plus,
  rotated,
  times,
  unitQuaternion,
} from "../../../geometry.js";
import {
  type Carried,
  FIXED,
  FREE,
  HINGE,
  HINGE_CODED,
  HUB,
  type JointRule,
  SIDE_VALUES,
  SWING,
  UNIVERSAL_CODED,
  UNIVERSAL_REFINED,
} from "./joints.js";

const REFINEMENTS = 4;
const CODED_WEIGHT = 0.0009;
const HUB_STEPS = 3;

/** A skeleton and how its rotations follow. */
export interface Rules {
  parents: number[];
  children: number[][];
  offsets: Vector[];
  ownFrame: boolean;
  joints: JointRule[];
  carried: Carried[];
}

/** Local rotations and positions of one frame. */
export interface Pose {
  local: Quaternion[];
  positions: Vector[];
}

/** What is known of a frame while its joints are solved. */
interface Frame {
  targets: Vector[];
  positions: Vector[];
  world: Quaternion[];
}

/** The pose of targets and side values. */
export function solve(rules: Rules, targets: Vector[], side: ArrayLike<number>): Pose {
  const frame: Frame = { targets, positions: [], world: [] };
  const local: Quaternion[] = [];
  rules.joints.forEach((joint, j) => {
    const parent = rules.parents[j]!;
    const isHeld = parent < 0 || joint.placed;
    const above = parent < 0 ? NO_ROTATION : frame.world[parent]!;
    if (isHeld) frame.positions[j] = targets[j]!;
    else if (!rules.ownFrame) frame.positions[j] = plus(frame.positions[parent]!, rotated(above, rules.offsets[j]!));
    const q = rotationOf(rules, j, frame, above, side);
    local.push(q);
    frame.world.push(multiplied(above, q));
    if (rules.ownFrame && !isHeld) frame.positions[j] = plus(frame.positions[parent]!, rotated(frame.world[j]!, rules.offsets[j]!));
  });
  return { local, positions: frame.positions };
}

/** Positions by forward kinematics; `held` are those of roots and, unless all follow, of placed joints. */
export function forward(rules: Rules, local: Quaternion[], held: Vector[], allFollow = false): Vector[] {
  const world = worldOf(rules, local);
  const positions: Vector[] = [];
  rules.parents.forEach((parent, j) => {
    if (parent < 0 || (rules.joints[j]!.placed && !allFollow)) positions.push(held[j]!);
    else positions.push(plus(positions[parent]!, rotated(world[rules.ownFrame ? j : parent]!, rules.offsets[j]!)));
  });
  return positions;
}

/** World rotations of local ones. */
export function worldOf(rules: Rules, local: Quaternion[]): Quaternion[] {
  const world: Quaternion[] = [];
  rules.parents.forEach((parent, j) => world.push(parent < 0 ? local[j]! : multiplied(world[parent]!, local[j]!)));
  return world;
}

function rotationOf(rules: Rules, j: number, frame: Frame, above: Quaternion, side: ArrayLike<number>): Quaternion {
  const joint = rules.joints[j]!;
  const { rule, first, form } = joint;
  const values = Array.from({ length: SIDE_VALUES[rule]! }, (_, i) => side[first + i]!);
  if (rule === FIXED) return joint.usual;
  if (rule === FREE) return multiplied(joint.usual, unitQuaternion(values));
  if (rule === HINGE_CODED || rule === UNIVERSAL_CODED) return form!.rotation(values);
  const carried = rules.carried[j]!;
  const back = inverse(above);
  const anchor = frame.positions[carried.anchor]!;
  const aims = carried.targets.map((target) => rotated(back, minus(frame.targets[target]!, anchor)));
  if (rule === HUB) return hub(joint, carried, aims);
  if (rule === HINGE) return form!.rotation([hingeAngle(joint, carried, aims)]);
  if (rule === SWING) return swing(rules, j, frame, above, aims, values[0]!);
  return form!.rotation(twoAngles(joint, carried, aims, rule === UNIVERSAL_REFINED ? values[0] : undefined));
}

function combined(weights: number[], vectors: Vector[]): Vector {
  return vectors.reduce<Vector>((sum, v, i) => plus(sum, times(weights[i]!, v)), [0, 0, 0]);
}

/** Terms (A, B, E) of "Refined angles". */
type Term = [number, number, number];

function refined(coded: number, terms: Term[]): number {
  let x = coded;
  for (let i = 0; i < REFINEMENTS; i++) {
    const [cosine, sine] = [Math.cos(x), Math.sin(x)];
    let top = CODED_WEIGHT * (x - coded);
    let bottom = CODED_WEIGHT;
    for (const [a, b, e] of terms) {
      const slope = b * cosine - a * sine;
      top += slope * (a * cosine + b * sine - e);
      bottom += slope * slope;
    }
    x -= top / bottom;
  }
  return x;
}

function hub(joint: JointRule, carried: Carried, aims: Vector[]): Quaternion {
  const [a, b] = joint.pair;
  let q = multiplied(pairFrame(aims[a]!, aims[b]!), inverse(pairFrame(carried.vectors[a]!, carried.vectors[b]!)));
  for (let step = 0; step < HUB_STEPS; step++) {
    const inertia = new Float64Array(9);
    let torque: Vector = [0, 0, 0];
    carried.vectors.forEach((v, i) => {
      const r = rotated(q, v);
      torque = plus(torque, cross(r, aims[i]!));
      const square = dot(r, r);
      for (let m = 0; m < 3; m++) for (let n = 0; n < 3; n++) inertia[3 * m + n]! += (m === n ? square : 0) - r[m]! * r[n]!;
    });
    const t = solved(inertia, torque);
    q = multiplied(unitQuaternion([1, t[0] / 2, t[1] / 2, t[2] / 2]), q);
  }
  return fromMatrix(matrixOf(unitQuaternion(q)));
}

/** The rotation whose columns are x along a, z along a × b, y = z × x. */
function pairFrame(a: Vector, b: Vector): Quaternion {
  const x = normalised(a);
  const z = normalised(cross(x, b));
  const y = cross(z, x);
  return fromMatrix([x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]]);
}

/** The solution of a symmetric system (3, 3), zero for a singular one. */
function solved(m: Float64Array, v: Vector): Vector {
  const column = (i: number): Vector => [m[i]!, m[3 + i]!, m[6 + i]!];
  const [a, b, c] = [column(0), column(1), column(2)];
  const determinant = dot(a, cross(b, c));
  if (!(Math.abs(determinant) > 1e-30)) return [0, 0, 0];
  return [dot(v, cross(b, c)) / determinant, dot(a, cross(v, c)) / determinant, dot(a, cross(b, v)) / determinant];
}

function hingeAngle(joint: JointRule, carried: Carried, aims: Vector[]): number {
  const [before, after] = joint.form!.constants as [Quaternion, Quaternion];
  const axis = joint.form!.axes[0]!;
  const back = inverse(before);
  let [sine, cosine] = [0, 0];
  carried.vectors.forEach((v, i) => {
    const u = rotated(after, v);
    const e = rotated(back, aims[i]!);
    sine += dot(cross(axis, u), e);
    cosine += dot(u, e) - dot(axis, u) * dot(axis, e);
  });
  return Math.atan2(sine, cosine);
}

function twoAngles(joint: JointRule, carried: Carried, aims: Vector[], coded: number | undefined): [number, number] {
  const [before, between, after] = joint.form!.constants as [Quaternion, Quaternion, Quaternion];
  const [a, b] = joint.form!.axes as [Vector, Vector];
  const w = rotated(after, carried.direction);
  const e = rotated(inverse(before), normalised(combined(carried.weights, aims)));
  const n = rotated(inverse(between), a);
  const along = times(dot(b, w), b);
  const across = minus(w, along);
  const side = cross(b, w);
  const [termA, termB, height] = [dot(n, across), dot(n, side), dot(e, a) - dot(n, along)];
  let second: number;
  if (coded === undefined) {
    const ratio = Math.min(1, Math.max(-1, height / Math.sqrt(termA * termA + termB * termB)));
    second = Math.atan2(termB, termA) + joint.branch * Math.acos(ratio);
  } else {
    const { lever } = carried;
    second = refined(coded, [[lever * termA, lever * termB, lever * height]]);
  }
  const turned = plus(along, plus(times(Math.cos(second), across), times(Math.sin(second), side)));
  const u = rotated(between, turned);
  return [Math.atan2(dot(cross(u, e), a), dot(u, e) - dot(u, a) * dot(e, a)), second];
}

function swing(rules: Rules, j: number, frame: Frame, above: Quaternion, aims: Vector[], twist: number): Quaternion {
  const { usual } = rules.joints[j]!;
  const { direction, weights } = rules.carried[j]!;
  const u = rotated(usual, direction);
  const e = normalised(combined(weights, aims));
  const n = unitQuaternion([1 + dot(u, e), ...cross(u, e)]);
  const q = multiplied(multiplied(n, usual), aboutAxis(direction, twist));
  const hinges = rules.children[j]!.filter((child) => rules.joints[child]!.rule === HINGE);
  if (hinges.length === 0) return q;
  const world = multiplied(above, q);
  return multiplied(q, aboutAxis(direction, refined(0, hinges.map((child) => hingeTerm(rules, j, child, frame, world)))));
}

/** What a hinge below a swung joint shows of its twist. world: the joint's world rotation so far. */
function hingeTerm(rules: Rules, j: number, child: number, frame: Frame, world: Quaternion): Term {
  const { form, placed } = rules.joints[child]!;
  const carried = rules.carried[child]!;
  const { direction } = rules.carried[j]!;
  let start: Vector;
  if (rules.ownFrame) {
    const parent = rules.parents[j]!;
    const isHeld = rules.joints[j]!.placed || parent < 0;
    start = isHeld ? frame.positions[j]! : plus(frame.positions[parent]!, rotated(world, rules.offsets[j]!));
  } else {
    start = placed ? frame.targets[child]! : plus(frame.positions[j]!, rotated(world, rules.offsets[child]!));
  }
  const back = inverse(world);
  const seen = combined(
    carried.weights,
    carried.targets.map((target) => rotated(back, minus(frame.targets[target]!, start))),
  );
  const [before, after] = form!.constants as [Quaternion, Quaternion];
  const axis = form!.axes[0]!;
  const sigma = carried.lever / lengthOf(carried.aimed);
  const a = rotated(before, axis);
  const along = times(dot(direction, a), direction);
  const of = dot(axis, rotated(after, carried.aimed));
  return [sigma * dot(seen, minus(a, along)), sigma * dot(seen, cross(direction, a)), sigma * (of - dot(seen, along))];
}
