/** Octrees of adaptive bits (docs/payloads/bodycast.md, "Octree"). */

import { check } from "../../errors.js";
import { type AdaptiveBits, Counts } from "./adaptive.js";
import { bitsIn, descend, neighbourCubes } from "./cubes.js";

const OCTANT_CONTEXTS = 10_752;
const MULTIPLICITY_CONTEXTS = 4;

/** Adaptive counts, shared by the octrees of one stream. */
export class OctreeCounts {
  readonly octants = new Counts(OCTANT_CONTEXTS);
  readonly multiplicity = new Counts(MULTIPLICITY_CONTEXTS);
}

/** The cube (points, 3) of level `stop` around each point of a frame. Throws Corrupt. */
export function readOctree(bits: AdaptiveBits, counts: OctreeCounts, points: number, stop: number): Int32Array {
  let cubes = new Int32Array(3);
  for (let level = 0; level < stop; level++) {
    cubes = descend(cubes, readLevel(bits, counts.octants, cubes)).cubes as typeof cubes;
    check(cubes.length > 0 && cubes.length <= 3 * points, "bodycast: an octree has a wrong number of cubes");
  }
  const often = new Int32Array(cubes.length / 3).fill(1);
  let rows = Int32Array.from(often.keys());
  let total = rows.length;
  for (let group = 0; rows.length; group++) {
    const more = bits.group(counts.multiplicity, new Int32Array(rows.length).fill(Math.min(group, MULTIPLICITY_CONTEXTS - 1)));
    rows = rows.filter((_, i) => more[i]);
    for (const row of rows) often[row]!++;
    total += rows.length;
    check(total <= points, "bodycast: an octree has too many points");
  }
  check(total === points, "bodycast: an octree has too few points");
  const places = new Int32Array(3 * points);
  let at = 0;
  often.forEach((count, i) => {
    for (let k = 0; k < count; k++, at += 3) places.set(cubes.subarray(3 * i, 3 * i + 3), at);
  });
  return places;
}

function readLevel(bits: AdaptiveBits, counts: Counts, cubes: Int32Array): Uint8Array {
  const neighbours = neighbourCubes(cubes);
  const children = new Uint8Array(cubes.length / 3);
  const contexts = new Int32Array(children.length);
  for (let octant = 0; octant < 8; octant++) {
    for (let i = 0; i < children.length; i++) {
      let context = octant;
      let filled = 0;
      for (let axis = 0; axis < 3; axis++) {
        const [before, behind] = [neighbours[6 * i + 2 * axis]!, neighbours[6 * i + 2 * axis + 1]!];
        filled += Number(before >= 0) + Number(behind >= 0);
        const opposite = octant ^ (1 << axis);
        if (!((octant >> axis) & 1)) context = 4 * context + Number(before >= 0);
        else context = 4 * context + 2 * ((children[i]! >> opposite) & 1) + (behind >= 0 ? (children[behind]! >> opposite) & 1 : 0);
      }
      contexts[i] = (3 * context + Math.min(bitsIn(children[i]!), 2)) * 7 + filled;
    }
    bits.group(counts, contexts).forEach((bit, i) => (children[i]! |= bit << octant));
  }
  return children;
}
