/** Points of a chunk within a bound, on a lattice (docs/payloads/bodycast-points.md). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import type { Placement } from "../bodies.js";
import { type Cloud, checkCounts, rgbOf } from "./cloud.js";
import { Colours, readTexturedColours } from "./colours.js";
import { MixedBits } from "./mixed.js";
import { readPoints } from "./point_octree.js";
import { EarlierFrames, NO_REFERENCE, joinedSamples, readReferences } from "./references.js";
import { Scene } from "./scene.js";
import type { Surface } from "./surface.js";
import { SurfaceHints, samplesOfBodies } from "./surface_hints.js";

/** Kinds of a part: without and with learning from earlier frames; and references before a part with learning. */
export const UNLEARNED = 3;
export const LEARNED = 4;
export const REFERRED = 6;

const MOST_DEPTH = 20;
const MOST_STEP = 128;
const MOST_CORNER = 2 ** 40 - 1;
const LEAST_STEP_M = 1e-7;
const MOST_STEP_M = 10;
const MOST_SHIFT = 63;

/** What a chunk says about its bodies. */
export interface Bodies {
  count: number;
  /** Bodies in a frame. */
  present(frame: number): number[];
  /** Where the links of a body stand in a frame. */
  placements(body: number, frame: number): Placement[];
  /** The surface of a body, rounded with this shift. */
  surface(body: number, shift: number): Surface;
}

/** The points of the frames of a chunk, one frame after the other. Throws Corrupt. */
export function* readLattice(data: Uint8Array, frames: number, coloured: boolean, bodies: Bodies): Generator<Cloud> {
  const part = new Bytes(data, "bodycast: points");
  const refers = data[0] === REFERRED;
  if (refers) part.varint();
  const references = refers ? readReferences(part, frames) : Array.from({ length: frames }, () => NO_REFERENCE);
  const kind = part.varintWithin(refers ? LEARNED : UNLEARNED, LEARNED, "the kind");
  const depth = part.varintWithin(0, MOST_DEPTH, "the depth");
  const luma = part.varintWithin(0, MOST_STEP, "a colour step");
  const chroma = kind === LEARNED ? part.varintWithin(0, MOST_STEP, "a colour step") : luma;
  check(luma > 0 === coloured && chroma > 0 === coloured, "bodycast: steps without colours, or colours without steps");
  const corner = [0, 1, 2].map(() => part.foldedWithin(-MOST_CORNER, MOST_CORNER, "the corner"));
  const step = part.float64();
  check(step >= LEAST_STEP_M && step <= MOST_STEP_M, "bodycast: the lattice is out of range");
  const counts = Array.from({ length: frames }, () => part.varint());
  checkCounts(counts, data.length);
  const shift = () => part.varintWithin(0, MOST_SHIFT, "a rounding shift");
  const surfaceShifts = Array.from({ length: bodies.count }, shift);
  const poseShifts = Array.from({ length: frames }, (_, k) => bodies.present(k).map(shift));
  const octrees = new MixedBits(part.take(part.varint()));
  const colourBits = new MixedBits(part.rest());
  const scene = new Scene(surfaceShifts.map((own, b) => bodies.surface(b, own)), kind === LEARNED);
  const colours = new Colours(colourBits, [luma, chroma, chroma]);
  const earlier = new EarlierFrames();
  for (const [k, count] of counts.entries()) {
    if (!count) {
      yield coloured ? { positions: new Float64Array(0), colours: new Uint8Array(0) } : { positions: new Float64Array(0) };
      continue;
    }
    const present = bodies.present(k);
    const standing = scene.stand(present, present.map((b) => bodies.placements(b, k)), poseShifts[k]!);
    const own = references[k]!.hides ? undefined : samplesOfBodies(standing, step, corner);
    const before = earlier.refer(references[k]!, depth, own !== undefined);
    const all = joinedSamples(own, before);
    const { cells, samples } = readPoints(octrees, depth, count, all && new SurfaceHints(all));
    const shown = own ? standing.count : 0;
    const lattice = Float64Array.from(cells, (cell, i) => cell + corner[i % 3]!);
    const located = scene.learn(standing, lattice, samples.map((s) => (s < shown ? s : -1)), step);
    const cloud: Cloud = { positions: lattice.map((v) => v * step) };
    if (coloured && kind === LEARNED) {
      const expected = scene.expected(located);
      samples.forEach((s, i) => s >= shown && before!.expect(s - shown, cells.subarray(3 * i, 3 * i + 3), expected, 3 * i));
      const decoded = colours.frame(cells, samples, expected);
      scene.see(located, decoded);
      cloud.colours = rgbOf(decoded);
      earlier.keep(cells, located.explained, decoded);
    } else if (coloured) cloud.colours = rgbOf(readTexturedColours(colourBits, located.rows, scene.colours, luma));
    else earlier.keep(cells, located.explained, undefined);
    yield cloud;
  }
  octrees.end();
  if (coloured) colourBits.end();
}
