/**
 * Points evenly spread over the surface of the key picture (docs/payloads/bodycast.md, "Surface of a frame").
 *
 * The choice of subcells follows the operations of the page one by one, so that all machines agree.
 */

import { check } from "../../errors.js";
import { type Vector, cross, lengthOf, minus, normalised, plus, times } from "../../geometry.js";
import { halfToEven } from "../../numbers.js";
import type { Body } from "../bodies.js";
import type { Atlas, Tile } from "./atlas.js";

const SUBCELLS = 3;
const STRIP_SPACINGS = 4;
const GOLDEN = 40503;
const AREA_UNIT_M2 = 1e-12;
const SHORTEST_ARC_M = 1e-6;

/** A point of the surface in the canonical pose. */
export interface Sample {
  link: number;
  place: Vector;
  normal: Vector;
  /** Foot of the point on the link's axis, direction from foot to point, and distance at level 255 (`reach`), metres. */
  foot: Vector;
  out: Vector;
  reach: number;
  /** The four atlas cells around the point, and their bilinear weights. */
  cells: number[];
  weights: number[];
}

interface Taps {
  cells: number[];
  weights: number[];
}

/** Cells of a tile around a position, and their bilinear weights. */
function taps({ height, width }: Tile, y: number, x: number): Taps {
  const row = Math.min(Math.max(y - 0.5, 0), height - 1);
  const column = x - 0.5 + width;
  const [top, left] = [Math.floor(row), Math.floor(column)];
  const [down, right] = [row - top, column - left];
  const bottom = Math.min(top + 1, height - 1);
  const cells = [top, top, bottom, bottom].map((r, i) => r * width + ((left + (i & 1)) % width));
  return { cells, weights: [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right] };
}

export interface Cylinder {
  origin: Vector;
  axis: Vector;
  side: Vector;
  across: Vector;
}

export function cylinderOf({ origins, tips }: Pick<Body, "origins" | "tips">, link: number): Cylinder {
  const origin = origins[link]!;
  const along = minus(tips[link]!, origin);
  const axis = times(1 / Math.max(lengthOf(along), 1e-9), along);
  const side = normalised(cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  return { origin, axis, side, across: cross(axis, side) };
}

export function around(cosine: number, sine: number, a: Vector, b: Vector): Vector {
  return plus(times(cosine, a), times(sine, b));
}

/** The subcells of a tile. */
interface Fine {
  rows: number;
  columns: number;
  /** Area of each subcell (rows, columns), in 10⁻¹² m². */
  areas: Float64Array;
  total: number;
  normal(row: number, column: number): Vector;
}

/** `count` points on the surface; luma: the first plane of the key picture. Throws Corrupt without a surface. */
export function sampleSurface(body: Body, atlas: Atlas, luma: Uint8Array, count: number): Sample[] {
  const fine = atlas.tiles.map((tile) => subcells(body, atlas, tile, luma));
  const total = fine.reduce((sum, tile) => sum + tile.total, 0);
  check(total > 0 && total <= Number.MAX_SAFE_INTEGER, "bodycast: the atlas shows no surface");
  const spacing = Math.sqrt((total * AREA_UNIT_M2) / count);
  const half = Math.floor((total % (2 * count)) / 2);
  const step = (total - (total % (2 * count))) / (2 * count);
  const samples: Sample[] = [];
  let start = 0;
  let next = 0;
  atlas.tiles.forEach((tile, i) => {
    const targets: number[] = [];
    const first = next;
    for (; next < count; next++) {
      const target = (2 * next + 1) * step + half;
      if (target >= start + fine[i]!.total) break;
      targets.push(target - start);
    }
    if (targets.length) samples.push(...samplesOfTile(body, atlas, tile, fine[i]!, luma, spacing, targets, first));
    start += fine[i]!.total;
  });
  check(samples.length === count, "bodycast: the surface has a wrong number of points");
  return samples;
}

function subcells(body: Body, atlas: Atlas, tile: Tile, luma: Uint8Array): Fine {
  const [rows, columns] = [SUBCELLS * tile.height, SUBCELLS * tile.width];
  const distances = new Float64Array(rows * columns);
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++) {
      const { cells, weights } = taps(tile, (r + 0.5) / SUBCELLS, (c + 0.5) / SUBCELLS);
      let sum = weights[0]! * displacement(atlas, tile, luma, cells[0]!);
      for (let k = 1; k < 4; k++) sum = sum + weights[k]! * displacement(atlas, tile, luma, cells[k]!);
      distances[r * columns + c] = sum * (tile.reach / 255_000);
    }
  }
  const rowLength = (tile.high - tile.low) / (1000 * rows);
  const angle = (2 * Math.PI) / columns;
  const at = (r: number, c: number) => distances[r * columns + ((c + columns) % columns)]!;
  const along = (r: number, c: number) => (r > 0 && r < rows - 1 ? (at(r + 1, c) - at(r - 1, c)) / 2 : 0);
  const aside = (r: number, c: number) => (at(r, c + 1) - at(r, c - 1)) / 2;
  const areas = new Float64Array(rows * columns);
  let total = 0;
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++) {
      if (!atlas.mask[(tile.top + Math.floor(r / SUBCELLS)) * atlas.width + tile.left + Math.floor(c / SUBCELLS)]) continue;
      const [arc, e, w] = [at(r, c) * angle, along(r, c), aside(r, c)];
      const area = Math.sqrt(arc * arc * (rowLength * rowLength + e * e) + rowLength * rowLength * w * w);
      areas[r * columns + c] = Math.floor(Math.min(area, 1) / AREA_UNIT_M2);
      total += areas[r * columns + c]!;
    }
  }
  const { axis, side, across } = cylinderOf(body, tile.link);
  const normal = (r: number, c: number): Vector => {
    const [cosine, sine] = [Math.cos((c + 0.5) * angle), Math.sin((c + 0.5) * angle)];
    const out = around(cosine, sine, side, across);
    const tangent = around(cosine, -sine, across, side);
    const leaning = minus(out, times(along(r, c) / rowLength, axis));
    return normalised(minus(leaning, times(aside(r, c) / Math.max(at(r, c) * angle, SHORTEST_ARC_M), tangent)));
  };
  return { rows, columns, areas, total, normal };
}

/** Displacement level of a tile's cell, from the lower half of the picture. */
function displacement(atlas: Atlas, tile: Tile, luma: Uint8Array, cell: number): number {
  return luma[(atlas.height + tile.top + Math.floor(cell / tile.width)) * atlas.width + tile.left + (cell % tile.width)]!;
}

/** Samples of a tile. targets: their cumulative areas along the tile's path; first: number of the first sample. */
function samplesOfTile(body: Body, atlas: Atlas, tile: Tile, fine: Fine, luma: Uint8Array, spacing: number, targets: number[], first: number): Sample[] {
  const { rows, columns, areas } = fine;
  const rowLength = (tile.high - tile.low) / (1000 * rows);
  const high = Math.min(Math.max(halfToEven((STRIP_SPACINGS * spacing) / rowLength), 1), rows);
  const { origin, axis, side, across } = cylinderOf(body, tile.link);
  const samples: Sample[] = [];
  let place = 0;
  let next = 0;
  for (let top = 0; top < rows && next < targets.length; top += high) {
    const bottom = Math.min(rows, top + high);
    for (let column = 0; column < columns && next < targets.length; column++) {
      let area = 0;
      for (let r = top; r < bottom; r++) area += areas[r * columns + column]!;
      for (; next < targets.length && targets[next]! < place + area; next++) {
        const x = (column + (targets[next]! - place) / area) / SUBCELLS;
        const share = ((first + next) * GOLDEN) % 65536;
        const wanted = share * Math.floor(area / 65536) + Math.floor((share * (area % 65536)) / 65536);
        let [row, before] = [top, 0];
        while (before + areas[row * columns + column]! <= wanted) before += areas[row++ * columns + column]!;
        const y = (row + (wanted - before) / areas[row * columns + column]!) / SUBCELLS;
        const { cells, weights } = taps(tile, y, x);
        const level = cells.reduce((sum, cell, k) => sum + weights[k]! * displacement(atlas, tile, luma, cell), 0);
        const angle = (x / tile.width) * 2 * Math.PI;
        const foot = plus(origin, times(tile.low / 1000 + (y / tile.height) * (tile.high / 1000 - tile.low / 1000), axis));
        const out = around(Math.cos(angle), Math.sin(angle), side, across);
        samples.push({
          link: tile.link,
          place: plus(foot, times(level * (tile.reach / 1000 / 255), out)),
          normal: fine.normal(row, column),
          foot,
          out,
          reach: tile.reach / 1000,
          cells: cells.map((cell) => (tile.top + Math.floor(cell / tile.width)) * atlas.width + tile.left + (cell % tile.width)),
          weights,
        });
      }
      place += area;
    }
  }
  return samples;
}
