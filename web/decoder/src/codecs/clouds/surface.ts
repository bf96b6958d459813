/** The surface of a body in integers, in the canonical pose and in the poses of frames (docs/payloads/bodycast-points.md, "Surface"). */

import { matrixOf } from "../../geometry.js";
import { clip8 } from "../../numbers.js";
import type { Body, Placement } from "../bodies.js";
import { type Atlas, keyPlanes } from "./atlas.js";
import { ycocgOf } from "./cloud.js";
import { type Sample, sampleSurface } from "./sampling.js";
import { largest } from "./skin.js";

export const NEIGHBOURS = 12;
const SAMPLES = 8000;
const PLACE = 2 ** 16;
const NORMAL = 2 ** 10;
const TURN = 2 ** 20;
const FULL_SHARE_BITS = 12;
const SMOOTHING_ROUNDS = 3;
const FARTHEST_M = 2 ** 14;
const SHIFTS = 64;

/** Samples of one body, numbered from 0. */
export interface Surface {
  count: number;
  /** Places (count, 3) in 2⁻¹⁶ m, and normals (count, 3) of length 2¹⁰. */
  places: Float64Array;
  normals: Float64Array;
  /** Numbers of neighbours (count, 12). */
  neighbours: Int32Array;
  /** Two links of each sample (count, 2), and the share of the first, in 2⁻¹². */
  links: Uint8Array;
  shares: Int32Array;
  /** Y, Co, Cg of the atlas (count, 3). */
  colours: Int32Array;
}

/** The samples of a body, not rounded. */
export interface Texture {
  samples: Sample[];
  colours: Int32Array;
  links: number;
}

/** Decodes the key picture. */
export function textureOf(body: Body, atlas: Atlas): Texture {
  const planes = keyPlanes(atlas);
  const samples = sampleSurface(body, atlas, planes[0], SAMPLES);
  const colours = new Int32Array(3 * samples.length);
  samples.forEach(({ cells, weights }, i) => {
    const nearest = cells[weights.indexOf(Math.max(...weights))]!;
    colours.set(colourOf(planes[0][nearest]!, planes[1][nearest]! - 128, planes[2][nearest]! - 128), 3 * i);
  });
  return { samples, colours, links: body.parents.length };
}

function colourOf(y: number, cb: number, cr: number): [number, number, number] {
  const red = y + ((103_206 * cr) >> 16);
  const blue = y + ((121_609 * cb) >> 16);
  const green = y - ((30_678 * cr + 12_277 * cb) >> 16);
  return ycocgOf(clip8(red), clip8(green), clip8(blue));
}

/** The surface, rounded with this shift. */
export function surfaceOf({ samples, colours, links }: Texture, shift: number): Surface {
  const count = samples.length;
  const rounded = (value: number) => Math.floor(value + shift / SHIFTS);
  const places = Float64Array.from(samples.flatMap(({ place }) => place.map((v) => rounded(v * PLACE))));
  const normals = Float64Array.from(samples.flatMap(({ normal }) => normal.map((v) => rounded(v * NORMAL))));
  const neighbours = nearestSamples(places, normals);
  return { count, places, normals, neighbours, colours, ...blendedLinks(samples, neighbours, links) };
}

/** Nearest samples of each sample: searches in both directions along x until no sample can be nearer. */
function nearestSamples(places: Float64Array, normals: Float64Array): Int32Array {
  const count = places.length / 3;
  const out = new Int32Array(NEIGHBOURS * count);
  const order = Int32Array.from({ length: count }, (_, i) => i).sort((i, j) => places[3 * i]! - places[3 * j]!);
  const near = new Int32Array(NEIGHBOURS);
  const squares = new Float64Array(NEIGHBOURS);
  for (let position = 0; position < count; position++) {
    const i = order[position]!;
    squares.fill(Infinity);
    near.fill(-1);
    for (const way of [-1, 1]) {
      for (let other = position + way; other >= 0 && other < count; other += way) {
        const j = order[other]!;
        const dx = places[3 * j]! - places[3 * i]!;
        if (dx * dx > squares[NEIGHBOURS - 1]!) break;
        const dy = places[3 * j + 1]! - places[3 * i + 1]!;
        const dz = places[3 * j + 2]! - places[3 * i + 2]!;
        insert(near, squares, j, dx * dx + dy * dy + dz * dz);
      }
    }
    let at = NEIGHBOURS * i;
    for (const j of near) {
      if (j < 0) break;
      const product = normals[3 * i]! * normals[3 * j]! + normals[3 * i + 1]! * normals[3 * j + 1]! + normals[3 * i + 2]! * normals[3 * j + 2]!;
      if (product > 0) out[at++] = j;
    }
    out.fill(i, at, NEIGHBOURS * (i + 1));
  }
  return out;
}

/** Inserts sample j into the list of nearest samples, sorted by squared distance, then by number. */
function insert(near: Int32Array, squares: Float64Array, j: number, square: number): void {
  let at = NEIGHBOURS - 1;
  if (square > squares[at]! || (square === squares[at]! && j > near[at]!)) return;
  for (; at > 0 && (squares[at - 1]! > square || (squares[at - 1] === square && near[at - 1]! > j)); at--) {
    squares[at] = squares[at - 1]!;
    near[at] = near[at - 1]!;
  }
  squares[at] = square;
  near[at] = j;
}

function blendedLinks(samples: Sample[], neighbours: Int32Array, links: number): Pick<Surface, "links" | "shares"> {
  const count = samples.length;
  let shares = new Int32Array(count * links);
  samples.forEach(({ link }, i) => (shares[i * links + link] = 1 << FULL_SHARE_BITS));
  for (let round = 0; round < SMOOTHING_ROUNDS; round++) {
    const next = new Int32Array(count * links);
    for (let i = 0; i < count; i++) {
      for (let l = 0; l < links; l++) {
        let sum = 4 * shares[i * links + l]!;
        for (let k = 0; k < NEIGHBOURS; k++) sum += shares[neighbours[NEIGHBOURS * i + k]! * links + l]!;
        next[i * links + l] = sum >> 4;
      }
    }
    shares = next;
  }
  const pairs = new Uint8Array(2 * count);
  const firsts = new Int32Array(count);
  for (let i = 0; i < count; i++) {
    const own = shares.subarray(i * links, (i + 1) * links);
    const first = largest(own, -1);
    const second = largest(own, first);
    const other = second < 0 ? 0 : own[second]!;
    pairs[2 * i] = first;
    pairs[2 * i + 1] = other > 0 ? second : first;
    firsts[i] = links === 1 ? 1 << (FULL_SHARE_BITS - 1) : Math.floor((own[first]! << FULL_SHARE_BITS) / Math.max(own[first]! + other, 1));
  }
  return { links: pairs, shares: firsts };
}

/** Posed samples of a body in a frame: places and normals, each (count, 3). */
export interface Posed {
  places: Float64Array;
  normals: Float64Array;
  /** Rotation A of each link (links, 9), in 2⁻²⁰. */
  turns: Float64Array;
}

/** Poses the samples with the transforms of a frame, rounded with this shift. */
export function posed(surface: Surface, transforms: Placement[], shift: number): Posed {
  const rounded = (value: number) => Math.floor(value + shift / SHIFTS);
  const turns = Float64Array.from(transforms.flatMap(({ turn }) => matrixOf(turn).map((v) => rounded(v * TURN))));
  const moves = Float64Array.from(transforms.flatMap(({ shift: b }) => b.map((v) => rounded(Math.min(Math.max(v, -FARTHEST_M), FARTHEST_M) * PLACE))));
  const { count, links, shares } = surface;
  const [places, normals] = [new Float64Array(3 * count), new Float64Array(3 * count)];
  const turned = (v: Float64Array, i: number, link: number, row: number) => {
    const at = 9 * link + 3 * row;
    return Math.floor((turns[at]! * v[3 * i]! + turns[at + 1]! * v[3 * i + 1]! + turns[at + 2]! * v[3 * i + 2]!) / TURN);
  };
  for (let i = 0; i < count; i++) {
    const [first, second] = [links[2 * i]!, links[2 * i + 1]!];
    for (let c = 0; c < 3; c++) {
      const u = turned(surface.places, i, first, c) + moves[3 * first + c]!;
      const v = turned(surface.places, i, second, c) + moves[3 * second + c]!;
      places[3 * i + c] = v + Math.floor(((u - v) * shares[i]!) / 2 ** FULL_SHARE_BITS);
      normals[3 * i + c] = turned(surface.normals, i, first, c);
    }
  }
  return { places, normals, turns };
}
