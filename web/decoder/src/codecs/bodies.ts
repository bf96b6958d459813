/** Poses of the bodies in point clouds (docs/payloads/lien2006.md, bodycast.md). */

import { Bytes, text } from "../bytes.js";
import { inverseDct } from "../dct.js";
import { check } from "../errors.js";
import { type Quaternion, type Vector, aboutAxis, cross, fromMatrix, lengthOf, minus, multiplied, normalised, plus, rotated, times } from "../geometry.js";
import { inflateZlib } from "../inflate.js";
import { readIntegers } from "../integers/read.js";
import type { StoredChunk } from "./codec.js";

const MOST_LINKS = 255;
const MOST_NAME_BYTES = 2 ** 16;
const MOST_MM = 10 ** 7;
const MOST_STEPS = 10 ** 8;
const MOST_COEFFICIENT = 2 ** 24;
const MOST_MIDDLE = 200;
const LEAST_RADIUS_M = 0.001;
const SHRINK = 0.05;
const ROOT_STEP_M = 0.002;
const SHORTEST_LEVER_M = 0.05;

/** The links of a body in its canonical pose. */
export interface Body {
  names: string[];
  /** Index of each link's parent, −1 for the root. */
  parents: number[];
  /** Ends of each link, metres: its joint with the parent, and the other end. */
  origins: Vector[];
  tips: Vector[];
  /** Radius of the cylinder around each link, metres. */
  radii: number[];
}

/** Decodes poses of a file's bodies. */
export interface PoseDecoder {
  bodies: Body[];
  /** For each body (frames, links, 2, 3): origin and tip of each link in metres, NaN where the body is absent. */
  decode(chunk: StoredChunk): Float64Array[];
}

/** The decoder of the poses of `lien2006` or `bodycast`. */
export function poseDecoder(codec: "lien2006" | "bodycast", shared: Uint8Array[]): PoseDecoder {
  if (codec === "bodycast") return new Bodycast(shared);
  check(shared.length === 1, "lien2006: a wrong number of shared blobs");
  return new Lien2006(shared[0]!);
}

function clip(value: number, most: number): number {
  return Math.min(Math.max(value, -most), most);
}

export function readBody(part: Bytes): Body {
  const links = part.varintWithin(1, MOST_LINKS, "the number of links");
  const nameBytes = part.varint();
  const tableBytes = part.varint();
  const names = text(inflateZlib(part.take(nameBytes), MOST_NAME_BYTES)).split("\n");
  check(names.length === links, `${part.what}: a wrong number of names`);
  const table = readIntegers(part.take(tableBytes), links, 8);
  const body: Body = { names, parents: [], origins: [], tips: [], radii: [] };
  for (let l = 0; l < links; l++) {
    const parent = table[8 * l]! - 1;
    check(l === 0 ? parent === -1 : parent >= 0 && parent < l, `${part.what}: a parent that does not come first`);
    const at = (column: number) => clip(table[8 * l + column]!, MOST_MM) / 1000;
    const origin: Vector = [at(1), at(2), at(3)];
    body.parents.push(parent);
    body.origins.push(origin);
    body.tips.push(plus(origin, [at(4), at(5), at(6)]));
    body.radii.push(Math.max(at(7), LEAST_RADIUS_M));
  }
  return body;
}

/** A rigid motion x ↦ A x + b: rotation A (`turn`) and translation b in metres (`shift`). */
export interface Placement {
  turn: Quaternion;
  shift: Vector;
}

/** Forward kinematics. local: rotation of each link in the frame of its parent; root: translation of the root. */
function placements(body: Body, local: Quaternion[], root: Vector): Placement[] {
  const placed: Placement[] = [];
  body.parents.forEach((parent, l) => {
    const o = body.origins[l]!;
    const rest = minus(o, rotated(local[l]!, o));
    if (parent < 0) placed.push({ turn: local[l]!, shift: plus(rest, root) });
    else {
      const above = placed[parent]!;
      placed.push({ turn: multiplied(above.turn, local[l]!), shift: plus(rotated(above.turn, rest), above.shift) });
    }
  });
  return placed;
}

/** Writes origins and tips of the links in a frame. */
function write(body: Body, placed: Placement[], out: Float64Array, at: number): void {
  placed.forEach(({ turn, shift }, l) => {
    out.set(plus(rotated(turn, body.origins[l]!), shift), at + 6 * l);
    out.set(plus(rotated(turn, body.tips[l]!), shift), at + 6 * l + 3);
  });
}

/** The quaternion of a rotation vector. */
function ofVector(v: Vector): Quaternion {
  const angle = lengthOf(v);
  return angle < 1e-9 ? [1, v[0] / 2, v[1] / 2, v[2] / 2] : aboutAxis(times(1 / angle, v), angle);
}

class Lien2006 implements PoseDecoder {
  readonly bodies: Body[];

  constructor(shared: Uint8Array) {
    this.bodies = [readBody(new Bytes(shared, "lien2006"))];
  }

  decode(chunk: StoredChunk): Float64Array[] {
    const body = this.bodies[0]!;
    const lanes = 6 * body.parents.length;
    const out = new Float64Array(chunk.frames * lanes).fill(NaN);
    readLienChunk(chunk, body).placed.forEach((placed, t) => placed && write(body, placed, out, t * lanes));
    return [out];
  }
}

/** The parts of a chunk of lien2006. */
export interface LienChunk {
  /** Poses of the links in each frame; null for a raw frame. */
  placed: (Placement[] | null)[];
  rawFrames: Uint8Array;
  images: Uint8Array[];
}

/** Splits a chunk of lien2006. Throws Corrupt. */
export function readLienChunk({ frames, payload }: StoredChunk, body: Body): LienChunk {
  const part = new Bytes(payload, "lien2006");
  const [poseBytes, rawBytes, count] = [part.varint(), part.varint(), part.varintWithin(0, 2 * frames, "the number of images")];
  const sizes = Array.from({ length: count }, () => part.varint());
  const columns = 4 + 3 * body.parents.length;
  const rows = readIntegers(part.take(poseBytes), frames, columns);
  const rawFrames = part.take(rawBytes);
  const images = sizes.map((size) => part.take(size));
  const steps = jointSteps(body);
  const placed = Array.from({ length: frames }, (_, t) => {
    const row = rows.subarray(t * columns, (t + 1) * columns);
    if (row[0] !== 0) return null;
    const at = (column: number) => clip(row[column]!, MOST_STEPS);
    const local = steps.map((step, l) => ofVector(times(step, [at(4 + 3 * l), at(5 + 3 * l), at(6 + 3 * l)])));
    return placements(body, local, times(ROOT_STEP_M, [at(1), at(2), at(3)]));
  });
  return { placed, rawFrames, images };
}

/** Quantisation step of each joint, radians. */
function jointSteps({ parents, origins, tips }: Body): number[] {
  return origins.map((o, l) => {
    let farthest = 0;
    for (let below = l; below < parents.length; below++) {
      if (!isBelow(parents, below, l)) continue;
      farthest = Math.max(farthest, lengthOf(minus(origins[below]!, o)), lengthOf(minus(tips[below]!, o)));
    }
    return ROOT_STEP_M / Math.max(SHORTEST_LEVER_M, farthest);
  });
}

function isBelow(parents: number[], link: number, above: number): boolean {
  let at = link;
  while (at > above) at = parents[at]!;
  return at === above;
}

/** A body of bodycast, and the quantisation of its poses. */
export interface PosedBody {
  body: Body;
  /** Quantisation step, metres: of the root's position, and of a joint's motion at its lever. */
  step: number;
  /** Lever of each rotation (links, 3), metres. */
  levers: Float64Array;
  /** Rotation into the frame of each link, with rows side, across, axis. */
  frames: Quaternion[];
}

/** Reads the first part of a shared blob of bodycast. */
export function readPosedBody(part: Bytes): PosedBody {
  const body = readBody(part);
  const step = part.varintWithin(1, 2 ** 17, "the pose step") / 100_000;
  const levers = readIntegers(part.take(part.varint()), body.parents.length, 3);
  check(levers.every((v) => v >= 0 && v <= 80), "bodycast: a lever that is out of range");
  return { body, step, levers: levers.map((v) => 0.015 * 2 ** (v / 4)), frames: body.origins.map((o, l) => linkFrame(o, body.tips[l]!)) };
}

/** The parts of a chunk of bodycast. */
export interface ChunkParts {
  /** (frames, bodies): not 0 where a frame does not have a body. */
  absent: Float64Array;
  rawFrames: Uint8Array;
  outliers: Uint8Array;
  exactPoints: Uint8Array;
  /** Coded poses of each body. `pictures`: packets of its video. */
  poses: Uint8Array[];
  pictures: Uint8Array[][];
}

/** Splits a chunk of bodycast. Throws Corrupt. */
export function splitChunk({ frames, payload }: StoredChunk, bodies: number): ChunkParts {
  const part = new Bytes(payload, "bodycast");
  const [absentBytes, rawBytes, outlierBytes, exactBytes] = [part.varint(), part.varint(), part.varint(), part.varint()];
  const sizes = Array.from({ length: bodies }, () => {
    const pose = part.varint();
    const count = part.varintWithin(0, frames + 1, "the number of pictures");
    return { pose, pictures: Array.from({ length: count }, () => part.varint()) };
  });
  const absent = readIntegers(part.take(absentBytes), frames, bodies);
  const [rawFrames, outliers, exactPoints] = [part.take(rawBytes), part.take(outlierBytes), part.take(exactBytes)];
  const own = sizes.map(({ pose, pictures }) => ({ poses: part.take(pose), pictures: pictures.map((size) => part.take(size)) }));
  part.end();
  return { absent, rawFrames, outliers, exactPoints, poses: own.map(({ poses }) => poses), pictures: own.map(({ pictures }) => pictures) };
}

class Bodycast implements PoseDecoder {
  readonly bodies: Body[];
  private readonly posed: PosedBody[];

  constructor(shared: Uint8Array[]) {
    this.posed = shared.map((blob) => readPosedBody(new Bytes(blob, "bodycast")));
    this.bodies = this.posed.map(({ body }) => body);
  }

  decode(chunk: StoredChunk): Float64Array[] {
    const { absent, poses } = splitChunk(chunk, this.posed.length);
    return this.posed.map((own, i) => {
      const lanes = 6 * own.body.parents.length;
      const out = new Float64Array(chunk.frames * lanes);
      readPlacements(poses[i]!, chunk.frames, own).forEach((placed, t) => write(own.body, placed, out, t * lanes));
      for (let t = 0; t < chunk.frames; t++) if (absent[t * this.posed.length + i]) out.fill(NaN, t * lanes, (t + 1) * lanes);
      return out;
    });
  }
}

/** The rotation into the frame of a link, with rows side, across, axis. */
function linkFrame(origin: Vector, tip: Vector): Quaternion {
  const along = minus(tip, origin);
  const axis = times(1 / Math.max(lengthOf(along), 1e-9), along);
  const side = normalised(cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  return fromMatrix([...side, ...cross(axis, side), ...axis]);
}

/** Poses of a body's links in each frame of a chunk. */
export function readPlacements(data: Uint8Array, frames: number, { body, step, levers, frames: linkFrames }: PosedBody): Placement[][] {
  const links = body.parents.length;
  const part = new Bytes(data, "bodycast");
  const middle = readIntegers(part.take(part.varint()), links, 3);
  const lanes = 3 + 3 * links;
  const spectrum = readIntegers(part.rest(), frames, lanes).map((v) => clip(v, MOST_COEFFICIENT)).map((v) => v - SHRINK * Math.sign(v));
  const curves = inverseDct(spectrum, frames, frames, lanes);
  const middles = body.parents.map((_, l) => ofVector([0, 1, 2].map((c) => 0.05 * clip(middle[3 * l + c]!, MOST_MIDDLE)) as Vector));
  return Array.from({ length: frames }, (_, t) => {
    const row = curves.subarray(t * lanes, (t + 1) * lanes);
    const root = times(step, [row[0]!, row[1]!, row[2]!]);
    const local = middles.map((m, l): Quaternion => {
      const angle = (c: number) => (row[3 + c * links + l]! * step) / levers[3 * l + c]!;
      const own = multiplied(ofVector([angle(0), angle(1), 0]), ofVector([0, 0, angle(2)]));
      const f = linkFrames[l]!;
      return multiplied(m, multiplied(multiplied([f[0], -f[1], -f[2], -f[3]], own), f));
    });
    return placements(body, local, root);
  });
}
