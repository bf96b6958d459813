/** From dimensions to positions: step 4 and 5 of "Decoding" (docs/payloads/tempo.md). */

import type { Tree } from "./trees.js";

/** Positions are dimensions plus a mean pose, or follow from the directions of bones. */
export type PoseMap =
  | { kind: "points"; /** (points, 3), metres. */ mean: Float64Array }
  | { kind: "tree"; tree: Tree; /** Point of each index in the tree. */ order: number[] };

/** Numbers of a frame before its dimensions: heading, place x, y, z. */
export const HEAD = 4;

/** Positions (frames, points, 3), y up, from curves (frames, 4 + dimensions). */
export function positionsOf(curves: Float64Array, frames: number, points: number, pose: PoseMap): Float64Array {
  const positions = new Float64Array(3 * frames * points);
  const lanes = curves.length / frames;
  const posed = new Float64Array(3 * points);
  const skeleton = pose.kind === "tree" ? new Kinematics(pose.tree, pose.order) : undefined;
  const scale = 1 / Math.sqrt(points);
  for (let t = 0; t < frames; t++) {
    const at = t * lanes;
    if (skeleton) skeleton.pose(curves, at + HEAD, posed);
    else if (pose.kind === "points") for (let i = 0; i < posed.length; i++) posed[i] = curves[at + HEAD + i]! + pose.mean[i]!;
    const cosine = Math.cos(curves[at]!);
    const sine = Math.sin(curves[at]!);
    const x = curves[at + 1]! * scale;
    const y = curves[at + 2]! * scale;
    const z = curves[at + 3]! * scale;
    for (let i = 0, out = 3 * points * t; i < posed.length; i += 3, out += 3) {
      positions[out] = posed[i]! * cosine + posed[i + 2]! * sine + x;
      positions[out + 1] = posed[i + 1]! + y;
      positions[out + 2] = posed[i + 2]! * cosine - posed[i]! * sine + z;
    }
  }
  return positions;
}

/** Forward kinematics: positions of a tree from its dimensions, with quaternions. */
class Kinematics {
  private readonly points: number;
  /** World rotation of each joint of the tree, a quaternion. */
  private readonly turns: Float64Array;
  /** Positions in the order of the tree. */
  private readonly placed: Float64Array;
  private readonly parents: Int32Array;
  private readonly jointOf: Int32Array;
  private readonly vectors: Float64Array;
  private readonly order: Int32Array;
  /** For each joint, its dimension, its reference, and whether it is a hub. */
  private readonly dimension: Int32Array;
  private readonly reference: Int32Array;
  private readonly isHub: Uint8Array;
  /** First and second axis of each joint. */
  private readonly axes: Float64Array;

  constructor(tree: Tree, order: number[]) {
    this.points = tree.points;
    this.turns = new Float64Array(4 * tree.joints.length);
    this.placed = new Float64Array(3 * tree.points);
    this.parents = Int32Array.from(tree.parents);
    this.jointOf = tree.jointOf;
    this.vectors = tree.vectors;
    this.order = Int32Array.from(order);
    this.dimension = Int32Array.from(tree.joints, (joint) => joint.dimension);
    this.reference = Int32Array.from(tree.joints, (joint) => joint.reference);
    this.isHub = Uint8Array.from(tree.joints, (joint) => (joint.isHub ? 1 : 0));
    this.axes = Float64Array.from(tree.joints.flatMap((joint) => [...joint.first, ...joint.second]));
  }

  /** Writes positions (points, 3), minus their mean, in the order of the file. y: dimensions from index `at` on. */
  pose(y: Float64Array, at: number, out: Float64Array): void {
    for (let joint = 0; joint < this.dimension.length; joint++) this.turn(joint, y, at + this.dimension[joint]!);
    const { placed, vectors, turns, points } = this;
    let sumX = 0;
    let sumY = 0;
    let sumZ = 0;
    for (let j = 0; j < points; j++) {
      const parent = this.parents[j]!;
      const joint = this.jointOf[j]!;
      let x = 0;
      let y0 = 0;
      let z = 0;
      if (parent >= 0) {
        x = placed[3 * parent]!;
        y0 = placed[3 * parent + 1]!;
        z = placed[3 * parent + 2]!;
      }
      if (joint >= 0) {
        const vx = vectors[3 * j]!;
        const vy = vectors[3 * j + 1]!;
        const vz = vectors[3 * j + 2]!;
        const qw = turns[4 * joint]!;
        const qx = turns[4 * joint + 1]!;
        const qy = turns[4 * joint + 2]!;
        const qz = turns[4 * joint + 3]!;
        const tx = 2 * (qy * vz - qz * vy);
        const ty = 2 * (qz * vx - qx * vz);
        const tz = 2 * (qx * vy - qy * vx);
        x += vx + qw * tx + qy * tz - qz * ty;
        y0 += vy + qw * ty + qz * tx - qx * tz;
        z += vz + qw * tz + qx * ty - qy * tx;
      }
      placed[3 * j] = x;
      placed[3 * j + 1] = y0;
      placed[3 * j + 2] = z;
      sumX += x;
      sumY += y0;
      sumZ += z;
    }
    for (let j = 0; j < points; j++) {
      const p = 3 * this.order[j]!;
      out[p] = placed[3 * j]! - sumX / points;
      out[p + 1] = placed[3 * j + 1]! - sumY / points;
      out[p + 2] = placed[3 * j + 2]! - sumZ / points;
    }
  }

  /** Sets the rotation of a joint: its reference's rotation times its own rotation vector's. */
  private turn(joint: number, y: Float64Array, at: number): void {
    let x: number;
    let y0: number;
    let z: number;
    if (this.isHub[joint]) {
      x = y[at]!;
      y0 = y[at + 1]!;
      z = y[at + 2]!;
    } else {
      const { axes } = this;
      const i = 6 * joint;
      const a = y[at]!;
      const b = y[at + 1]!;
      x = a * axes[i + 3]! - b * axes[i]!;
      y0 = a * axes[i + 4]! - b * axes[i + 1]!;
      z = a * axes[i + 5]! - b * axes[i + 2]!;
    }
    const angle = Math.sqrt(x * x + y0 * y0 + z * z);
    const factor = angle < 1e-8 ? 0.5 : Math.sin(0.5 * angle) / angle;
    const w = Math.cos(0.5 * angle);
    x *= factor;
    y0 *= factor;
    z *= factor;
    const { turns } = this;
    const out = 4 * joint;
    const reference = this.reference[joint]!;
    if (reference < 0) {
      turns[out] = w;
      turns[out + 1] = x;
      turns[out + 2] = y0;
      turns[out + 3] = z;
      return;
    }
    const rw = turns[4 * reference]!;
    const rx = turns[4 * reference + 1]!;
    const ry = turns[4 * reference + 2]!;
    const rz = turns[4 * reference + 3]!;
    turns[out] = rw * w - rx * x - ry * y0 - rz * z;
    turns[out + 1] = rw * x + rx * w + ry * z - rz * y0;
    turns[out + 2] = rw * y0 - rx * z + ry * w + rz * x;
    turns[out + 3] = rw * z + rx * y0 - ry * x + rz * w;
  }
}

/** Step 8: turns positions in place from y up to the vertical axis `up` (0 x, 1 y, 2 z). */
export function toAxes(positions: Float64Array, up: number): void {
  if (up === 1) return;
  for (let i = 0; i < positions.length; i += 3) {
    const x = positions[i]!;
    const y = positions[i + 1]!;
    const z = positions[i + 2]!;
    if (up === 2) {
      positions[i] = z;
      positions[i + 1] = x;
      positions[i + 2] = y;
    } else {
      positions[i] = y;
      positions[i + 1] = z;
      positions[i + 2] = x;
    }
  }
}
