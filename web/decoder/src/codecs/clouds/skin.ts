/** Points that follow the links of a body, at most two each (docs/payloads/bodycast.md, "Skinning"). */

import { type Vector, matrixOf, times } from "../../geometry.js";
import type { Body, Placement } from "../bodies.js";
import { CubeIndex } from "./cubes.js";
import type { Sample } from "./sampling.js";

/** Radius of influence, share of the body's size. */
const RADIUS = 0.0375;
/** Least side of a cube. */
const SMALLEST_M = 1e-6;

export class Skin {
  /** Two links of each point (points, 2), and the share of the first. */
  private readonly links: Uint8Array;
  private readonly shares: Float64Array;

  constructor(body: Body, samples: Sample[]) {
    const radius = RADIUS * extentOf(body);
    this.links = new Uint8Array(2 * samples.length);
    this.shares = new Float64Array(samples.length);
    const grid = new Grid(samples, radius);
    const weights = new Float64Array(body.parents.length);
    for (let cube = 0; cube + 1 < grid.starts.length; cube++) {
      const around = grid.around(cube);
      const only = grid.onlyLink(around);
      for (let slot = grid.starts[cube]!; slot < grid.starts[cube + 1]!; slot++) {
        weights.fill(0);
        if (only >= 0) weights[only] = 1;
        else grid.weigh(slot, around, weights);
        this.set(grid.samples[slot]!, weights);
      }
    }
  }

  private set(i: number, weights: Float64Array): void {
    const first = largest(weights, -1);
    const second = largest(weights, first);
    const rest = second < 0 ? 0 : weights[second]!;
    this.links[2 * i] = first;
    this.links[2 * i + 1] = rest > 0 ? second : first;
    this.shares[i] = weights[first]! / (weights[first]! + rest);
  }

  /** Poses canonical points (n, 3). */
  posed(points: Float64Array, placements: Placement[]): Float64Array {
    const turns = Float64Array.from(placements.flatMap(({ turn }) => matrixOf(turn)));
    const shifts = Float64Array.from(placements.flatMap(({ shift }) => shift));
    const { links, shares } = this;
    const out = new Float64Array(points.length);
    for (let i = 0; i < shares.length; i++) {
      const [x, y, z] = [points[3 * i]!, points[3 * i + 1]!, points[3 * i + 2]!];
      for (let k = 0; k < 2; k++) {
        const share = k ? 1 - shares[i]! : shares[i]!;
        if (share === 0) continue;
        const link = links[2 * i + k]!;
        for (let c = 0; c < 3; c++) {
          const at = 9 * link + 3 * c;
          out[3 * i + c]! += share * (turns[at]! * x + turns[at + 1]! * y + turns[at + 2]! * z + shifts[3 * link + c]!);
        }
      }
    }
    return out;
  }
}

/** The largest extent of all origins and tips along x, y or z. */
function extentOf({ origins, tips }: Body): number {
  const ends = [...origins, ...tips];
  return Math.max(...[0, 1, 2].map((c) => Math.max(...ends.map((end) => end[c]!)) - Math.min(...ends.map((end) => end[c]!))));
}

/** Index of the first largest value, except index `without`; −1 if there is no other. */
export function largest(values: ArrayLike<number>, without: number): number {
  let best = -1;
  for (let i = 0; i < values.length; i++) if (i !== without && (best < 0 || values[i]! > values[best]!)) best = i;
  return best;
}

/** Samples sorted by the cube of a grid. The samples of a cube have consecutive slots. */
class Grid {
  /** The first slot of each cube, and the end. */
  readonly starts: Int32Array;
  /** The sample in each slot; then its link, place (unit: the radius) and normal. */
  readonly samples: Int32Array;
  private readonly links: Uint8Array;
  private readonly places: Float64Array;
  private readonly normals: Float64Array;
  /** Coordinates (cubes, 3). */
  private readonly cubes: Int32Array;
  private readonly index: CubeIndex;

  constructor(samples: Sample[], radius: number) {
    const unit = 1 / Math.max(radius, SMALLEST_M);
    const cubeOf = ({ place }: Sample) => place.map((v) => Math.floor(v * unit)) as Vector;
    const numbers = new Map<string, number>();
    const cubes: number[] = [];
    const cubeOfSample = samples.map((sample) => {
      const cube = cubeOf(sample);
      const key = cube.join();
      let number = numbers.get(key);
      if (number === undefined) {
        number = numbers.size;
        numbers.set(key, number);
        cubes.push(...cube);
      }
      return number;
    });
    this.cubes = Int32Array.from(cubes);
    this.index = new CubeIndex(this.cubes);
    this.starts = new Int32Array(numbers.size + 1);
    for (const cube of cubeOfSample) this.starts[cube + 1]!++;
    for (let cube = 0; cube < numbers.size; cube++) this.starts[cube + 1]! += this.starts[cube]!;
    this.samples = new Int32Array(samples.length);
    this.links = new Uint8Array(samples.length);
    this.places = new Float64Array(3 * samples.length);
    this.normals = new Float64Array(3 * samples.length);
    const next = this.starts.slice();
    samples.forEach(({ link, place, normal }, i) => {
      const slot = next[cubeOfSample[i]!]!++;
      this.samples[slot] = i;
      this.links[slot] = link;
      this.places.set(times(unit, place), 3 * slot);
      this.normals.set(normal, 3 * slot);
    });
  }

  /** The cubes around a cube that have samples. */
  around(cube: number): number[] {
    const [x, y, z] = [this.cubes[3 * cube]!, this.cubes[3 * cube + 1]!, this.cubes[3 * cube + 2]!];
    const found: number[] = [];
    for (let dx = -1; dx <= 1; dx++) {
      for (let dy = -1; dy <= 1; dy++) {
        for (let dz = -1; dz <= 1; dz++) {
          const other = this.index.find(x + dx, y + dy, z + dz);
          if (other >= 0) found.push(other);
        }
      }
    }
    return found;
  }

  /** The common link of all samples in these cubes, −1 if they have several. */
  onlyLink(cubes: number[]): number {
    const link = this.links[this.starts[cubes[0]!]!]!;
    for (const cube of cubes) {
      for (let slot = this.starts[cube]!; slot < this.starts[cube + 1]!; slot++) if (this.links[slot] !== link) return -1;
    }
    return link;
  }

  /** Adds the weights of the samples in these cubes, seen from the sample in slot `own`, to the weights of their links. */
  weigh(own: number, cubes: number[], weights: Float64Array): void {
    const { places, normals, links, starts } = this;
    const [x, y, z] = [places[3 * own]!, places[3 * own + 1]!, places[3 * own + 2]!];
    const [nx, ny, nz] = [normals[3 * own]!, normals[3 * own + 1]!, normals[3 * own + 2]!];
    for (const cube of cubes) {
      const stop = 3 * starts[cube + 1]!;
      for (let at = 3 * starts[cube]!; at < stop; at += 3) {
        const dx = places[at]! - x;
        const dy = places[at + 1]! - y;
        const dz = places[at + 2]! - z;
        const near = 1 - (dx * dx + dy * dy + dz * dz);
        if (near <= 0 || at === 3 * own) continue;
        const alike = normals[at]! * nx + normals[at + 1]! * ny + normals[at + 2]! * nz;
        if (alike > 0) weights[links[at / 3]!]! += near * near * alike;
      }
    }
    weights[links[own]!]! += 1;
  }
}
