/** "Rotations from targets" (docs/payloads/tempo-rotations.md): frame by frame, joint by joint. */

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
  SWING,
  UNIVERSAL_CODED,
  UNIVERSAL_REFINED,
} from "./joints.js";

const REFINEMENTS = 4;
const CODED_WEIGHT = 0.0009;
const HUB_STEPS = 3;

/** A skeleton and the rules of its rotations. */
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

/** State of a frame while its joints are solved. */
interface Frame {
  targets: Vector[];
  positions: Vector[];
  world: Quaternion[];
}

/** Solves the pose for targets and side values. */
export function solve(rules: Rules, targets: Vector[], side: ArrayLike<number>): Pose {
  const frame: Frame = { targets, positions: [], world: [] };
  const local: Quaternion[] = [];
  for (let j = 0; j < rules.joints.length; j++) {
    const joint = rules.joints[j]!;
    const parent = rules.parents[j]!;
    const isHeld = parent < 0 || joint.placed;
    const above = parent < 0 ? NO_ROTATION : frame.world[parent]!;
    if (isHeld) frame.positions[j] = targets[j]!;
    else if (!rules.ownFrame) frame.positions[j] = plus(frame.positions[parent]!, rotated(above, rules.offsets[j]!));
    const q = rotationOf(rules, j, frame, above, side);
    local.push(q);
    frame.world.push(multiplied(above, q));
    if (rules.ownFrame && !isHeld) frame.positions[j] = plus(frame.positions[parent]!, rotated(frame.world[j]!, rules.offsets[j]!));
  }
  return { local, positions: frame.positions };
}

/** Forward kinematics. held: positions of roots and, unless allFollow, of placed joints. */
export function forward(rules: Rules, local: Quaternion[], held: Vector[], allFollow = false): Vector[] {
  const world = worldOf(rules, local);
  const positions: Vector[] = [];
  rules.parents.forEach((parent, j) => {
    if (parent < 0 || (rules.joints[j]!.placed && !allFollow)) positions.push(held[j]!);
    else positions.push(plus(positions[parent]!, rotated(world[rules.ownFrame ? j : parent]!, rules.offsets[j]!)));
  });
  return positions;
}

/** World rotations from local rotations. */
export function worldOf(rules: Rules, local: Quaternion[]): Quaternion[] {
  const world: Quaternion[] = [];
  rules.parents.forEach((parent, j) => world.push(parent < 0 ? local[j]! : multiplied(world[parent]!, local[j]!)));
  return world;
}

function rotationOf(rules: Rules, j: number, frame: Frame, above: Quaternion, side: ArrayLike<number>): Quaternion {
  const joint = rules.joints[j]!;
  const { rule, first, form } = joint;
  if (rule === FIXED) return joint.usual;
  if (rule === FREE) return multiplied(joint.usual, unitQuaternion([side[first]!, side[first + 1]!, side[first + 2]!, side[first + 3]!]));
  if (rule === HINGE_CODED) return form!.rotation([side[first]!]);
  if (rule === UNIVERSAL_CODED) return form!.rotation([side[first]!, side[first + 1]!]);
  const carried = rules.carried[j]!;
  const back = inverse(above);
  const anchor = frame.positions[carried.anchor]!;
  const aims: Vector[] = [];
  for (const target of carried.targets) aims.push(rotated(back, minus(frame.targets[target]!, anchor)));
  if (rule === HUB) return hub(joint, carried, aims);
  if (rule === HINGE) return form!.rotation([hingeAngle(joint, carried, aims)]);
  if (rule === SWING) return swing(rules, j, frame, above, aims, side[first]!);
  return form!.rotation(twoAngles(joint, carried, aims, rule === UNIVERSAL_REFINED ? side[first]! : undefined));
}

function combined(weights: number[], vectors: Vector[]): Vector {
  let x = 0;
  let y = 0;
  let z = 0;
  for (let i = 0; i < vectors.length; i++) {
    const v = vectors[i]!;
    const weight = weights[i]!;
    x += weight * v[0];
    y += weight * v[1];
    z += weight * v[2];
  }
  return [x, y, z];
}

/** Terms (A, B, E) of "Refined angles". */
type Term = [number, number, number];

function refined(coded: number, terms: Term[]): number {
  let x = coded;
  for (let i = 0; i < REFINEMENTS; i++) {
    const cosine = Math.cos(x);
    const sine = Math.sin(x);
    let top = CODED_WEIGHT * (x - coded);
    let bottom = CODED_WEIGHT;
    for (const term of terms) {
      const [a, b, e] = term;
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
    // six entries of the inertia, a symmetric matrix; then the torque
    let [xx, yy, zz, xy, xz, yz] = [0, 0, 0, 0, 0, 0];
    let [tx, ty, tz] = [0, 0, 0];
    for (let i = 0; i < aims.length; i++) {
      const r = rotated(q, carried.vectors[i]!);
      const torque = cross(r, aims[i]!);
      tx += torque[0];
      ty += torque[1];
      tz += torque[2];
      const square = dot(r, r);
      xx += square - r[0] * r[0];
      yy += square - r[1] * r[1];
      zz += square - r[2] * r[2];
      xy -= r[0] * r[1];
      xz -= r[0] * r[2];
      yz -= r[1] * r[2];
    }
    const t = solved([xx, xy, xz], [xy, yy, yz], [xz, yz, zz], [tx, ty, tz]);
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

/** Solves the 3 × 3 system with columns a, b, c; zero for a singular system. */
function solved(a: Vector, b: Vector, c: Vector, v: Vector): Vector {
  const determinant = dot(a, cross(b, c));
  if (!(Math.abs(determinant) > 1e-30)) return [0, 0, 0];
  return [dot(v, cross(b, c)) / determinant, dot(a, cross(v, c)) / determinant, dot(a, cross(b, v)) / determinant];
}

function hingeAngle(joint: JointRule, carried: Carried, aims: Vector[]): number {
  const [before, after] = joint.form!.constants as [Quaternion, Quaternion];
  const axis = joint.form!.axes[0]!;
  const back = inverse(before);
  let sine = 0;
  let cosine = 0;
  for (let i = 0; i < aims.length; i++) {
    const u = rotated(after, carried.vectors[i]!);
    const e = rotated(back, aims[i]!);
    sine += dot(cross(axis, u), e);
    cosine += dot(u, e) - dot(axis, u) * dot(axis, e);
  }
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

/** Term of a hinge below a SWING joint, which determines the joint's twist. world: the joint's world rotation so far. */
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
