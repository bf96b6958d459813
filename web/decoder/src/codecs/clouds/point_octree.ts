/** Octrees of points on a lattice, predicted by the surface of the bodies (docs/payloads/bodycast-points.md, "Octree of a frame"). */

import { check } from "../../errors.js";
import { bitsIn, descend, neighbourCubes } from "./cubes.js";
import type { MixedBits } from "./mixed.js";
import { type Hints, NO_DISTANCE, NO_HINT, SurfaceHints } from "./surface_hints.js";

export const WEIGHT_SETS = 2048;
const ALL_OCTANTS = [0, 1, 2, 3, 4, 5, 6, 7];
const LATTICE_OCTANTS = [0, 7];

/** Lattice coordinates (points, 3) of a frame's points, from the octree's corner; and the sample near each point, −1: none. */
export interface LatticePoints {
  cells: Int32Array;
  samples: Int32Array;
}

/** Reads the occupied children of a level's cubes. height: levels from the cubes to the points; side: length of a child. */
export type ReadLevel = (cubes: Int32Array, samples: Int32Array, height: number, side: number) => Uint8Array;

/** The points of an octree whose bits are coded octant by octant. */
export function readPoints(bits: MixedBits, depth: number, points: number, surface: SurfaceHints | undefined): LatticePoints {
  return readLevels(depth, points, surface, (cubes, samples, height, side) =>
    readLevel(bits, cubes, height === 1 ? LATTICE_OCTANTS : ALL_OCTANTS, height, surface?.level(cubes, samples, side)),
  );
}

/** The points of an octree, from the root down. */
export function readLevels(depth: number, points: number, surface: SurfaceHints | undefined, read: ReadLevel): LatticePoints {
  let cubes = new Int32Array(3);
  let samples = Int32Array.of(-1);
  for (let level = 0; level < depth; level++) {
    const side = 16 * 2 ** (depth - level - 1);
    if (surface) samples = surface.nearest(cubes, samples, side, depth) as typeof samples;
    const next = descend(cubes, read(cubes, samples, depth - level, side));
    check(next.parents.length <= points, "bodycast: an octree has too many points");
    const above = samples;
    samples = next.parents.map((parent) => above[parent]!) as typeof samples;
    cubes = next.cubes as typeof cubes;
  }
  check(samples.length === points, "bodycast: an octree has a wrong number of points");
  return { cells: cubes, samples };
}

function readLevel(bits: MixedBits, cubes: Int32Array, octants: number[], height: number, hints: Hints | undefined): Uint8Array {
  const count = cubes.length / 3;
  const neighbours = neighbourCubes(cubes);
  const children = new Uint8Array(count);
  const tall = Math.min(height, 15);
  octants.forEach((octant, turn) => {
    const left = octants.length - turn - 1;
    const rest = octants.slice(turn);
    for (let i = 0; i < count; i++) {
      if (left === 0 && !children[i]) {
        children[i] = 1 << octant;
        continue;
      }
      const few = Math.min(bitsIn(children[i]!), 3);
      let [beside, nearby, filled] = [0, 0, 0];
      for (let axis = 0; axis < 3; axis++) {
        const [before, behind] = [neighbours[6 * i + 2 * axis]!, neighbours[6 * i + 2 * axis + 1]!];
        filled += Number(before >= 0) + Number(behind >= 0);
        let [inner, outer] = [0, Number(before >= 0)];
        if ((octant >> axis) & 1) {
          const opposite = octant ^ (1 << axis);
          inner = (children[i]! >> opposite) & 1;
          outer = behind >= 0 ? (children[behind]! >> opposite) & 1 : 0;
        }
        beside = 4 * beside + 2 * inner + outer;
        nearby += inner + outer;
      }
      const [narrow, wide] = hints ? [hints.posterior(i, rest, false), hints.posterior(i, rest, true)] : [NO_HINT, NO_HINT];
      const [distance, held] = hints ? [hints.distanceClass(i, octant), hints.held(i, octant)] : [NO_DISTANCE, 0];
      const hint = hints ? (hints.has(i) ? 2 : 1) : 0;
      const bit = bits.bit(
        ((octant * 4 + few) * 64 + beside) * 4 + Math.min(filled >> 1, 3),
        narrow * 4 + few,
        (wide * 4 + few) * 16 + tall,
        ((distance * 5 + held) * 4 + few) * 16 + tall,
        ((narrow * 7 + nearby) * 4 + few) * 8 + left,
        ((Math.min(height, 20) * 4 + few) * 3 + hint) % WEIGHT_SETS,
      );
      children[i]! |= bit << octant;
    }
  });
  return children;
}
