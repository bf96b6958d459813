/** Trees of bones (docs/payloads/tempo-models.md, "Trees of bones"). */

import { check } from "../../errors.js";
import { halfToEven } from "../../numbers.js";
import { type Matrix, cross, length, matrix, product, rowOf, sum, transposed, unit } from "./ordered.js";
import { nearestRotation } from "./kabsch.js";
import type { Prior } from "./prior.js";

const SHORTEST_BONE_M = 1e-7;
const BODY = -1;

type Vector = [number, number, number];

/** A unit with its own rotation: a bone outside hubs, or a hub of bones at constant angles. */
export interface Joint {
  isHub: boolean;
  /** The bone; for a hub its first bone. */
  bone: number;
  /** Index of the joint that this one's rotation is relative to; BODY = −1. */
  reference: number;
  /** First of its 2 (bone) or 3 (hub) dimensions. */
  dimension: number;
  /** Axes of a bone at rest. */
  first: Vector;
  second: Vector;
}

export class Tree {
  readonly points: number;
  readonly lengths: Float64Array;
  /** Bones with a direction, in order. */
  readonly moves: number[];
  /** Joints in the order of their rotation: references first. */
  readonly joints: Joint[] = [];
  /** Index in `joints` of each bone, −1 for one without direction. */
  readonly jointOf: Int32Array;
  readonly dimensions: number;

  /** parents: before their children; vectors (points, 3) in metres; hub, relative: marks of each point. */
  constructor(
    readonly parents: number[],
    readonly vectors: Float64Array,
    readonly hub: boolean[],
    readonly relative: boolean[],
  ) {
    this.points = parents.length;
    this.lengths = Float64Array.from(parents, (_, j) => length(vectors.subarray(3 * j, 3 * j + 3)));
    this.moves = parents.flatMap((parent, j) => (parent >= 0 && this.lengths[j]! > SHORTEST_BONE_M ? [j] : []));
    this.jointOf = new Int32Array(this.points).fill(-1);
    this.findJoints();
    const bones = this.joints.filter((joint) => !joint.isHub);
    const hubs = this.joints.filter((joint) => joint.isHub);
    bones.forEach((joint, i) => (joint.dimension = 2 * i));
    hubs.forEach((joint, i) => (joint.dimension = 2 * bones.length + 3 * i));
    this.dimensions = 2 * bones.length + 3 * hubs.length;
  }

  /** Finds joints and their references, point by point. at: the joint that bones at a point are relative to. */
  private findJoints(): void {
    const at: number[] = [];
    const hubAt = new Map<number, number>();
    const moves = new Set(this.moves);
    this.parents.forEach((parent, j) => {
      at[j] = parent >= 0 ? at[parent]! : BODY;
      if (!moves.has(j)) return;
      const hub = hubAt.get(parent);
      if (this.hub[j]) {
        if (hub === undefined) hubAt.set(parent, this.joints.length);
        at[j] = hub ?? this.add(j, this.relative[j] ? at[parent]! : BODY);
      } else {
        at[j] = this.add(j, this.relative[j] ? (hub ?? at[parent]!) : BODY);
      }
      this.jointOf[j] = at[j]!;
    });
  }

  private add(bone: number, reference: number): number {
    const isHub = this.hub[bone]!;
    const none: Vector = [0, 0, 0];
    const axes = isHub ? { first: none, second: none } : axesOf(this.vectors.subarray(3 * bone, 3 * bone + 3));
    return this.joints.push({ isHub, bone, reference, dimension: 0, ...axes }) - 1;
  }

  /** Bones of a hub, in order. */
  bonesOf(joint: number): number[] {
    return this.moves.filter((j) => this.jointOf[j] === joint);
  }

  /** Throws Corrupt unless there is a bone with a direction, each hub has two, and no bone is too long. */
  check(): void {
    check(this.moves.length > 0, "tempo: a tree without bones");
    const bones = new Int32Array(this.joints.length);
    for (const j of this.moves) bones[this.jointOf[j]!]!++;
    check(this.joints.every((joint, i) => !joint.isHub || bones[i]! >= 2), "tempo: a hub of one bone");
    check(this.lengths.every((size) => size < 1e9), "tempo: a bone that is too long");
  }

  /** RESIZE: the tree with the bone lengths of a skeleton. offsets: (points, 3). */
  resized(offsets: Float64Array): Tree {
    const vectors = new Float64Array(this.vectors.length);
    for (let j = 0; j < this.points; j++) {
      const factor = length(offsets.subarray(3 * j, 3 * j + 3)) / Math.max(this.lengths[j]!, 1e-30);
      for (let c = 3 * j; c < 3 * j + 3; c++) vectors[c] = this.vectors[c]! * factor;
    }
    this.joints.forEach((joint, i) => {
      if (!joint.isHub) return;
      const bones = this.bonesOf(i);
      const turn = nearestRotation(bones.map((j) => offsets.subarray(3 * j, 3 * j + 3)), bones.map((j) => this.vectors.subarray(3 * j, 3 * j + 3)));
      for (const j of bones) {
        const [x, y, z] = [offsets[3 * j]!, offsets[3 * j + 1]!, offsets[3 * j + 2]!];
        for (let r = 0; r < 3; r++) vectors[3 * j + r] = turn[3 * r]! * x + turn[3 * r + 1]! * y + turn[3 * r + 2]! * z;
      }
    });
    return new Tree(this.parents, vectors, this.hub, this.relative);
  }
}

/** Axes of a bone at rest, in ordered arithmetic. */
function axesOf(vector: ArrayLike<number>): { first: Vector; second: Vector } {
  const d = unit(vector);
  let k = 0;
  for (let c = 1; c < 3; c++) if (Math.abs(d[c]!) < Math.abs(d[k]!)) k = c;
  const along = d[k]!; // e · d, where e is a unit vector of axis k
  const first = unit([(k === 0 ? 1 : 0) - d[0] * along, (k === 1 ? 1 : 0) - d[1] * along, (k === 2 ? 1 : 0) - d[2] * along]);
  return { first, second: cross(d, first) };
}

/** Offsets of a skeleton, rounded to 10 µm, halves to even. */
export function roundedOffsets(offsets: Float64Array): Float64Array {
  return offsets.map((v) => halfToEven(v * 100_000) / 100_000);
}

/** Points in breadth-first order. Throws Corrupt. */
export function breadthFirst(parents: number[]): number[] {
  const children = parents.map(() => [] as number[]);
  const order: number[] = [];
  parents.forEach((parent, p) => {
    check(parent >= -1 && parent < parents.length, "tempo: a parent that does not exist");
    if (parent < 0) order.push(p);
    else children[parent]!.push(p);
  });
  check(order.length === 1, "tempo: a tree must have one root");
  for (let i = 0; i < order.length; i++) order.push(...children[order[i]!]!);
  check(order.length === parents.length, "tempo: a tree with a cycle");
  return order;
}

/** Parents, renumbered to the order of the tree. */
export function parentsInOrder(order: number[], parents: number[]): number[] {
  const place = new Int32Array(order.length);
  order.forEach((p, i) => (place[p] = i));
  return order.map((p) => (parents[p]! >= 0 ? place[parents[p]!]! : -1));
}

/** The tree of a prior of directions. */
export function priorTree(prior: Prior): Tree {
  const { arrays } = prior;
  const truths = (name: string) => Array.from(arrays.numbers(name).data, (v) => v !== 0);
  return new Tree(Array.from(arrays.numbers("parents").data), arrays.numbers("vectors").data, truths("hub"), truths("relative"));
}

/** The axis of each dimension at rest, and the bones that it rotates, in ordered arithmetic. */
export function rotationsOf(tree: Tree): { axis: Vector; bones: number[] }[] {
  const rotated = tree.joints.map(() => [] as number[]);
  for (const j of tree.moves) {
    for (let at = tree.jointOf[j]!; at !== BODY; at = tree.joints[at]!.reference) rotated[at]!.push(j);
  }
  const out: { axis: Vector; bones: number[] }[] = [];
  tree.joints.forEach(({ isHub, dimension, first, second }, i) => {
    const axes: Vector[] = isHub
      ? [
          [1, 0, 0],
          [0, 1, 0],
          [0, 0, 1],
        ]
      : [second, [-first[0], -first[1], -first[2]]];
    axes.forEach((axis, k) => (out[dimension + k] = { axis, bones: rotated[i]! }));
  });
  return out;
}

/** factor · A + 10⁻⁶ · (largest entry of factor · A) · identity, in ordered arithmetic. */
export function metricOf(tree: Tree, factor = 1): Matrix {
  const { points } = tree;
  const move = matrix(tree.dimensions, 3 * points);
  const buffer = new Float64Array(points);
  rotationsOf(tree).forEach(({ axis, bones }, i) => {
    const row = rowOf(move, i);
    for (const j of bones) row.set(cross(axis, tree.vectors.subarray(3 * j, 3 * j + 3)), 3 * j);
    tree.parents.forEach((parent, j) => {
      if (parent >= 0) for (let c = 0; c < 3; c++) row[3 * j + c]! += row[3 * parent + c]!;
    });
    for (let c = 0; c < 3; c++) {
      for (let j = 0; j < points; j++) buffer[j] = row[3 * j + c]!;
      const mean = sum(buffer) / points;
      for (let j = 0; j < points; j++) row[3 * j + c]! -= mean;
    }
  });
  const a = product(move, transposed(move));
  if (factor !== 1) for (let i = 0; i < a.data.length; i++) a.data[i]! *= factor;
  const added = 1e-6 * a.data.reduce((most, v) => Math.max(most, v), -Infinity);
  for (let i = 0; i < a.rows; i++) a.data[i * a.rows + i]! += added;
  return a;
}
