/** Points of `lien2006` (docs/payloads/lien2006.md): the posed model, moved by residual maps. */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { type Vector, matrixOf, minus, plus, times, dot } from "../../geometry.js";
import { readJpeg } from "../../images/jpeg.js";
import { readPng } from "../../images/png.js";
import { readIntegers } from "../../integers/read.js";
import { clip8, halfToEven } from "../../numbers.js";
import { type Placement, readBody, readLienChunk } from "../bodies.js";
import type { StoredChunk } from "../codec.js";
import type { Cloud } from "./cloud.js";
import { type CylinderMap, type Sheet, type Template, layOut } from "./cylinder_maps.js";
import { readRawFrames } from "./raw_frames.js";
import { around } from "./sampling.js";

const POINT_STEP_M = 0.002;
const COLOUR_STEP = 4;
const MOST_POINTS = 2 ** 19;
const MOST_STEPS = 10 ** 7;
const MOST_RESIDUAL = 10_000;
const COLOURED = 1;
const DEPTH_BY_CELL = 2;
const DEPTH_STEP_M = 0.016;
const OLD_DEPTH_STEP_M = 0.008;
const MOST_ROWS = 60_000;
const MOST_PIXELS = 40_000_000;
/** Depth residual 0. */
const MIDDLE = 128;
const RESIDUAL_COLOUR_STEP = 2;
const SHORTEST_M = 1e-6;

/** Residual of a frame against the model on the sheet: depth (height, width) and colour (height, width, 3). */
interface Residual {
  depth: Uint8Array;
  colour: Uint8Array | null;
}

export class LienPoints {
  private readonly template: Template;
  private readonly byCell: boolean;
  private readonly sheet: Sheet | null;

  /** Throws Corrupt. */
  constructor(shared: Uint8Array[]) {
    check(shared.length === 1, "lien2006: a wrong number of shared blobs");
    const part = new Bytes(shared[0]!, "lien2006");
    const body = readBody(part);
    const residual = part.varintWithin(0, MOST_RESIDUAL, "the share of the maps");
    const flags = part.varintWithin(0, COLOURED + DEPTH_BY_CELL, "the flags");
    const count = part.varintWithin(1, MOST_POINTS, "the number of points");
    const starts = [0];
    for (let l = 0; l < body.parents.length; l++) starts.push(starts[l]! + part.varint());
    check(starts.at(-1) === count, "lien2006: a wrong number of points");
    const isColoured = (flags & COLOURED) > 0;
    this.template = { body, ...readPoints(part.rest(), count, isColoured), starts };
    this.byCell = (flags & DEPTH_BY_CELL) > 0;
    this.sheet = residual ? layOut(this.template, residual / MOST_RESIDUAL) : null;
  }

  /** The frames of a chunk, one after the other. Throws Corrupt, and Unsupported for images of other encoders. */
  *decode(chunk: StoredChunk): Generator<Cloud> {
    const { placed, rawFrames, images } = readLienChunk(chunk, this.template.body);
    const shown = placed.filter((own) => own !== null).length;
    const raw = readRawFrames(rawFrames, placed.length - shown, this.template.colours !== null);
    check(images.length === 0 || this.sheet !== null, "lien2006: residual maps without a sheet");
    const residuals = images.length ? this.residuals(images, shown, this.sheet!) : null;
    let [nextRaw, next] = [0, 0];
    for (const own of placed) {
      if (own === null) yield raw[nextRaw++]!;
      else if (residuals) yield this.moved(own, residuals[next++]!, this.sheet!);
      else yield this.posed(own);
    }
  }

  /** The posed points of the model. */
  private posed(placed: Placement[]): Cloud {
    const { points, colours, starts } = this.template;
    const pose = poseOf(placed);
    const positions = new Float64Array(3 * points.length);
    placed.forEach((_, link) => {
      for (let i = starts[link]!; i < starts[link + 1]!; i++) pose(link, points[i]!, positions, 3 * i);
    });
    return { positions, ...(colours && { colours }) };
  }

  private residuals(images: Uint8Array[], frames: number, { height, width }: Sheet): Residual[] {
    const size = height * width;
    const most = Math.max(1, Math.min(Math.floor(MOST_ROWS / height), Math.floor(MOST_PIXELS / size)));
    const groups = Math.ceil(frames / most);
    const isColoured = this.template.colours !== null;
    check(images.length === groups * (isColoured ? 2 : 1), "lien2006: a wrong number of images");
    const out: Residual[] = [];
    for (let group = 0; group < groups; group++) {
      const count = Math.min(most, frames - group * most);
      const depth = readPng(images[group]!, size * count);
      check(depth.isPalette === this.byCell, "lien2006: an image of a wrong kind");
      check(this.byCell ? depth.height === height && depth.width === width * count : depth.height === height * count && depth.width === width, "lien2006: an image has a wrong size");
      const colour = isColoured ? readJpeg(images[groups + group]!, size * count) : null;
      check(!colour || (colour.height === height * count && colour.width === width), "lien2006: an image has a wrong size");
      for (let k = 0; k < count; k++) {
        const own: Residual = { depth: new Uint8Array(size), colour: colour && new Uint8Array(3 * size) };
        for (let y = 0; y < height; y++) {
          const row = (y * count + k) * width;
          if (this.byCell) for (let x = 0; x < width; x++) own.depth[y * width + x] = depth.pixels[(y * width + x) * count + k]!;
          else own.depth.set(depth.pixels.subarray(row, row + width), y * width);
          own.colour?.set(colour!.pixels.subarray(3 * row, 3 * (row + width)), 3 * y * width);
        }
        out.push(own);
      }
    }
    return out;
  }

  /** The points of a frame: in each occupied cell the model's points, moved by the residual, or one new point. */
  private moved(placed: Placement[], residual: Residual, sheet: Sheet): Cloud {
    const isColoured = this.template.colours !== null;
    const positions: number[] = [];
    const colours: number[] = [];
    const pose = poseOf(placed);
    const place = new Float64Array(3);
    const add = (link: number, point: Vector, base: ArrayLike<number>, at: number, cell: number) => {
      pose(link, point, place, 0);
      positions.push(place[0]!, place[1]!, place[2]!);
      if (!isColoured) return;
      for (let c = 0; c < 3; c++) colours.push(clip8(halfToEven(base[at + c]! + RESIDUAL_COLOUR_STEP * (residual.colour![3 * cell + c]! - MIDDLE))));
    };
    const step = this.byCell ? DEPTH_STEP_M : OLD_DEPTH_STEP_M;
    for (const map of sheet.maps) {
      const onSheet = (cell: number) => (map.top + Math.floor(cell / map.width)) * sheet.width + map.left + (cell % map.width);
      const isFilled = new Uint8Array(map.height * map.width);
      const first = this.template.starts[map.link]!;
      map.cells.forEach((cell, i) => {
        isFilled[cell] = 1;
        const at = onSheet(cell);
        const depth = residual.depth[at]!;
        if (depth === 0) return;
        const point = this.template.points[first + i]!;
        add(map.link, movedOut(map, point, (depth - MIDDLE) * step), this.template.colours ?? [], 3 * (first + i), at);
      });
      for (let cell = 0; cell < isFilled.length; cell++) {
        const at = onSheet(cell);
        const depth = residual.depth[at]!;
        if (depth === 0 || isFilled[cell]) continue;
        add(map.link, centreOf(map, cell, map.distances[cell]! + (depth - MIDDLE) * step), map.colours, 3 * cell, at);
      }
    }
    return { positions: Float64Array.from(positions), ...(isColoured && { colours: Uint8Array.from(colours) }) };
  }
}

function readPoints(data: Uint8Array, count: number, isColoured: boolean): Pick<Template, "points" | "colours"> {
  const columns = isColoured ? 6 : 3;
  const differences = readIntegers(data, count, columns);
  const sums = new Array<number>(columns).fill(0);
  const clip = (value: number) => Math.min(Math.max(value, -MOST_STEPS), MOST_STEPS);
  const colours = isColoured ? new Uint8Array(3 * count) : null;
  const points = Array.from({ length: count }, (_, i): Vector => {
    for (let c = 0; c < columns; c++) sums[c]! += clip(differences[i * columns + c]!);
    for (let c = 3; c < columns; c++) colours![3 * i + c - 3] = clip8(COLOUR_STEP * sums[c]!);
    return [clip(sums[0]!) * POINT_STEP_M, clip(sums[1]!) * POINT_STEP_M, clip(sums[2]!) * POINT_STEP_M];
  });
  return { points, colours };
}

/** A function that writes the posed position of a canonical point of a link. */
function poseOf(placed: Placement[]): (link: number, point: Vector, out: Float64Array, at: number) => void {
  const turns = placed.map(({ turn }) => matrixOf(turn));
  return (link, [x, y, z], out, at) => {
    const a = turns[link]!;
    const { shift } = placed[link]!;
    for (let c = 0; c < 3; c++) out[at + c] = a[3 * c]! * x + a[3 * c + 1]! * y + a[3 * c + 2]! * z + shift[c]!;
  };
}

/** Moves a point away from the axis of its link by `distance`. */
function movedOut({ cylinder: { origin, axis } }: CylinderMap, point: Vector, distance: number): Vector {
  const offset = minus(point, origin);
  const out = minus(offset, times(dot(offset, axis), axis));
  return plus(point, times(distance / Math.max(Math.sqrt(dot(out, out)), SHORTEST_M), out));
}

/** The centre of a cell at a distance from the axis. */
function centreOf({ cylinder: { origin, axis, side, across }, low, high, height, width }: CylinderMap, cell: number, distance: number): Vector {
  const along = low + ((Math.floor(cell / width) + 0.5) / height) * (high - low);
  const angle = (((cell % width) + 0.5) / width) * 2 * Math.PI;
  return plus(plus(origin, times(along, axis)), times(distance, around(Math.cos(angle), Math.sin(angle), side, across)));
}
