/** Points of a chunk within a bound, on a lattice (docs/payloads/bodycast-points.md). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import type { Placement } from "../bodies.js";
import { type Cloud, checkCounts, rgbOf } from "./cloud.js";
import { Colours, readTexturedColours } from "./colours.js";
import { MixedBits } from "./mixed.js";
import { readPoints } from "./point_octree.js";
import { Scene } from "./scene.js";
import { FINE, readShifts } from "./smoothing.js";
import type { Surface } from "./surface.js";
import { SurfaceHints } from "./surface_hints.js";

/** Kinds of a part: without and with learning from earlier frames, and with smoothing too. */
export const UNLEARNED = 3;
const SMOOTHED = 5;
export const NEWEST = SMOOTHED;

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
  const kind = part.varintWithin(UNLEARNED, SMOOTHED, "the kind");
  const depth = part.varintWithin(0, MOST_DEPTH, "the depth");
  const luma = part.varintWithin(0, MOST_STEP, "a colour step");
  const chroma = kind !== UNLEARNED ? part.varintWithin(0, MOST_STEP, "a colour step") : luma;
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
  const scene = new Scene(surfaceShifts.map((own, b) => bodies.surface(b, own)), kind !== UNLEARNED);
  const colours = new Colours(colourBits, [luma, chroma, chroma]);
  for (const [k, count] of counts.entries()) {
    if (!count) {
      yield coloured ? { positions: new Float64Array(0), colours: new Uint8Array(0) } : { positions: new Float64Array(0) };
      continue;
    }
    const present = bodies.present(k);
    const standing = scene.stand(present, present.map((b) => bodies.placements(b, k)), poseShifts[k]!);
    const hints = standing.count ? new SurfaceHints(standing, step, corner, kind !== SMOOTHED) : undefined;
    const { cells, samples } = readPoints(octrees, depth, count, hints);
    const lattice = Float64Array.from(cells, (cell, i) => cell + corner[i % 3]!);
    const located = scene.learn(standing, lattice, samples, step);
    const shifts = kind === SMOOTHED && hints ? readShifts(octrees, cells, samples, hints) : new Float64Array(cells.length);
    const cloud: Cloud = { positions: lattice.map((v, i) => (v * FINE + shifts[i]!) * (step / FINE)) };
    if (coloured && kind !== UNLEARNED) {
      const own = colours.frame(cells, located.rows, scene.expected(located));
      scene.see(located, own);
      cloud.colours = rgbOf(own);
    } else if (coloured) cloud.colours = rgbOf(readTexturedColours(colourBits, located.rows, scene.colours, luma));
    yield cloud;
  }
  octrees.end();
  if (coloured) colourBits.end();
}
