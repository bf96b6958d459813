/** The atlas of a body: tiles, the mask of surface cells, and the key picture (docs/payloads/bodycast.md). */

import type { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegers } from "../../integers/read.js";
import { VideoDecoder } from "../../video/video.js";
import { AdaptiveBits, Counts } from "./adaptive.js";
import { type Item, shelve } from "./shelves.js";

const MOST_TILE_SIDE = 1024;
const MOST_SIDE = 4096;
const MOST_END_MM = 10_000;
const MOST_REACH_MM = 5000;
const ALIGNMENT = 8;
const LEAST_HEIGHT = 32;
const LEAST_WIDTH = 64;
const MASK_CONTEXTS = 512;
/** Cells in the context of a cell: rows up, columns to the right. */
const ABOVE = [[1, -2], [1, -1], [1, 0], [1, 1], [2, 0], [1, 2]] as const;
const MOST_POINTS = 2 ** 20;
const MOST_INTERVAL = 2 ** 16 - 1;

export interface Tile extends Item {
  /** Ends along the axis (`low`, `high`) and largest distance from it (`reach`), millimetres. */
  low: number;
  high: number;
  reach: number;
}

export interface Atlas {
  height: number;
  width: number;
  /** Sorted by link. */
  tiles: Tile[];
  /** Points of the body in a frame. */
  points: number;
  /** Number of frames that use one picture of the changing surface. */
  interval: number;
  /** (height, width): whether a cell is surface. */
  mask: Uint8Array;
  keyPicture: Uint8Array;
}

/** Reads the rest of a shared blob, after the levers. */
export function readAtlas(part: Bytes, links: number): Atlas {
  const count = part.varintWithin(0, links, "the number of tiles");
  const table = readIntegers(part.take(part.varint()), count, 6);
  const tiles = Array.from({ length: count }, (_, i): Tile => {
    const [link, height, width, low, high, reach] = table.subarray(6 * i, 6 * i + 6) as unknown as [number, number, number, number, number, number];
    const isSized = height >= 1 && height <= MOST_TILE_SIDE && width >= 1 && width <= MOST_TILE_SIDE;
    check(link >= 0 && link < links && isSized && reach >= 1 && reach <= MOST_REACH_MM, "bodycast: a tile is out of range");
    check(-MOST_END_MM < low && low < high && high < MOST_END_MM, "bodycast: the ends of a tile are out of range");
    return { link, height, width, low, high, reach, top: 0, left: 0 };
  });
  check(new Set(tiles.map(({ link }) => link)).size === count, "bodycast: a link has two tiles");
  const { height, width } = arrange(tiles);
  check(width <= MOST_SIDE && 2 * height <= MOST_SIDE, "bodycast: the atlas is too large");
  part.varintWithin(0, 1, "whether there are colours");
  const points = part.varintWithin(1, MOST_POINTS, "the points of a frame");
  const interval = part.varintWithin(1, MOST_INTERVAL, "the interval of pictures");
  const [maskBytes, keyBytes] = [part.varint(), part.varint()];
  const mask = readMask(part.take(maskBytes), height, width);
  const inside = new Uint8Array(height * width);
  for (const { top, left, height: h, width: w } of tiles) for (let y = top; y < top + h; y++) inside.fill(1, y * width + left, y * width + left + w);
  const keyPicture = part.take(keyBytes);
  part.end();
  return { height, width, tiles, points, interval, mask: mask.map((bit, i) => bit & inside[i]!), keyPicture };
}

/** Places tiles on shelves, the tallest first; then sorts them by link. */
function arrange(tiles: Tile[]): { height: number; width: number } {
  const aligned = (value: number) => Math.ceil(value / ALIGNMENT) * ALIGNMENT;
  const cells = tiles.reduce((sum, { height, width }) => sum + height * width, 0);
  const widest = tiles.reduce((most, { width }) => Math.max(most, width), tiles.length ? 0 : 8);
  const across = aligned(Math.max(widest, Math.floor(1.05 * Math.sqrt(cells))));
  const height = shelve(tiles, across);
  tiles.sort((a, b) => a.link - b.link);
  return { height: Math.max(LEAST_HEIGHT, aligned(height)), width: Math.max(LEAST_WIDTH, across) };
}

function readMask(data: Uint8Array, height: number, width: number): Uint8Array {
  const bits = new AdaptiveBits(data);
  const counts = new Counts(MASK_CONTEXTS);
  const mask = new Uint8Array(height * width);
  const at = (y: number, x: number) => (y >= 0 && x >= 0 && x < width ? mask[y * width + x]! : 0);
  for (let y = 0; y < height; y++) {
    for (const odd of [0, 1]) {
      const contexts = new Int32Array((width - odd + 1) >> 1);
      for (let i = 0; i < contexts.length; i++) {
        const x = odd + 2 * i;
        let context = odd;
        for (const [up, right] of ABOVE) context = 2 * context + at(y - up, x + right);
        contexts[i] = 4 * context + (odd ? 2 * at(y, x - 1) + at(y, x + 1) : 0);
      }
      bits.group(counts, contexts).forEach((bit, i) => (mask[y * width + odd + 2 * i] = bit));
    }
  }
  bits.raw(0);
  return mask;
}

export type Planes = [Uint8Array, Uint8Array, Uint8Array];

/** The three planes (2 · height, width) of the next picture of a video. Throws Corrupt, Unsupported. */
export function nextPlanes({ height, width }: Atlas, video: VideoDecoder, packet: Uint8Array): Planes {
  const picture = video.decode(packet);
  check(picture.width === width && picture.height === 2 * height, "bodycast: a picture has a wrong size");
  return picture.planes;
}

/** The three planes of the key picture. */
export function keyPlanes(atlas: Atlas): Planes {
  return nextPlanes(atlas, new VideoDecoder(), atlas.keyPicture);
}
