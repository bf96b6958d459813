/** Points that follow the links of a body, at most two each (docs/payloads/bodycast.md, "Skinning"). */

import { matrixOf } from "../../geometry.js";
import type { Body, Placement } from "../bodies.js";
import { CubeIndex } from "./cubes.js";
import type { Sample } from "./sampling.js";

/** Of the body's size. */
const RADIUS = 0.0375;

export class Skin {
  /** (points, 2): links; and the share of the first. */
  private readonly links: Uint8Array;
  private readonly shares: Float64Array;

  constructor(body: Body, samples: Sample[]) {
    const radius = RADIUS * extentOf(body);
    const buckets = new Buckets(samples, radius);
    const links = body.parents.length;
    const weights = new Float64Array(links);
    this.links = new Uint8Array(2 * samples.length);
    this.shares = new Float64Array(samples.length);
    samples.forEach((sample, i) => {
      weights.fill(0);
      buckets.around(i, (j) => {
        const other = samples[j]!;
        weights[other.link]! += i === j ? 1 : weightOf(sample, other, radius);
      });
      const first = largest(weights, -1);
      const second = largest(weights, first);
      const rest = second < 0 ? 0 : weights[second]!;
      this.links[2 * i] = first;
      this.links[2 * i + 1] = rest > 0 ? second : first;
      this.shares[i] = weights[first]! / (weights[first]! + rest);
    });
  }

  /** Points (n, 3), canonical, where the links stand. */
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

function weightOf(a: Sample, b: Sample, radius: number): number {
  const [x, y, z] = [a.place[0] - b.place[0], a.place[1] - b.place[1], a.place[2] - b.place[2]];
  const near = 1 - (x * x + y * y + z * z) / (radius * radius);
  if (near <= 0) return 0;
  const alike = a.normal[0] * b.normal[0] + a.normal[1] * b.normal[1] + a.normal[2] * b.normal[2];
  return alike > 0 ? near * near * alike : 0;
}

function largest(values: Float64Array, without: number): number {
  let best = -1;
  for (let i = 0; i < values.length; i++) if (i !== without && (best < 0 || values[i]! > values[best]!)) best = i;
  return best;
}

/** Samples by the cube of a grid that they are in. */
class Buckets {
  /** (samples, 3): cubes. */
  private readonly cubes: Int32Array;
  private readonly index: CubeIndex;
  private readonly members: number[][] = [];

  constructor(samples: Sample[], size: number) {
    this.cubes = Int32Array.from(samples.flatMap(({ place }) => place.map((v) => Math.floor(v / Math.max(size, 1e-6)))));
    const found = new Map<string, number[]>();
    samples.forEach((_, i) => {
      const key = this.cubes.subarray(3 * i, 3 * i + 3).join();
      const own = found.get(key);
      if (own) own.push(i);
      else found.set(key, [i]);
    });
    this.members = [...found.values()];
    this.index = new CubeIndex(this.members.flatMap(([first]) => [...this.cubes.subarray(3 * first!, 3 * first! + 3)]));
  }

  /** Calls `use` with the samples in the cubes around that of sample i. */
  around(i: number, use: (j: number) => void): void {
    const [x, y, z] = [this.cubes[3 * i]!, this.cubes[3 * i + 1]!, this.cubes[3 * i + 2]!];
    for (let dx = -1; dx <= 1; dx++) {
      for (let dy = -1; dy <= 1; dy++) {
        for (let dz = -1; dz <= 1; dz++) {
          const cube = this.index.find(x + dx, y + dy, z + dz);
          if (cube >= 0) for (const j of this.members[cube]!) use(j);
        }
      }
    }
  }
}
