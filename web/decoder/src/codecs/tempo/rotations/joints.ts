/** Rules that give joint rotations from targets (docs/payloads/tempo-rotations.md). */

import { check } from "../../../errors.js";
import {
  NO_ROTATION,
  type Quaternion,
  type Vector,
  about,
  aboutAxis,
  inverse,
  lengthOf,
  multiplied,
  normalised,
  plus,
  times,
  toEuler,
} from "../../../geometry.js";

export const FIXED = 0;
export const HUB = 1;
export const SWING = 2;
export const FREE = 3;
export const HINGE = 4;
export const HINGE_CODED = 5;
export const UNIVERSAL = 6;
export const UNIVERSAL_REFINED = 7;
export const UNIVERSAL_CODED = 8;

/** Numbers of side values and of free angles for each rule. */
export const SIDE_VALUES = [0, 0, 1, 4, 0, 1, 0, 1, 2] as const;
export const FREE_ANGLES = [0, 3, 3, 3, 1, 1, 2, 2, 2] as const;

/** A rotation with one or two free angles: before · Rot(first) · (between · Rot(second) ·) after. */
export class Form {
  /** Constant rotations before, between and after the free axes. */
  readonly constants: Quaternion[];
  readonly axes: Vector[] = [];
  /** Indices of the free angles among the three. */
  readonly free: number[] = [];

  /** locked: the three angles in radians; null: free. */
  constructor(
    private readonly order: string,
    private readonly frame: Quaternion,
    private readonly locked: (number | null)[],
  ) {
    this.constants = [frame];
    locked.forEach((angle, i) => {
      const axis = "xyz".indexOf(order[i]!);
      if (angle !== null) {
        this.constants.push(multiplied(this.constants.pop()!, about(axis, angle)));
        return;
      }
      this.free.push(i);
      this.axes.push([axis === 0 ? 1 : 0, axis === 1 ? 1 : 0, axis === 2 ? 1 : 0]);
      this.constants.push(NO_ROTATION);
    });
    this.constants.push(multiplied(this.constants.pop()!, inverse(frame)));
  }

  rotation(angles: ArrayLike<number>): Quaternion {
    let q = this.constants[0]!;
    for (let i = 0; i < this.free.length; i++) q = multiplied(multiplied(q, aboutAxis(this.axes[i]!, angles[i]!)), this.constants[i + 1]!);
    return q;
  }

  /** "Angles of a rotation", for the free axes. */
  angles(q: Quaternion): number[] {
    const m = multiplied(multiplied(inverse(this.frame), q), this.frame);
    if (this.locked.some((angle) => angle !== null && angle !== 0)) {
      const all = toEuler(this.order, m);
      return this.free.map((place) => all[place]!);
    }
    const letters = this.free.map((place) => this.order[place]!);
    if (letters.length === 1) return [withinHalfTurn(2 * Math.atan2(m["xyz".indexOf(letters[0]!) + 1]!, m[0]))];
    if (letters.length === 3) return toEuler(this.order, m);
    const third = Array.from("xyz").find((letter) => !letters.includes(letter))!;
    const [first, , last] = toEuler(letters[0]! + third + letters[1]!, m);
    return [first, last];
  }
}

/** Wraps an angle into −π … π. */
function withinHalfTurn(angle: number): number {
  const turn = 2 * Math.PI;
  return angle - turn * Math.floor((angle + Math.PI) / turn);
}

export interface JointRule {
  rule: number;
  /** Whether the joint's position is its target. */
  placed: boolean;
  /** Sign of the second branch of UNIVERSAL. */
  branch: 1 | -1;
  /** A typical rotation; for FIXED the constant rotation. */
  usual: Quaternion;
  /** Numbers of the two carried vectors of a HUB. */
  pair: [number, number];
  form: Form | undefined;
  /** Index of the joint's first side value. */
  first: number;
}

/** Targets that a joint carries, the vectors to them in its frame, and values computed from these. */
export interface Carried {
  /** The joint at which the vectors begin. */
  anchor: number;
  targets: number[];
  vectors: Vector[];
  weights: number[];
  /** Σ weight · vector, and its direction. */
  aimed: Vector;
  direction: Vector;
  lever: number;
}

const SHORTEST_M = 1e-4;

/** "Carried vectors" of all joints. children: children of each joint, in order. */
export function carriedVectors(rules: JointRule[], parents: number[], offsets: Vector[], children: number[][], ownFrame: boolean): Carried[] {
  const lists: { targets: number[]; vectors: Vector[] }[] = rules.map(() => ({ targets: [], vectors: [] }));
  const anchors = rules.map((_, j) => j);
  for (let j = rules.length - 1; j >= 0; j--) {
    const list = lists[j]!;
    let start: Vector = [0, 0, 0];
    if (ownFrame && parents[j]! >= 0 && !rules[j]!.placed) {
      anchors[j] = parents[j]!;
      start = offsets[j]!;
      list.targets.push(j);
      list.vectors.push(start);
    }
    for (const child of children[j]!) {
      const { rule, placed, usual } = rules[child]!;
      if (placed) continue;
      const from = ownFrame ? start : offsets[child]!;
      if (!ownFrame) {
        list.targets.push(child);
        list.vectors.push(from);
      }
      if (rule !== FIXED) continue;
      const of = lists[child]!;
      of.vectors.forEach((v, i) => {
        if (lengthOf(v) <= SHORTEST_M) return;
        list.targets.push(of.targets[i]!);
        list.vectors.push(plus(from, rotatedBy(usual, v)));
      });
    }
    check(list.vectors.length <= 4 * rules.length, "tempo: a joint that carries too many vectors");
  }
  return lists.map((list, j) => withWeights(anchors[j]!, list));
}

function rotatedBy(q: Quaternion, v: Vector): Vector {
  const rotated = multiplied(multiplied(q, [0, ...v]), inverse(q));
  return [rotated[1], rotated[2], rotated[3]];
}

function withWeights(anchor: number, list: { targets: number[]; vectors: Vector[] }): Carried {
  const kept = list.vectors.flatMap((v, i) => (lengthOf(v) > SHORTEST_M ? [i] : []));
  const vectors = kept.map((i) => list.vectors[i]!);
  const targets = kept.map((i) => list.targets[i]!);
  let longest: Vector = [0, 0, 0];
  for (const v of vectors) if (lengthOf(v) > lengthOf(longest)) longest = v;
  const m = vectors.length ? normalised(longest) : longest;
  const weights = vectors.map((v) => v[0] * m[0] + v[1] * m[1] + v[2] * m[2]);
  const aimed = vectors.reduce<Vector>((sum, v, i) => plus(sum, times(weights[i]!, v)), [0, 0, 0]);
  const size = Math.sqrt(weights.reduce((sum, w) => sum + w * w, 0));
  return { anchor, targets, vectors, weights, aimed, direction: vectors.length ? normalised(aimed) : aimed, lever: lengthOf(aimed) / size };
}
