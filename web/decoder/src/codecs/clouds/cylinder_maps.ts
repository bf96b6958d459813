/** The model of `lien2006` as maps on the cylinders of its links, on one sheet (docs/payloads/lien2006.md, "Residual maps"). */

import { type Vector, dot, lengthOf, minus, times } from "../../geometry.js";
import { halfToEven } from "../../numbers.js";
import type { Body } from "../bodies.js";
import { type Cylinder, cylinderOf } from "./sampling.js";
import { type Item, shelve } from "./shelves.js";

const LEAST_POINTS = 6;
const SHORTEST_MAP_M = 0.02;
const SHORTEST_AXIS_M = 0.01;
const GREY = 128;
const MOST_ROUNDS = 200;
const SHEET_SHARE = 1.1;

/** The points of the model, link by link. */
export interface Template {
  body: Body;
  points: Vector[];
  /** (points, 3), null without colours. */
  colours: Uint8Array | null;
  /** The first point of each link, and the end. */
  starts: number[];
}

export interface CylinderMap extends Item {
  cylinder: Cylinder;
  low: number;
  high: number;
  /** Cell of each point of the link. */
  cells: Int32Array;
  /** (height, width): metres from the axis; and colours (height, width, 3). */
  distances: Float64Array;
  colours: Float64Array;
}

export interface Sheet {
  height: number;
  width: number;
  maps: CylinderMap[];
}

/** Lays out the maps of all links on one sheet. share: their size relative to full maps. */
export function layOut(template: Template, share: number): Sheet {
  const maps = template.body.parents.flatMap((_, link) => mapOf(template, link, share) ?? []);
  const cells = maps.reduce((sum, { height, width }) => sum + height * width, 0);
  const across = Math.max(...maps.map(({ width }) => width), Math.floor(SHEET_SHARE * Math.sqrt(cells)));
  const height = shelve(maps, across);
  return { height, width: maps.reduce((most, { left, width }) => Math.max(most, left + width), 0), maps };
}

function mapOf({ body, points, colours, starts }: Template, link: number, share: number): CylinderMap | null {
  const [start, stop] = [starts[link]!, starts[link + 1]!];
  const count = stop - start;
  if (count < LEAST_POINTS) return null;
  const origin = body.origins[link]!;
  const along = minus(body.tips[link]!, origin);
  const axis = times(1 / Math.max(lengthOf(along), SHORTEST_AXIS_M), along);
  let [low, high] = [Infinity, -Infinity];
  for (let i = start; i < stop; i++) {
    const height = dot(minus(points[i]!, origin), axis);
    [low, high] = [Math.min(low, height), Math.max(high, height)];
  }
  high = Math.max(high, low + SHORTEST_MAP_M);
  const radius = body.radii[link]!;
  const scale = Math.sqrt((count * share) / (Math.PI * radius * (high - low)));
  const height = Math.max(1, halfToEven((high - low) * scale));
  const width = Math.max(3, halfToEven(2 * Math.PI * radius * scale));
  const map: CylinderMap = {
    link, height, width, top: 0, left: 0, cylinder: cylinderOf(body, link), low, high,
    cells: new Int32Array(count), distances: new Float64Array(height * width), colours: new Float64Array(3 * height * width),
  };
  const counts = new Int32Array(height * width);
  for (let i = 0; i < count; i++) {
    const { cell, distance } = placeOf(map, points[start + i]!);
    map.cells[i] = cell;
    counts[cell]!++;
    map.distances[cell]! += distance;
    for (let c = 0; c < 3; c++) map.colours[3 * cell + c]! += colours ? colours[3 * (start + i) + c]! : GREY;
  }
  counts.forEach((own, cell) => {
    map.distances[cell]! /= Math.max(own, 1);
    for (let c = 0; c < 3; c++) map.colours[3 * cell + c]! /= Math.max(own, 1);
  });
  fillIn(map, counts.map((own) => Number(own > 0)));
  return map;
}

/** The cell of a point, and its distance from the axis. */
function placeOf({ cylinder, low, high, height, width }: CylinderMap, point: Vector): { cell: number; distance: number } {
  const offset = minus(point, cylinder.origin);
  const [u, v] = [dot(offset, cylinder.side), dot(offset, cylinder.across)];
  const row = ((dot(offset, cylinder.axis) - low) / Math.max(high - low, 1e-9)) * height;
  const turn = 2 * Math.PI;
  const angle = (Math.atan2(v, u) + turn) % turn;
  const column = Math.min(Math.floor((angle / turn) * width), width - 1);
  return { cell: Math.floor(Math.min(Math.max(row, 0), height - 1)) * width + column, distance: Math.hypot(u, v) };
}

/** Fills empty cells, round by round, with the mean of their known neighbours. Columns are cyclic. */
function fillIn({ height, width, distances, colours }: CylinderMap, known: Int32Array): void {
  for (let round = 0; round < MOST_ROUNDS && known.includes(0); round++) {
    const filled: [number, number[]][] = [];
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        if (known[y * width + x]) continue;
        const beside = [y * width + ((x + width - 1) % width), y * width + ((x + 1) % width)];
        if (y > 0) beside.push((y - 1) * width + x);
        if (y < height - 1) beside.push((y + 1) * width + x);
        const near = beside.filter((cell) => known[cell]);
        if (!near.length) continue;
        const mean = (values: Float64Array, step: number, c: number) => near.reduce((sum, cell) => sum + values[step * cell + c]!, 0) / near.length;
        filled.push([y * width + x, [mean(distances, 1, 0), mean(colours, 3, 0), mean(colours, 3, 1), mean(colours, 3, 2)]]);
      }
    }
    for (const [cell, [distance, ...colour]] of filled) {
      known[cell] = 1;
      distances[cell] = distance!;
      colours.set(colour, 3 * cell);
    }
  }
}
