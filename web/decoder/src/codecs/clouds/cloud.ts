/** Frames of points with colours. */

import { check } from "../../errors.js";
import { clip8 } from "../../numbers.js";
import type { StoredChunk } from "../codec.js";

/** One frame of a point cloud. */
export interface Cloud {
  /** (points, 3), metres. */
  positions: Float64Array;
  /** (points, 3): red, green, blue, 0 to 255; absent without colours. */
  colours?: Uint8Array;
}

/** Decodes the points of the chunks of one file: the frames of a chunk, one after the other. */
export interface PointDecoder {
  /** Throws Corrupt, Unsupported. */
  decode(chunk: StoredChunk): Generator<Cloud>;
}

const MOST_POINTS = 2 ** 24;
const MOST_POINTS_IN_BYTE = 131_072;

/** Throws Corrupt if `bytes` bytes cannot code these numbers of points. */
export function checkCounts(counts: number[], bytes: number): void {
  const total = counts.reduce((sum, count) => sum + count, 0);
  check(total <= MOST_POINTS && total <= MOST_POINTS_IN_BYTE * (bytes + 1), `bodycast: ${total} points in ${bytes} bytes`);
}

/** Converts colours from YCoCg-R to red, green, blue, clipped. */
export function rgbOf(colours: ArrayLike<number>): Uint8Array {
  const out = new Uint8Array(colours.length);
  for (let i = 0; i < out.length; i += 3) {
    const h = colours[i]! - Math.floor(colours[i + 2]! / 2);
    const blue = h - Math.floor(colours[i + 1]! / 2);
    out[i] = clip8(blue + colours[i + 1]!);
    out[i + 1] = clip8(h + colours[i + 2]!);
    out[i + 2] = clip8(blue);
  }
  return out;
}

/** Concatenates clouds. coloured: whether the result has colours. */
export function joined(clouds: Cloud[], coloured: boolean): Cloud {
  const size = clouds.reduce((sum, { positions }) => sum + positions.length, 0);
  const all: Cloud = { positions: new Float64Array(size) };
  if (coloured) all.colours = new Uint8Array(size);
  let at = 0;
  for (const { positions, colours } of clouds) {
    all.positions.set(positions, at);
    if (colours) all.colours?.set(colours, at);
    at += positions.length;
  }
  return all;
}

/** Converts a colour to YCoCg-R. */
export function ycocgOf(red: number, green: number, blue: number): [number, number, number] {
  const co = red - blue;
  const h = blue + (co >> 1);
  const cg = green - h;
  return [h + (cg >> 1), co, cg];
}
