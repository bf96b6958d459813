/** The samples of all bodies while decoding a chunk: their places, and the surface learned from earlier frames. */

import { clip } from "../../numbers.js";
import type { Placement } from "../bodies.js";
import { NEIGHBOURS, type Posed, type Surface, posed } from "./surface.js";

const PLACE = 2 ** 16;
const NORMAL = 2 ** 10;
const TURN = 2 ** 20;
const SMOOTHED = 6;
const COUNT_UNIT = 16;
const PRIOR_UNITS = 32;
const FARTHEST = 983;
const MOST_ASIDE = 2621;
const SLOTS = 8;
const NOT_SEEN = 2 ** 24;
const LARGEST_PLACE = 2 ** 23;
const LARGEST_POINT = 2 ** 30;
const AVERAGED = 4;
const WEIGHT_UNIT = 2 ** 40;
const SOFTENING = 2000;

/** The samples of the bodies in a frame. */
export interface Standing {
  count: number;
  /** Places (count, 3), moved along the normals by the offsets learned from earlier frames. */
  moved: Float64Array;
  normals: Float64Array;
  /** (count, 12): numbers of samples of the frame. */
  neighbours: Int32Array;
  /** Number of each sample among the samples of all bodies. */
  rows: Int32Array;
  parts: { start: number; surface: Surface; first: number; posed: Posed }[];
}

/** Points of a frame: their samples, and their places in the canonical pose. */
export interface Located {
  /** Sample of each point, among those of all bodies; −1: none. */
  rows: Int32Array;
  /** Canonical places (points, 3), 2⁻¹⁶ m. */
  places: Float64Array;
  /** Whether a body explains each point. */
  explained: Uint8Array;
}

export class Scene {
  private readonly firsts: number[] = [];
  private readonly total: number;
  /** Neighbours (samples, 6) of the samples of all bodies. */
  private readonly around: Int32Array;
  private readonly distances: Float64Array;
  private readonly counts: Float64Array;
  private readonly slotPlaces: Float64Array;
  private readonly slotColours: Int32Array;
  private readonly seen: Float64Array;
  /** Colours of the atlas (samples, 3). */
  readonly colours: Int32Array;

  /** learns: whether earlier frames move the samples of later ones. */
  constructor(
    private readonly surfaces: Surface[],
    private readonly learns: boolean,
  ) {
    let total = 0;
    for (const { count } of surfaces) {
      this.firsts.push(total);
      total += count;
    }
    this.total = total;
    this.around = new Int32Array(SMOOTHED * total);
    this.distances = new Float64Array(total);
    this.counts = new Float64Array(total);
    this.slotPlaces = new Float64Array(3 * SLOTS * total).fill(NOT_SEEN);
    this.slotColours = new Int32Array(3 * SLOTS * total);
    this.seen = new Float64Array(total).fill(1);
    this.colours = new Int32Array(3 * total);
    surfaces.forEach((surface, b) => {
      const first = this.firsts[b]!;
      this.colours.set(surface.colours, 3 * first);
      for (let i = 0; i < surface.count; i++) {
        for (let k = 0; k < SMOOTHED; k++) this.around[SMOOTHED * (first + i) + k] = first + surface.neighbours[NEIGHBOURS * i + k]!;
        this.slotPlaces.set(surface.places.subarray(3 * i, 3 * i + 3), 3 * SLOTS * (first + i));
        this.slotColours.set(surface.colours.subarray(3 * i, 3 * i + 3), 3 * SLOTS * (first + i));
      }
    });
  }

  /** Poses the samples of a frame. bodies: numbers of its bodies; transforms, shifts: one for each of them. */
  stand(bodies: number[], transforms: Placement[][], shifts: number[]): Standing {
    const count = bodies.reduce((sum, b) => sum + this.surfaces[b]!.count, 0);
    const standing: Standing = {
      count,
      moved: new Float64Array(3 * count),
      normals: new Float64Array(3 * count),
      neighbours: new Int32Array(NEIGHBOURS * count),
      rows: new Int32Array(count),
      parts: [],
    };
    let start = 0;
    bodies.forEach((b, k) => {
      const surface = this.surfaces[b]!;
      const first = this.firsts[b]!;
      const part = { start, surface, first, posed: posed(surface, transforms[k]!, shifts[k]!) };
      standing.parts.push(part);
      standing.normals.set(part.posed.normals, 3 * start);
      surface.neighbours.forEach((n, i) => (standing.neighbours[NEIGHBOURS * start + i] = start + n));
      for (let i = 0; i < surface.count; i++) {
        standing.rows[start + i] = first + i;
        const offset = this.learns ? this.offset(first + i) : 0;
        for (let c = 0; c < 3; c++) {
          const step = Math.floor((offset * part.posed.normals[3 * i + c]!) / NORMAL);
          standing.moved[3 * (start + i) + c] = part.posed.places[3 * i + c]! + step;
        }
      }
      start += surface.count;
    });
    return standing;
  }

  private offset(row: number): number {
    let [distance, count] = [2 * this.distances[row]!, 2 * this.counts[row]! + PRIOR_UNITS];
    for (let k = 0; k < SMOOTHED; k++) {
      const other = this.around[SMOOTHED * row + k]!;
      distance += this.distances[other]!;
      count += this.counts[other]!;
    }
    return Math.floor((COUNT_UNIT * distance) / count);
  }

  /** Learns offsets from the points of a frame, lattice (points, 3). samples: near each point, −1: none; step: metres. */
  learn(standing: Standing, lattice: Float64Array, samples: Int32Array, step: number): Located {
    const rows = new Int32Array(samples.length).fill(-1);
    const places = new Float64Array(3 * samples.length);
    const explained = new Uint8Array(samples.length);
    const scale = step * PLACE;
    const learned: [number, number][] = [];
    for (let i = 0; i < samples.length; i++) {
      if (samples[i]! < 0) continue;
      const { start, surface, first, posed: own } = standing.parts.filter((part) => part.start <= samples[i]!).at(-1)!;
      const s = samples[i]! - start;
      const apart = [0, 1, 2].map((c) => clip(Math.floor(lattice[3 * i + c]! * scale), -LARGEST_POINT, LARGEST_POINT) - own.places[3 * s + c]!);
      const [x, y, z] = apart as [number, number, number];
      const turn = 9 * surface.links[2 * s]!;
      for (let c = 0; c < 3; c++) {
        const turned = Math.floor((own.turns[turn + c]! * x + own.turns[turn + 3 + c]! * y + own.turns[turn + 6 + c]! * z) / TURN);
        places[3 * i + c] = clip(surface.places[3 * s + c]! + turned, -LARGEST_PLACE, LARGEST_PLACE);
      }
      rows[i] = first + s;
      const distance = Math.floor((x * own.normals[3 * s]! + y * own.normals[3 * s + 1]! + z * own.normals[3 * s + 2]!) / NORMAL);
      if (Math.abs(distance) > FARTHEST) continue;
      learned.push([first + s, distance]);
      explained[i] = Number(x * x + y * y + z * z <= MOST_ASIDE ** 2);
    }
    if (this.learns) {
      for (let row = 0; row < this.total; row++) {
        this.distances[row] = Math.floor((4 * this.distances[row]!) / 5);
        this.counts[row] = Math.floor((4 * this.counts[row]!) / 5);
      }
      for (const [row, distance] of learned) {
        this.distances[row]! += distance;
        this.counts[row]! += COUNT_UNIT;
      }
    }
    return { rows, places, explained };
  }

  /** Expected colours (points, 3) of the points with a sample. */
  expected({ rows, places }: Located): Int32Array {
    const out = new Int32Array(3 * rows.length);
    const squares = new Float64Array(AVERAGED);
    const near = new Int32Array(AVERAGED);
    for (let i = 0; i < rows.length; i++) {
      if (rows[i]! < 0) continue;
      squares.fill(Infinity);
      for (let k = -1; k < SMOOTHED; k++) {
        const row = k < 0 ? rows[i]! : this.around[SMOOTHED * rows[i]! + k]!;
        for (let slot = SLOTS * row; slot < SLOTS * (row + 1); slot++) this.consider(slot, places, i, squares, near);
      }
      const sums = [0, 0, 0];
      let total = 0;
      for (let k = 0; k < AVERAGED; k++) {
        const weight = Math.floor(WEIGHT_UNIT / (squares[k]! + SOFTENING));
        total += weight;
        for (let c = 0; c < 3; c++) sums[c]! += weight * this.slotColours[3 * near[k]! + c]!;
      }
      total = Math.max(total, 1);
      for (let c = 0; c < 3; c++) out[3 * i + c] = Math.floor((sums[c]! + Math.floor(total / 2)) / total);
    }
    return out;
  }

  private consider(slot: number, places: Float64Array, i: number, squares: Float64Array, near: Int32Array): void {
    const x = this.slotPlaces[3 * slot]! - places[3 * i]!;
    const y = this.slotPlaces[3 * slot + 1]! - places[3 * i + 1]!;
    const z = this.slotPlaces[3 * slot + 2]! - places[3 * i + 2]!;
    const square = x * x + y * y + z * z;
    if (square >= squares[AVERAGED - 1]!) return;
    let at = AVERAGED - 1;
    for (; at > 0 && squares[at - 1]! > square; at--) {
      squares[at] = squares[at - 1]!;
      near[at] = near[at - 1]!;
    }
    squares[at] = square;
    near[at] = slot;
  }

  /** Learns the colours (points, 3) of a frame. */
  see({ rows, places }: Located, colours: Int32Array): void {
    rows.forEach((row, i) => {
      if (row < 0) return;
      const slot = SLOTS * row + (this.seen[row]!++ % SLOTS);
      for (let c = 0; c < 3; c++) {
        this.slotPlaces[3 * slot + c] = places[3 * i + c]!;
        this.slotColours[3 * slot + c] = colours[3 * i + c]!;
      }
    });
  }
}
