/** Octrees of points on a lattice, cube by cube (docs/payloads/bodycast-points.md, "Octrees cube by cube"). */

import { bitsIn, neighbourCubes } from "./cubes.js";
import type { MixedBits } from "./mixed.js";
import { type LatticePoints, readLevels, WEIGHT_SETS } from "./point_octree.js";
import { BELL, DISTANCE_STEPS, HALF, NORMAL, NO_DISTANCE, NO_HINT, type SurfaceHints } from "./surface_hints.js";
import { NEIGHBOURS } from "./surface.js";

const CUBES_OF_SAMPLE = 4;
const MOST_SPACING = 2 ** 16;
const MOST_DISTANCE = 2 ** 25;
const MOST_DEVIATION = 2 ** 20;
const SAMPLE_WEIGHT = 5120;
const USUAL_WEIGHT = 1024;
const LEAST_VARIANCE = 16;
const DENSITY = 1634;
const MOST_DENSITY = 2 ** 24;
const MOST_EXPECTED = 2 ** 19;
const TWO = 2 ** 17;
const LEAST_ODDS = 2 ** 16;

/** The points of an octree whose bits are coded cube by cube. */
export function readPointsByCube(bits: MixedBits, depth: number, points: number, surface: SurfaceHints | undefined): LatticePoints {
  return readLevels(depth, points, surface, (cubes, samples, height, side) =>
    readLevel(bits, cubes, height, surface && new Passage(surface, cubes, samples, side, points)),
  );
}

function readLevel(bits: MixedBits, cubes: Int32Array, height: number, passage: Passage | undefined): Uint8Array {
  const count = cubes.length / 3;
  const neighbours = neighbourCubes(cubes);
  const children = new Uint8Array(count);
  const tall = Math.min(height, 15);
  const step = height === 1 ? 7 : 1;
  for (let i = 0; i < count; i++) {
    const isNear = passage !== undefined && passage.samples[i]! >= 0;
    if (isNear) passage.expect(i);
    const hint = passage ? 1 + Number(isNear) : 0;
    let filled = 0;
    for (let k = 0; k < 6; k++) filled += Number(neighbours[6 * i + k]! >= 0);
    filled = Math.min(filled >> 1, 3);
    let known = 0;
    for (let octant = 0; octant < 8; octant += step) {
      const left = (7 - octant) / step;
      if (left === 0 && !known) {
        known = 1 << octant;
        break;
      }
      const few = Math.min(bitsIn(known), 3);
      let [beside, nearby] = [0, 0];
      for (let axis = 0; axis < 3; axis++) {
        const isUpper = (octant >> axis) & 1;
        const row = neighbours[6 * i + 2 * axis + isUpper]!;
        const inner = ((isUpper ? known : row >= 0 ? children[row]! : 0) >> (octant ^ (1 << axis))) & 1;
        const outer = Number(row >= 0);
        beside = 4 * beside + 2 * inner + outer;
        nearby += inner + outer;
      }
      const [narrow, wide] = isNear ? [oddsClass(passage.narrow, octant, step, few), oddsClass(passage.wide, octant, step, few)] : [NO_HINT, NO_HINT];
      const distance = isNear ? passage.distanceClass(octant) : NO_DISTANCE;
      const held = passage ? passage.held(i, octant) : 0;
      const bit = bits.bit(
        ((octant * 4 + few) * 64 + beside) * 4 + filled,
        narrow * 4 + few,
        (wide * 4 + few) * 16 + tall,
        ((distance * 5 + held) * 4 + few) * 16 + tall,
        ((narrow * 7 + nearby) * 4 + few) * 8 + left,
        ((Math.min(height, 20) * 4 + few) * 3 + hint) % WEIGHT_SETS,
      );
      known |= bit << octant;
    }
    children[i] = known;
    if (isNear) passage.learn(i, known);
  }
  return children;
}

/** Class of the odds that an octant is occupied, from the points expected in it and in the octants after it. */
function oddsClass(expected: Float64Array, octant: number, step: number, few: number): number {
  const own = expected[octant]!;
  let others = 0;
  for (let next = octant + step; next < 8; next += step) others += expected[next]!;
  let odds = Math.floor((own * (TWO + own)) / TWO);
  odds = few || others >= TWO ? odds * 256 : Math.floor((odds * 128 * (TWO + others)) / others);
  if (odds < LEAST_ODDS) return 0;
  let order = 0;
  for (; odds >= 2 * LEAST_ODDS; order++) odds = Math.floor(odds / 2);
  return Math.min(4 * order + ((odds >> 14) & 3), NO_HINT - 1);
}

/** Estimates the surface within the cubes of a level. Lengths are in subunits. */
class Passage {
  /** Expected points in the children of the last cube, in 2^-16, for a small and a large standard deviation. */
  readonly narrow = new Float64Array(8);
  readonly wide = new Float64Array(8);
  readonly held: (cube: number, octant: number) => number;
  private readonly distances = new Float64Array(8);
  private readonly centres: Float64Array;
  private readonly places: Float64Array;
  private readonly noise: Float64Array;
  private readonly far: Float64Array;
  private readonly spacing: number;
  private readonly usual: number;
  private readonly density: number;
  private readonly cubesOf = new Map<number, number[]>();

  constructor(
    private readonly surface: SurfaceHints,
    private readonly cubes: Int32Array,
    readonly samples: Int32Array,
    private readonly side: number,
    points: number,
  ) {
    this.centres = Float64Array.from(cubes, (v) => 2 * side * v + side - HALF);
    this.places = this.centres.slice();
    this.noise = new Float64Array(samples.length).fill(4 * side * side);
    this.spacing = Math.min(surface.spacing, MOST_SPACING);
    let [known, sum] = [0, 0];
    this.far = Float64Array.from(samples, (s, i) => {
      if (s < 0) return 0;
      const own = this.cubesOf.get(s);
      if (own) own.push(i);
      else this.cubesOf.set(s, [i]);
      const far = surface.distance(s, this.centres[3 * i]!, this.centres[3 * i + 1]!, this.centres[3 * i + 2]!);
      const clipped = Math.min(Math.max(far, -MOST_DISTANCE), MOST_DISTANCE);
      known++;
      sum += Math.abs(clipped);
      return clipped;
    });
    for (const [s, own] of this.cubesOf)
      if (own.length > CUBES_OF_SAMPLE) this.cubesOf.set(s, [0, 1, 2, 3].map((k) => own[Math.floor((k * own.length) / CUBES_OF_SAMPLE)]!));
    this.usual = Math.floor(sum / Math.max(known, 1));
    const across = Math.floor((side * 256) / this.spacing);
    this.density = known ? Math.min(Math.floor((points * DENSITY * across * across) / ((16 * surface.points.length) / 3)), MOST_DENSITY) : 0;
    this.held = surface.held(cubes, side);
  }

  /** Sets the expected occupancy of the children of a cube, which has a sample. */
  expect(i: number): void {
    const { side, surface, distances } = this;
    const own = this.samples[i]!;
    const [offset, variance] = this.find(i);
    const at = (axis: number) => 2 * side * this.cubes[3 * i + axis]! + side / 2 - HALF;
    const distance = surface.distance(own, at(0), at(1), at(2)) - offset;
    const steps = [0, 1, 2].map((axis) => Math.floor((surface.normals[3 * own + axis]! * side) / NORMAL));
    for (let octant = 0; octant < 8; octant++) distances[octant] = distance + steps.reduce((sum, step, axis) => sum + ((octant >> axis) & 1 ? step : 0), 0);
    const cut = Math.floor((4 * side * side) / 48);
    this.fill(this.narrow, Math.floor(Math.sqrt(variance + cut)));
    this.fill(this.wide, Math.floor(Math.sqrt(3 * variance + cut)));
  }

  private fill(expected: Float64Array, sigma: number): void {
    const most = Math.min(Math.floor((this.density * this.side) / (sigma * 256)), MOST_EXPECTED);
    this.distances.forEach((distance, octant) => {
      const weight = BELL[Math.min(Math.floor((Math.abs(distance) * 16) / sigma), 64)]!;
      expected[octant] = Math.floor((most * weight) / 4096) + 1;
    });
  }

  /** Distance from the plane of a cube's sample to the estimated surface, and its variance. */
  private find(i: number): [number, number] {
    const { surface, places, centres, spacing } = this;
    const { normals, neighbours } = surface;
    const own = this.samples[i]!;
    const weights: number[] = [];
    const distances: number[] = [];
    let [total, sum] = [0, 0];
    for (let k = -1; k < NEIGHBOURS; k++) {
      const sample = k < 0 ? own : neighbours[NEIGHBOURS * own + k]!;
      if (k >= 0 && sample === own) continue;
      for (const j of this.cubesOf.get(sample) ?? []) {
        let [apart, along] = [0, 0];
        for (let axis = 0; axis < 3; axis++) {
          const step = places[3 * j + axis]! - centres[3 * i + axis]!;
          apart += step * step;
          along += step * (normals[3 * own + axis]! + normals[3 * sample + axis]!);
        }
        const weight = Math.floor((spacing * spacing * 2 ** 16) / (13 * apart + 10 * spacing * spacing + 64 * this.noise[j]! + 1));
        const distance = this.far[i]! + Math.floor(along / (2 * NORMAL));
        weights.push(weight);
        distances.push(distance);
        total += weight;
        sum += weight * distance;
      }
    }
    const offset = Math.floor(sum / (total + SAMPLE_WEIGHT));
    const spread = weights.reduce((all, weight, n) => all + weight * Math.abs(distances[n]! - offset), USUAL_WEIGHT * this.usual);
    const deviation = Math.min(Math.floor(spread / (total + USUAL_WEIGHT)), MOST_DEVIATION);
    return [offset, Math.max(Math.floor((166 * deviation * deviation) / 256) - Math.floor((4 * this.side * this.side) / 20), LEAST_VARIANCE)];
  }

  /** Updates the estimate with the occupied children of a cube. */
  learn(i: number, children: number): void {
    const count = bitsIn(children);
    [0xaa, 0xcc, 0xf0].forEach((upper, axis) => {
      this.places[3 * i + axis] = this.centres[3 * i + axis]! - this.side / 2 + Math.floor((bitsIn(children & upper) * this.side) / count);
    });
    this.noise[i] = Math.floor((4 * this.side * this.side) / (6 * count));
  }

  distanceClass(octant: number): number {
    const distance = this.distances[octant]!;
    const steps = DISTANCE_STEPS.filter((step) => step * this.side <= 4 * Math.abs(distance)).length;
    return DISTANCE_STEPS.length + (distance < 0 ? -steps : steps);
  }
}
