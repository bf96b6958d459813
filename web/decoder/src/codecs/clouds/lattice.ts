/** Points of a chunk within a bound, on a lattice (docs/payloads/bodycast-points.md). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import type { Placement } from "../bodies.js";
import { type Cloud, checkCounts, rgbOf } from "./cloud.js";
import { readPointsByCube } from "./cube_octree.js";
import { Colours, readTexturedColours } from "./colours.js";
import { MixedBits } from "./mixed.js";
import { readPoints } from "./point_octree.js";
import { EarlierFrames, NO_REFERENCE, type Reference, joinedSamples, readReferences } from "./references.js";
import { Scene } from "./scene.js";
import { FINE, readShifts } from "./smoothing.js";
import type { Surface } from "./surface.js";
import { SurfaceHints, samplesOfBodies } from "./surface_hints.js";

/** Kinds of a part: without learning from earlier frames, with it, with smoothing too, with references before one of these kinds,
 * and octrees cube by cube with smoothing. */
const UNLEARNED = 3;
const LEARNED = 4;
const SMOOTHED = 5;
const REFERRED = 6;
const CUBED = 8;
export const KINDS = [UNLEARNED, LEARNED, SMOOTHED, REFERRED, CUBED];

const MOST_DEPTH = 20;
const MOST_STEP = 128;
const MOST_CORNER = 2 ** 40 - 1;
const LEAST_STEP_M = 1e-7;
const MOST_STEP_M = 10;
const MOST_SHIFT = 63;

/** The bodies of a chunk. */
export interface Bodies {
  count: number;
  /** Numbers of the bodies in a frame. */
  present(frame: number): number[];
  /** Poses of a body's links in a frame. */
  placements(body: number, frame: number): Placement[];
  /** The surface of a body, rounded with this shift. */
  surface(body: number, shift: number): Surface;
}

/** The points of the frames of a chunk, one frame after the other. Throws Corrupt. */
export function* readLattice(data: Uint8Array, frames: number, coloured: boolean, bodies: Bodies): Generator<Cloud> {
  const layer = new Lattice(data, frames, coloured, bodies);
  const colourBits = new MixedBits(layer.rest);
  const { kind, steps, step, corner } = layer;
  const colours = coloured && kind !== UNLEARNED ? new Colours(colourBits, steps) : undefined;
  for (const frame of layer.frames(colours)) {
    const cloud: Cloud = { positions: Float64Array.from(frame.cells, (cell, i) => ((cell + corner[i % 3]!) * FINE + (frame.shifts?.[i] ?? 0)) * (step / FINE)) };
    if (frame.colours) cloud.colours = rgbOf(frame.colours);
    else if (coloured) cloud.colours = rgbOf(readTexturedColours(colourBits, frame.rows, layer.scene.colours, steps[0]));
    yield cloud;
  }
  colourBits.end();
}

/** The points of a frame: coordinates (points, 3), samples of bodies, colours (Y, Co, Cg), and shifts in 1/FINE units. */
export interface LatticeFrame {
  cells: Int32Array;
  rows: Int32Array;
  colours?: Int32Array;
  shifts?: Float64Array;
}

const NOTHING: LatticeFrame = { cells: new Int32Array(0), rows: new Int32Array(0) };

/** Reads the header and the places of a chunk's lattice points. */
export class Lattice {
  readonly kind: number;
  private readonly smooths: boolean;
  readonly steps: [number, number, number];
  readonly corner: number[];
  readonly step: number;
  /** The bytes after the octrees. */
  readonly rest: Uint8Array;
  readonly scene: Scene;
  private readonly references: Reference[];
  private readonly depth: number;
  private readonly counts: number[];
  private readonly poseShifts: number[][];
  private readonly octrees: MixedBits;

  constructor(
    data: Uint8Array,
    frames: number,
    coloured: boolean,
    private readonly bodies: Bodies,
  ) {
    const part = new Bytes(data, "bodycast: points");
    const refers = data[0] === REFERRED;
    if (refers) part.varint();
    this.references = refers ? readReferences(part, frames) : Array.from({ length: frames }, () => NO_REFERENCE);
    this.kind = part.varint();
    check([...(refers ? [] : [UNLEARNED]), LEARNED, SMOOTHED, CUBED].includes(this.kind), "bodycast: points of an unknown kind");
    this.smooths = this.kind === SMOOTHED || this.kind === CUBED;
    this.depth = part.varintWithin(0, MOST_DEPTH, "the depth");
    const luma = part.varintWithin(0, MOST_STEP, "a colour step");
    const chroma = this.kind !== UNLEARNED ? part.varintWithin(0, MOST_STEP, "a colour step") : luma;
    check(luma > 0 === coloured && chroma > 0 === coloured, "bodycast: steps without colours, or colours without steps");
    this.steps = [luma, chroma, chroma];
    this.corner = [0, 1, 2].map(() => part.foldedWithin(-MOST_CORNER, MOST_CORNER, "the corner"));
    this.step = part.float64();
    check(this.step >= LEAST_STEP_M && this.step <= MOST_STEP_M, "bodycast: the lattice is out of range");
    this.counts = Array.from({ length: frames }, () => part.varint());
    checkCounts(this.counts, data.length);
    const shift = () => part.varintWithin(0, MOST_SHIFT, "a rounding shift");
    const surfaceShifts = Array.from({ length: bodies.count }, shift);
    this.poseShifts = Array.from({ length: frames }, (_, k) => bodies.present(k).map(shift));
    this.octrees = new MixedBits(part.take(part.varint()));
    this.rest = part.rest();
    this.scene = new Scene(surfaceShifts.map((own, b) => bodies.surface(b, own)), this.kind !== UNLEARNED);
  }

  /** Yields frame after frame. repeats(count): number of extra copies of each point. Throws Corrupt. */
  *frames(colours: Colours | undefined, repeats?: (count: number) => Int32Array): Generator<LatticeFrame> {
    const earlier = new EarlierFrames();
    for (const [k, count] of this.counts.entries()) yield count ? this.frame(k, count, earlier, colours, repeats) : NOTHING;
    this.octrees.end();
  }

  private frame(k: number, count: number, earlier: EarlierFrames, colours: Colours | undefined, repeats?: (count: number) => Int32Array): LatticeFrame {
    const { bodies, scene, step, corner } = this;
    const present = bodies.present(k);
    const standing = scene.stand(present, present.map((b) => bodies.placements(b, k)), this.poseShifts[k]!);
    const reference = this.references[k]!;
    const own = reference.hides ? undefined : samplesOfBodies(standing, step, corner);
    const before = earlier.refer(reference, this.depth, own !== undefined);
    const all = joinedSamples(own, before);
    const hints = all && new SurfaceHints(all, !this.smooths);
    const read = this.kind === CUBED ? readPointsByCube : readPoints;
    const { cells, samples } = read(this.octrees, this.depth, count, hints);
    const shifts = this.smooths && hints ? readShifts(this.octrees, cells, samples, hints) : undefined;
    const shown = own ? standing.count : 0;
    const lattice = Float64Array.from(cells, (cell, i) => cell + corner[i % 3]!);
    const located = scene.learn(standing, lattice, samples.map((s) => (s < shown ? s : -1)), step);
    const more = repeats?.(count);
    const every = more ? repeated(more) : Int32Array.from({ length: count }, (_, i) => i);
    const pick = <A extends Int32Array | Float64Array>(values: A, out: A): A => {
      every.forEach((i, n) => out.set(values.subarray(3 * i, 3 * i + 3), 3 * n));
      return out;
    };
    const frame: LatticeFrame = { cells: pick(cells, new Int32Array(3 * every.length)), rows: every.map((i) => located.rows[i]!) };
    if (shifts) frame.shifts = shifts;
    if (colours) {
      const places = { rows: frame.rows, places: pick(located.places, new Float64Array(3 * every.length)), explained: located.explained };
      const near = every.map((i) => samples[i]!);
      const expected = scene.expected(places);
      near.forEach((s, i) => s >= shown && before!.expect(s - shown, frame.cells.subarray(3 * i, 3 * i + 3), expected, 3 * i));
      frame.colours = colours.frame(frame.cells, near, expected);
      scene.see(places, frame.colours);
    }
    earlier.keep(cells, located.explained, frame.colours && firsts(frame.colours, every, count));
    return frame;
  }
}

/** Index of each point, repeated 1 + more times. */
function repeated(more: Int32Array): Int32Array {
  const every: number[] = [];
  more.forEach((extra, i) => {
    for (let k = 0; k <= extra; k++) every.push(i);
  });
  return Int32Array.from(every);
}

/** The colours (count, 3) of the first copy of each point. */
function firsts(colours: Int32Array, every: Int32Array, count: number): Int32Array {
  const out = new Int32Array(3 * count);
  for (let n = every.length - 1; n >= 0; n--) out.set(colours.subarray(3 * n, 3 * n + 3), 3 * every[n]!);
  return out;
}
