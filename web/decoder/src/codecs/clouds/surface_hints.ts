/** Contexts for the cubes of an octree, from the samples of a frame (docs/payloads/bodycast-points.md, "Octree of a frame"). */

import { check } from "../../errors.js";
import { CubeIndex } from "./cubes.js";
import type { Samples } from "./references.js";
import type { Standing } from "./scene.js";
import { NEIGHBOURS } from "./surface.js";

/** Classes without a sample: of the probability of an octant, and of its distance. */
export const NO_HINT = 64;
export const NO_DISTANCE = 21;

export const NORMAL = 2 ** 10;
const SUBUNITS = 16;
const PLACE = 2 ** 16;
export const HALF = 8;
const MOST_IN_CUBE = 3;
const MOST_COORDINATE = 2 ** 40;
export const DISTANCE_STEPS = [1, 2, 3, 4, 5, 7, 9, 12, 16, 24];
export const BELL = Int32Array.from({ length: 65 }, (_, k) => 1 + Math.floor(4096 * Math.exp(-((k / 16) ** 2) / 2) + 0.5));
/** Steps to the cubes around a cube, along each axis, in the order of the search. */
const STEPS = [0, -1, 1];

/** Contexts for the children of the cubes of a level, from the surface. */
export interface Hints {
  has(cube: number): boolean;
  /** Class of the probability that the first of these octants is occupied, given that one of them is. */
  posterior(cube: number, octants: number[], isWide: boolean): number;
  distanceClass(cube: number, octant: number): number;
  /** Class of the number of samples in a child. */
  held(cube: number, octant: number): number;
}

/** The samples of the bodies, in subunits from the corner of the octree; none without a body. step: metres of a lattice unit; corner
 * (3) in lattice units. Throws Corrupt for poses that are out of range. */
export function samplesOfBodies({ count, moved, normals, neighbours }: Standing, step: number, corner: number[]): Samples | undefined {
  if (!count) return undefined;
  const scale = SUBUNITS / (step * PLACE);
  const points = moved.map((value, i) => {
    check(Math.abs(value) * scale <= MOST_COORDINATE, "bodycast: a pose is out of range");
    return Math.floor(value * scale) - SUBUNITS * corner[i % 3]!;
  });
  return { points, normals, neighbours };
}

/** The cubes of one side length that contain samples, and the numbers of the samples in each. */
interface Inside {
  side: number;
  index: CubeIndex;
  samples: number[][];
}

export class SurfaceHints {
  /** Places (samples, 3), in subunits from the corner of the octree. */
  readonly points: Float64Array;
  readonly normals: Float64Array;
  readonly neighbours: Int32Array;
  readonly spacing: number;
  /** Last result of `inside`: the children of a level are the cubes of the next level. */
  private last?: Inside;

  /** largeCubesCorrect: whether cubes larger than the spacing have offsets. */
  constructor(
    { points, normals, neighbours }: Samples,
    private readonly largeCubesCorrect: boolean,
  ) {
    const count = points.length / 3;
    this.points = points;
    this.normals = normals;
    this.neighbours = neighbours;
    const gaps = new Float64Array(count);
    for (let i = 0; i < count; i++) gaps[i] = this.square(neighbours[NEIGHBOURS * i]!, this.points[3 * i]!, this.points[3 * i + 1]!, this.points[3 * i + 2]!);
    this.spacing = Math.max(Math.floor(Math.sqrt(gaps.sort()[count >> 1]!)), 1);
  }

  private square(sample: number, x: number, y: number, z: number): number {
    const [dx, dy, dz] = [this.points[3 * sample]! - x, this.points[3 * sample + 1]! - y, this.points[3 * sample + 2]! - z];
    return dx * dx + dy * dy + dz * dz;
  }

  /** Signed distance of a place from the plane of a sample. */
  distance(sample: number, x: number, y: number, z: number): number {
    const at = 3 * sample;
    const sum = (x - this.points[at]!) * this.normals[at]! + (y - this.points[at + 1]!) * this.normals[at + 1]! + (z - this.points[at + 2]!) * this.normals[at + 2]!;
    return Math.floor(sum / NORMAL);
  }

  /** The samples in each cube of this side length. */
  private inside(side: number): Inside {
    if (this.last?.side === side) return this.last;
    const count = this.points.length / 3;
    const cells = Float64Array.from(this.points, (v) => Math.floor((v + HALF) / side));
    const order = new Map<string, number>();
    const places: number[] = [];
    const samples: number[][] = [];
    for (let i = 0; i < count; i++) {
      const key = `${cells[3 * i]},${cells[3 * i + 1]},${cells[3 * i + 2]}`;
      let cube = order.get(key);
      if (cube === undefined) {
        order.set(key, (cube = samples.length));
        places.push(cells[3 * i]!, cells[3 * i + 1]!, cells[3 * i + 2]!);
        samples.push([]);
      }
      samples[cube]!.push(i);
    }
    return (this.last = { side, index: new CubeIndex(places), samples });
  }

  /** A sample near each cube (n, 3), −1: none. parents: samples near their parents; side: length of a child, subunits. */
  nearest(cubes: Int32Array, parents: Int32Array, side: number, depth: number): Int32Array {
    const out = new Int32Array(parents.length).fill(-1);
    if (2 * side > 4 * this.spacing) return out;
    const isSearched = 4 * side > this.spacing;
    const { index, samples } = isSearched ? this.inside(2 * side) : { index: undefined, samples: [] };
    const cubesAcross = (SUBUNITS * 2 ** depth) / (2 * side);
    for (let i = 0; i < out.length; i++) {
      const cube = [cubes[3 * i]!, cubes[3 * i + 1]!, cubes[3 * i + 2]!] as const;
      const [x, y, z] = cube.map((v) => 2 * side * v + side - HALF) as [number, number, number];
      let best = parents[i]!;
      let least = best < 0 ? Infinity : this.square(best, x, y, z);
      const consider = (sample: number) => {
        const square = this.square(sample, x, y, z);
        if (square >= least) return;
        best = sample;
        least = square;
      };
      const parent = parents[i]!;
      if (parent >= 0) for (let k = 0; k < NEIGHBOURS; k++) consider(this.neighbours[NEIGHBOURS * parent + k]!);
      if (index) {
        for (const dx of STEPS) {
          for (const dy of STEPS) {
            for (const dz of STEPS) {
              const place = [cube[0] + dx, cube[1] + dy, cube[2] + dz] as const;
              if (place.some((v) => v < 0 || v >= cubesAcross)) continue;
              const found = index.find(...place);
              if (found >= 0) for (const sample of samples[found]!.slice(0, MOST_IN_CUBE)) consider(sample);
            }
          }
        }
      }
      out[i] = best;
    }
    return out;
  }

  /** Hints for the children of cubes (n, 3). samples: near each cube; side: length of a child. */
  level(cubes: Int32Array, samples: Int32Array, side: number): Hints {
    const { offsets, spreads } = this.corrections(cubes, samples, side);
    const distances = new Float64Array(8 * samples.length);
    for (let i = 0; i < samples.length; i++) {
      const s = Math.max(samples[i]!, 0);
      const at = (axis: number) => 2 * side * cubes[3 * i + axis]! + Math.floor(side / 2) - HALF;
      const first = this.distance(s, at(0), at(1), at(2)) - offsets[i]!;
      const steps = [0, 1, 2].map((axis) => Math.floor((this.normals[3 * s + axis]! * side) / NORMAL));
      for (let octant = 0; octant < 8; octant++) {
        distances[8 * i + octant] = first + steps.reduce((sum, step, axis) => sum + ((octant >> axis) & 1 ? step : 0), 0);
      }
    }
    return {
      has: (cube) => samples[cube]! >= 0,
      posterior(cube, octants, isWide) {
        if (samples[cube]! < 0) return NO_HINT;
        const sigma = isWide ? Math.max(2 * Math.max(spreads[cube]!, Math.floor(side / 4)), 1) : Math.max(spreads[cube]!, Math.floor(side / 4), 1);
        let [first, sum] = [0, 0];
        octants.forEach((octant, k) => {
          const weight = BELL[Math.min(Math.floor((Math.abs(distances[8 * cube + octant]!) * 16) / sigma), 64)]!;
          if (k === 0) first = weight;
          sum += weight;
        });
        return Math.floor((64 * first) / (sum + 1));
      },
      distanceClass(cube, octant) {
        if (samples[cube]! < 0) return NO_DISTANCE;
        const distance = distances[8 * cube + octant]!;
        const steps = DISTANCE_STEPS.filter((step) => step * side <= 4 * Math.abs(distance)).length;
        return DISTANCE_STEPS.length + (distance < 0 ? -steps : steps);
      },
      held: this.held(cubes, side),
    };
  }

  /** A function that returns the class of the number of samples in a child of cubes (n, 3). side: length of a child. */
  held(cubes: Int32Array, side: number): (cube: number, octant: number) => number {
    if (2 * side <= this.spacing) return () => 0;
    const { index, samples } = this.inside(side);
    return (cube, octant) => {
      const at = (axis: number) => 2 * cubes[3 * cube + axis]! + ((octant >> axis) & 1);
      const found = index.find(at(0), at(1), at(2));
      const count = found < 0 ? 0 : samples[found]!.length;
      return Number(count >= 1) + Number(count >= 2) + Number(count >= 3) + Number(count >= 5);
    };
  }

  /** Offset of the surface in each cube, and its spread. */
  private corrections(cubes: Int32Array, samples: Int32Array, side: number): { offsets: Float64Array; spreads: Float64Array } {
    const far = new Float64Array(samples.length);
    const at = (i: number, axis: number) => 2 * side * cubes[3 * i + axis]! + side - HALF;
    samples.forEach((s, i) => (far[i] = s < 0 ? 0 : this.distance(s, at(i, 0), at(i, 1), at(i, 2))));
    const offsets = this.largeCubesCorrect || 2 * side <= this.spacing ? this.means(samples, far, 0) : new Float64Array(samples.length);
    let [sum, count] = [0, 0];
    const deviations = far.map((distance, i) => {
      if (samples[i]! < 0) return 0;
      const deviation = Math.abs(distance - offsets[i]!);
      sum += deviation;
      count++;
      return deviation;
    });
    const spreads = this.means(samples, deviations, 2 * (count ? Math.floor(sum / count) : 0));
    samples.forEach((s, i) => {
      if (s >= 0) return;
      offsets[i] = 0;
      spreads[i] = 2 * side;
    });
    return { offsets, spreads };
  }

  /** For each cube, the mean of `values` over the cubes of its sample and of that sample's neighbours. */
  private means(samples: Int32Array, values: Float64Array, extra: number): Float64Array {
    const sums = new Float64Array(this.points.length / 3);
    const counts = new Float64Array(this.points.length / 3);
    samples.forEach((s, i) => {
      if (s < 0) return;
      sums[s]! += values[i]!;
      counts[s]!++;
    });
    return Float64Array.from(samples, (s) => {
      if (s < 0) return 0;
      let [sum, count] = [sums[s]! + extra, counts[s]! + 2];
      for (let k = 0; k < NEIGHBOURS; k++) {
        const other = this.neighbours[NEIGHBOURS * s + k]!;
        sum += sums[other]!;
        count += counts[other]!;
      }
      return Math.floor(sum / count);
    });
  }
}
