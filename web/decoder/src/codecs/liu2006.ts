/** The codec `liu2006`: segments, PCA, key frames and splines (docs/payloads/liu2006.md). A chunk is a segment. */

import { Bits, Bytes } from "../bytes.js";
import { addCorrections } from "../corrections.js";
import { check } from "../errors.js";
import { readIntegers } from "../integers/read.js";
import { loadKernels } from "../kernels.js";
import { Gaps, readBasis, stepOf } from "../stages.js";
import type { ChunkDecoder, Decoded, Facts, StoredChunk } from "./codec.js";
import { Track, readKeyFrames } from "./key_frames.js";

const MOST_RUNG = 3840;
const MOST_REACH = 2 ** 17;
const SHORTEST_M = 1e-6;
/** Number of sections besides those of the groups. */
const SECTIONS = 6;

/** Rotation of three markers: rows of the matrix of the page, each with its factor. */
const TRIPLE = [
  [1, 1, 1].map((v) => v / Math.sqrt(3)),
  [0, -1, 1].map((v) => v / Math.sqrt(2)),
  [-2, 1, 1].map((v) => v / Math.sqrt(6)),
] as const;

interface GroupModel {
  /** Mean pose (3 · points of the group). */
  mean: Float64Array;
  /** (3 · points of the group, components). */
  basis: Float64Array;
  components: number;
  track: Track;
}

interface Segment {
  frames: number;
  before: number;
  after: number;
  markers: Track;
  groups: GroupModel[];
  gaps: Uint8Array;
  corrections: Uint8Array;
}

/** A segment, and its first frame within a window. */
interface Placed {
  segment: Segment;
  start: number;
}

/** Opens the decoder, from the shared bytes. */
export async function openLiu2006(facts: Facts): Promise<ChunkDecoder> {
  await loadKernels();
  return new Liu2006(facts);
}

class Liu2006 implements ChunkDecoder {
  private readonly blend: number;
  private readonly markers: number[];
  private readonly groups: number[][];
  private readonly maxError: number | undefined;
  private readonly segments = new WeakMap<Uint8Array, Segment>();

  constructor(private readonly facts: Facts) {
    const { points, shared } = facts;
    const part = new Bytes(shared[0]!, "liu2006");
    this.blend = part.varint();
    this.markers = readPoints(part, points);
    const feet = readPoints(part, points);
    check(new Set([...this.markers, ...feet]).size === this.markers.length + feet.length, "liu2006: a point that occurs twice");
    check(this.markers.length === 3 || this.markers.length === points, "liu2006: a wrong number of normalisation markers");
    const named = new Set([...this.markers, ...feet]);
    const others = Array.from({ length: points }, (_, p) => p).filter((p) => !named.has(p));
    this.groups = [feet, others].filter((group) => group.length > 0);
    this.maxError = part.left ? part.float64() : undefined;
    check(this.maxError === undefined || (this.maxError >= 0 && Number.isFinite(this.maxError)), "liu2006: a bound that is out of range");
    part.end();
  }

  decode(window: StoredChunk[], which: number): Decoded {
    let start = 0;
    const placed = window.map((chunk): Placed => {
      const segment = this.segment(chunk);
      start += segment.frames;
      return { segment, start: start - segment.frames };
    });
    const { segment } = placed[which]!;
    const { frames } = segment;
    const { points } = this.facts;
    const positions = new Float64Array(3 * frames * points);
    const markers = this.placeMarkers(segment, positions);
    this.groups.forEach((group, g) => {
      const pose = new Float64Array(3 * group.length);
      const other = new Float64Array(3 * group.length);
      for (let t = 0; t < frames; t++) {
        this.blended(placed, which, g, t, pose, other);
        const frame = bodyFrame(markers, t, this.markers.length, this.facts.up);
        group.forEach((point, i) => outOfBody(pose, 3 * i, frame, positions, 3 * (t * points + point)));
      }
    });
    const gaps = Gaps.read(segment.gaps, frames, points);
    if (this.maxError !== undefined) addCorrections(segment.corrections, positions, frames, points, this.maxError, gaps);
    gaps.restore(positions);
    return { positions };
  }

  /** A key frame of any marker group counts. */
  marks(chunk: StoredChunk): Record<string, number[]> {
    const { frames, before, markers, groups } = this.segment(chunk);
    const keys = [...markers.keys, ...groups.flatMap(({ track }) => track.keys.map((key) => key - before))];
    const inside = [...new Set(keys)].filter((key) => key >= 0 && key < frames);
    return { segment: [0], "key frame": inside.sort((a, b) => a - b) };
  }

  /** The segment of a chunk, read once and cached by its payload. */
  private segment({ frames, payload }: StoredChunk): Segment {
    let segment = this.segments.get(payload);
    if (!segment) this.segments.set(payload, (segment = this.readSegment(payload, frames)));
    return segment;
  }

  private readSegment(payload: Uint8Array, frames: number): Segment {
    const part = new Bytes(payload, "liu2006");
    const sizes = Array.from({ length: SECTIONS - 1 + 2 * this.groups.length }, () => part.varint());
    const sections = sizes.map((size) => part.take(size));
    sections.push(part.rest());
    const head = new Bytes(sections[0]!, "liu2006");
    const before = head.varint();
    const after = head.varint();
    check(before + after <= MOST_REACH, "liu2006: a reach that is out of range");
    const step = stepOf(head.foldedWithin(-MOST_RUNG, MOST_RUNG, "the step of the markers"));
    const splits = new Bits(sections[1]!, "liu2006");
    const markers = readTrack(splits, frames, sections[2]!, 3 * this.markers.length, step).track;
    const total = this.groups.reduce((sum, group) => sum + group.length, 0);
    const means = readIntegers(sections[3]!, total, 3);
    let at = 0;
    const groups = this.groups.map((group, g) => {
      const mean = means.slice(at, at + 3 * group.length);
      at += mean.length;
      return readGroup(head, splits, mean, before + frames + after, sections[4 + 2 * g]!, sections[5 + 2 * g]!);
    });
    head.end();
    splits.end();
    return { frames, before, after, markers, groups, gaps: sections.at(-2)!, corrections: sections.at(-1)! };
  }

  /** Positions (frames, markers, 3) of the normalisation markers, also written to `positions`. */
  private placeMarkers({ frames, markers: track }: Segment, positions: Float64Array): Float64Array {
    const { markers } = this;
    const lanes = 3 * markers.length;
    const out = new Float64Array(frames * lanes);
    const turned = new Float64Array(lanes);
    for (let t = 0; t < frames; t++) {
      track.at(t, turned, 0);
      for (let j = 0; j < markers.length; j++) {
        for (let c = 0; c < 3; c++) {
          const value = lanes === 9 ? TRIPLE[0][j]! * turned[c]! + TRIPLE[1][j]! * turned[3 + c]! + TRIPLE[2][j]! * turned[6 + c]! : turned[3 * j + c]!;
          out[t * lanes + 3 * j + c] = value;
          positions[3 * (t * this.facts.points + markers[j]!) + c] = value;
        }
      }
    }
    return out;
  }

  /** The pose of a group at frame t of a segment, blended with the models of its neighbours. */
  private blended(placed: Placed[], which: number, group: number, t: number, pose: Float64Array, other: Float64Array): void {
    const { segment, start } = placed[which]!;
    poseOf(segment, group, t, pose);
    const own = pose.slice();
    const frame = start + t;
    const last = placed.at(-1)!;
    const low = Math.max(frame - Math.floor(this.blend / 2), placed[0]!.start);
    const high = Math.min(frame + Math.floor(this.blend / 2) + 1, last.start + last.segment.frames);
    for (const neighbour of [placed[which - 1], placed[which + 1]]) {
      if (!neighbour) continue;
      const { segment: of, start: from } = neighbour;
      if (frame < from - of.before || frame >= from + of.frames + of.after) continue;
      const inside = Math.max(0, Math.min(high, from + of.frames) - Math.max(low, from));
      if (inside === 0) continue;
      poseOf(of, group, frame - from, other);
      for (let i = 0; i < pose.length; i++) pose[i]! += (inside / (high - low)) * (other[i]! - own[i]!);
    }
  }
}

function readPoints(part: Bytes, points: number): number[] {
  const count = part.varintWithin(0, points, "the number of markers");
  return Array.from({ length: count }, () => part.varintWithin(0, points - 1, "a marker"));
}

function readTrack(splits: Bits, frames: number, data: Uint8Array, lanes: number, step: number): { track: Track; keys: number } {
  const levels = readKeyFrames(splits, frames);
  const keys = levels.reduce((sum, level) => sum + level.length, 0);
  return { track: Track.read(levels, readIntegers(data, keys, lanes), lanes, step), keys };
}

function readGroup(head: Bytes, splits: Bits, mean: Float64Array, frames: number, basisBytes: Uint8Array, values: Uint8Array): GroupModel {
  const step = stepOf(head.foldedWithin(-MOST_RUNG, MOST_RUNG, "the step of a group"));
  const components = head.varintWithin(0, mean.length, "the components of a group");
  let precision = 0;
  for (let i = 0; i < components; i++) {
    precision = i ? precision - head.varint() : head.varint();
    check(precision >= 0 && precision <= 96, "liu2006: a precision that is out of range");
  }
  const { track, keys } = readTrack(splits, frames, values, components, step);
  const basis = readBasis(basisBytes, mean.length, components, nearestBefore(mean));
  const factor = step / Math.sqrt(keys);
  return { mean: mean.map((v) => v * factor), basis, components, track };
}

/** For each dimension, the same coordinate of the earlier point with the nearest mean, or −1. */
function nearestBefore(mean: Float64Array): Int32Array {
  const alike = new Int32Array(mean.length).fill(-1);
  for (let p = 3; p < mean.length; p += 3) {
    let least = Infinity;
    let nearest = 0;
    for (let q = 0; q < p; q += 3) {
      const square = [0, 1, 2].reduce((sum, c) => sum + (mean[q + c]! - mean[p + c]!) ** 2, 0);
      if (square < least) {
        least = square;
        nearest = q;
      }
    }
    for (let c = 0; c < 3; c++) alike[p + c] = nearest + c;
  }
  return alike;
}

/** The pose of a group's model at frame t of its segment; t may lie in the reach before or after it. */
function poseOf({ groups, before }: Segment, group: number, t: number, out: Float64Array): void {
  const { mean, basis, components, track } = groups[group]!;
  const values = new Float64Array(components);
  track.at(t + before, values, 0);
  for (let d = 0; d < mean.length; d++) {
    let sum = mean[d]!;
    for (let c = 0; c < components; c++) sum += values[c]! * basis[d * components + c]!;
    out[d] = sum;
  }
}

interface BodyFrame {
  axes: readonly [number, number, number];
  cosine: number;
  sine: number;
  origin: Float64Array;
}

function bodyFrame(markers: Float64Array, t: number, count: number, up: number): BodyFrame {
  const at = 3 * count * t;
  const axes = [(up + 1) % 3, (up + 2) % 3, up] as const;
  const [a, b] = axes.map((axis) => markers[at + 6 + axis]! - markers[at + 3 + axis]!) as [number, number, number];
  const length = Math.sqrt(a * a + b * b);
  const isLong = length > SHORTEST_M;
  return { axes, cosine: isLong ? a / length : 1, sine: isLong ? b / length : 0, origin: markers.subarray(at, at + 3) };
}

function outOfBody(pose: Float64Array, at: number, { axes, cosine, sine, origin }: BodyFrame, out: Float64Array, place: number): void {
  const [a, b, v] = axes;
  out[place + a] = cosine * pose[at + a]! - sine * pose[at + b]! + origin[a]!;
  out[place + b] = sine * pose[at + a]! + cosine * pose[at + b]! + origin[b]!;
  out[place + v] = pose[at + v]! + origin[v]!;
}
