/** Rotations from targets by the kernel `joints` (wasm/kernels.cpp): rules as arrays, all frames of a chunk in one call. */

import { NO_ROTATION, type Quaternion, dot, lengthOf, rotated } from "../../../geometry.js";
import type { Kernels } from "../../../kernels.js";
import { HINGE, SWING } from "./joints.js";
import type { Rules } from "./solve.js";

const JOINT_FLOATS = 29;

/** Tables of all joints, of their carried vectors, and of the hinges below joints with the rule SWING. */
export interface Tables {
  /** (joints, 13): rule, parent, is at its target, branch, first side value, anchor, carried vectors, pair, hinges, own frame. */
  integers: BigInt64Array;
  /** (joints, 29): offset, usual rotation, the three constants and two axes of its form, direction, lever. */
  floats: Float64Array;
  targets: BigInt64Array;
  /** (carried vectors, 4): vector, weight. */
  carried: Float64Array;
  /** (hinges, 2): joint, is at its target. */
  hinges: BigInt64Array;
  /** (hinges, 5): axis, component of the aimed vector along it, scale. */
  hingeFloats: Float64Array;
}

export function tablesOf(rules: Rules): Tables {
  const integers: number[] = [];
  const floats: number[] = [];
  const targets: number[] = [];
  const carried: number[] = [];
  const hinges: number[] = [];
  const hingeFloats: number[] = [];
  rules.joints.forEach((joint, j) => {
    const { rule, placed, branch, first, pair, form, usual } = joint;
    const parent = rules.parents[j]!;
    const own = rules.carried[j]!;
    const turned = rule === SWING ? rules.children[j]!.filter((child) => rules.joints[child]!.rule === HINGE) : [];
    const held = Number(placed || parent < 0);
    const numbers = [own.targets.length, ...pair, hinges.length / 2, turned.length, Number(rules.ownFrame)];
    integers.push(rule, parent, held, branch, first, own.anchor, targets.length, ...numbers);
    const constants: Quaternion[] = form ? [form.constants[0]!, form.constants[form.axes.length - 1]!, form.constants.at(-1)!] : [];
    while (constants.length < 3) constants.push(NO_ROTATION);
    const axes = form ? [form.axes[0]!, form.axes.at(-1)!] : [[0, 0, 0], [0, 0, 0]];
    const aims = own.targets.length ? [...own.direction, own.lever] : [0, 0, 0, 0];
    floats.push(...rules.offsets[j]!, ...usual, ...constants.flat(), ...axes.flat(), ...aims);
    own.targets.forEach((target, i) => {
      targets.push(target);
      carried.push(...own.vectors[i]!, own.weights[i]!);
    });
    for (const child of turned) {
      const of = rules.carried[child]!;
      const hinge = rules.joints[child]!;
      const [before, after] = hinge.form!.constants as [Quaternion, Quaternion];
      const axis = hinge.form!.axes[0]!;
      hinges.push(child, Number(hinge.placed));
      hingeFloats.push(...rotated(before, axis), dot(axis, rotated(after, of.aimed)), of.lever / lengthOf(of.aimed));
    }
  });
  return {
    integers: BigInt64Array.from(integers, BigInt),
    floats: Float64Array.from(floats),
    targets: BigInt64Array.from(targets, BigInt),
    carried: Float64Array.from(carried),
    hinges: BigInt64Array.from(hinges, BigInt),
    hingeFloats: Float64Array.from(hingeFloats),
  };
}

/** Local rotations (frames, joints, 4) and positions (frames, joints, 3). points: targets (frames, joints, 3); side: (frames, values). */
export function solveAll(
  kernels: Kernels,
  { integers, floats, targets, carried, hinges, hingeFloats }: Tables,
  points: Float64Array,
  side: Float64Array,
  frames: number,
): { rotations: Float64Array; positions: Float64Array } | null {
  const joints = floats.length / JOINT_FLOATS;
  const counts = [frames, joints, side.length / frames, targets.length, hingeFloats.length / 5];
  const given = [...counts, points, side, integers, floats, targets, carried, hinges, hingeFloats];
  const found = kernels.call("joints", given, 7 * frames * joints);
  return found && { rotations: found.slice(0, 4 * frames * joints), positions: found.slice(4 * frames * joints) };
}
