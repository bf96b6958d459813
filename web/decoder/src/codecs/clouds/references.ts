/** Points of earlier frames as samples of the surface (docs/payloads/bodycast-references.md). */

import type { Bytes } from "../../bytes.js";
import { nearestOthers } from "./nearest_others.js";
import { NEIGHBOURS } from "./surface.js";

const MOST_FRAMES = 4;
const MOST_MOTION = 2 ** 16;
const LEAST_POINTS = 48;
const SUBUNITS = 16;
const NORMAL = 2 ** 10;
const SPREAD_BITS = 9;
const COLUMN_BITS = 20;
const CANDIDATES = 7;
const AVERAGED = 4;
const SOFTENING = 128;
const WEIGHT_UNIT = 2 ** 40;

/** Reference of a frame: number of earlier frames, motion of their points, and whether the frame ignores its bodies. */
export interface Reference {
  frames: number;
  motion: number[];
  hides: boolean;
}

export const NO_REFERENCE: Reference = { frames: 0, motion: [0, 0, 0], hides: false };

/** Samples of a surface: places (n, 3) in subunits from the corner of the octree, normals (n, 3), neighbours (n, 12). */
export interface Samples {
  points: Float64Array;
  normals: Float64Array;
  neighbours: Int32Array;
}

interface Kept {
  cells: Float64Array;
  explained: Uint8Array;
  colours: Int32Array | undefined;
}

/** The references of the frames of a chunk. */
export function readReferences(part: Bytes, frames: number): Reference[] {
  return Array.from({ length: frames }, () => {
    const number = part.varintWithin(0, 2 * MOST_FRAMES + 1, "a reference");
    const count = number >> 1;
    const motion = [0, 1, 2].map(() => (count ? part.foldedWithin(-MOST_MOTION, MOST_MOTION, "a motion") : 0));
    return { frames: count, motion, hides: number % 2 === 1 };
  });
}

/** The last frames with points, the latest first. */
export class EarlierFrames {
  private kept: Kept[] = [];

  /** Moves all kept points, and returns the samples that a frame refers to. hasBodies: whether the frame uses bodies. */
  refer({ frames, motion }: Reference, depth: number, hasBodies: boolean): EarlierPoints | undefined {
    for (const { cells } of this.kept) cells.forEach((v, i) => (cells[i] = v + motion[i % 3]!));
    const rows: [frame: number, point: number][] = [];
    const limit = 2 ** depth;
    this.kept.slice(0, frames).forEach(({ cells, explained }, frame) => {
      explained.forEach((isExplained, i) => {
        const isInside = [0, 1, 2].every((axis) => cells[3 * i + axis]! >= 0 && cells[3 * i + axis]! < limit);
        if (isInside && !(hasBodies && isExplained)) rows.push([frame, i]);
      });
    });
    const keys = rows.map(([frame, i]) => mortonParts(this.kept[frame]!.cells.subarray(3 * i, 3 * i + 3)));
    const isEqual = (a: number, b: number) => keys[a]![0] === keys[b]![0] && keys[a]![1] === keys[b]![1];
    const order = [...rows.keys()].sort((a, b) => keys[a]![0] - keys[b]![0] || keys[a]![1] - keys[b]![1] || a - b);
    const own = order.filter((row, k) => k === 0 || !isEqual(row, order[k - 1]!)).map((row) => rows[row]!);
    return own.length < LEAST_POINTS ? undefined : new EarlierPoints(own, this.kept.slice());
  }

  keep(cells: Int32Array, explained: Uint8Array, colours: Int32Array | undefined): void {
    this.kept = [{ cells: Float64Array.from(cells), explained, colours }, ...this.kept.slice(0, MOST_FRAMES - 1)];
  }
}

/** High and low half of the Morton code of coordinates below 2²⁰. */
function mortonParts(cell: Float64Array): [number, number] {
  const parts: [number, number] = [0, 0];
  for (let digit = 0; digit < 20; digit++) {
    const half = digit < 10 ? 1 : 0;
    for (let axis = 0; axis < 3; axis++) parts[half] += ((cell[axis]! >> digit) & 1) * 2 ** (3 * (digit % 10) + axis);
  }
  return parts;
}

/** Points of earlier frames as samples. */
export class EarlierPoints implements Samples {
  readonly points: Float64Array;
  readonly normals: Float64Array;
  readonly neighbours: Int32Array;

  constructor(
    private readonly rows: [frame: number, point: number][],
    private readonly kept: Kept[],
  ) {
    const places = new Float64Array(3 * rows.length);
    rows.forEach(([frame, i], k) => [0, 1, 2].forEach((c) => (places[3 * k + c] = SUBUNITS * kept[frame]!.cells[3 * i + c]!)));
    const centre = [0, 1, 2].map((c) => Math.floor(rows.reduce((sum, _, k) => sum + places[3 * k + c]!, 0) / rows.length));
    const around = nearestOthers(places, NEIGHBOURS);
    this.points = new Float64Array(places.length);
    this.normals = new Float64Array(places.length);
    this.neighbours = new Int32Array(around.length);
    for (let i = 0; i < rows.length; i++) this.fit(i, places, centre, around);
    for (let i = 0; i < rows.length; i++) {
      const others = around.subarray(NEIGHBOURS * i, NEIGHBOURS * (i + 1)).filter((n) => this.product(i, n) > 0);
      this.neighbours.fill(i, NEIGHBOURS * i, NEIGHBOURS * (i + 1)).set(others, NEIGHBOURS * i);
    }
  }

  private product(a: number, b: number): number {
    return [0, 1, 2].reduce((sum, c) => sum + this.normals[3 * a + c]! * this.normals[3 * b + c]!, 0);
  }

  /** Fits a plane to point i and its neighbours, and projects the point onto it. */
  private fit(i: number, places: Float64Array, centre: number[], around: Int32Array): void {
    const apart: number[][] = [];
    for (let k = 0; k < NEIGHBOURS; k++) {
      const other = around[NEIGHBOURS * i + k]!;
      apart.push([0, 1, 2].map((c) => places[3 * other + c]! - places[3 * i + c]!));
    }
    let normal = planeNormal(apart);
    if (normal.reduce((sum, n, c) => sum + n * (places[3 * i + c]! - centre[c]!), 0) < 0) normal = normal.map((n) => -n);
    const towards = apart.reduce((sum, d) => sum + d.reduce((inner, v, c) => inner + v * normal[c]!, 0), 0);
    const offset = Math.floor(Math.floor(towards / NORMAL) / (NEIGHBOURS + 1));
    for (let c = 0; c < 3; c++) {
      this.normals[3 * i + c] = normal[c]!;
      this.points[3 * i + c] = places[3 * i + c]! + Math.floor((offset * normal[c]!) / NORMAL);
    }
  }

  /** Writes the expected colour of a point at `cell`, near sample s, to out[at …]. */
  expect(s: number, cell: Int32Array, out: Int32Array, at: number): void {
    const candidates = [s, ...this.neighbours.subarray(NEIGHBOURS * s, NEIGHBOURS * s + CANDIDATES - 1)];
    const square = (n: number) => [0, 1, 2].reduce((sum, c) => sum + (this.points[3 * n + c]! - SUBUNITS * cell[c]!) ** 2, 0);
    const near = candidates.map((n) => ({ n, q: square(n) })).sort((a, b) => a.q - b.q).slice(0, AVERAGED);
    const weights = near.map(({ q }) => Math.floor(WEIGHT_UNIT / (q + SOFTENING)));
    const total = Math.max(weights.reduce((sum, w) => sum + w, 0), 1);
    for (let c = 0; c < 3; c++) {
      const sum = near.reduce((inner, { n }, k) => {
        const [frame, point] = this.rows[n]!;
        return inner + weights[k]! * (this.kept[frame]!.colours?.[3 * point + c] ?? 0);
      }, 0);
      out[at + c] = Math.floor((sum + Math.floor(total / 2)) / total);
    }
  }
}

function binaryDigits(value: number): number {
  return value < 1 ? 0 : Math.floor(Math.log2(value)) + 1;
}

/** The normal of the plane through the origin that fits points `apart`. All numbers stay below 2⁵³. */
function planeNormal(apart: number[][]): number[] {
  const down = 2 ** Math.max(binaryDigits(Math.max(...apart.flat().map(Math.abs))) - SPREAD_BITS, 0);
  const small = apart.map((d) => d.map((v) => Math.floor(v / down)));
  const total = [0, 1, 2].map((c) => small.reduce((sum, d) => sum + d[c]!, 0));
  const c = [0, 1, 2].map((i) => [0, 1, 2].map((j) => (NEIGHBOURS + 1) * small.reduce((sum, d) => sum + d[i]! * d[j]!, 0) - total[i]! * total[j]!));
  const cofactor = (i: number, j: number) => {
    const [a, b, e, f] = [(i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3];
    return c[a]![e]! * c[b]![f]! - c[a]![f]! * c[b]![e]!;
  };
  const column = [0, 1, 2].reduce((best, k) => (cofactor(k, k) > cofactor(best, best) ? k : best), 0);
  const long = [0, 1, 2].map((k) => cofactor(k, column));
  const shorten = 2 ** Math.max(binaryDigits(Math.max(...long.map(Math.abs))) - COLUMN_BITS, 0);
  const vector = long.map((v) => Math.floor(v / shorten));
  const length = Math.floor(Math.sqrt(vector.reduce((sum, v) => sum + v * v, 0)));
  return length ? vector.map((v) => Math.floor((v * NORMAL) / length)) : [0, 0, NORMAL];
}

/** The samples of the bodies, then those of earlier points. */
export function joinedSamples(bodies: Samples | undefined, earlier: Samples | undefined): Samples | undefined {
  if (!bodies || !earlier) return bodies ?? earlier;
  const count = bodies.points.length / 3;
  const join = (a: Float64Array, b: Float64Array) => Float64Array.from([...a, ...b]);
  const neighbours = new Int32Array(bodies.neighbours.length + earlier.neighbours.length);
  neighbours.set(bodies.neighbours);
  neighbours.set(earlier.neighbours.map((n) => n + count), bodies.neighbours.length);
  return { points: join(bodies.points, earlier.points), normals: join(bodies.normals, earlier.normals), neighbours };
}
