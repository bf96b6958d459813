/** Sample adaptive offsets of coding tree units (ITU-T H.265, 7.3.8.3 and 8.7.3), for samples of 8 bits. */

import { type Cabac, FIRST } from "./cabac.js";
import type { Plane } from "./intra.js";

const NONE = 0;
const BAND = 1;
const EDGE = 2;
const MOST_OFFSET = 7;
/** Step right and down to one neighbour, for each direction of edges; the other neighbour is opposite. */
const DIRECTIONS = [[-1, 0], [0, -1], [-1, -1], [1, -1]] as const;

interface PlaneOffsets {
  type: number;
  offsets: number[];
  /** The first of four bands, or the direction of edges. */
  place: number;
}

/** Offsets of the three planes. */
export type Offsets = PlaneOffsets[];

/** Reads the offsets of unit i. before: offsets of the units before it. */
export function readOffsets(cabac: Cabac, { saoLuma, saoChroma }: { saoLuma: boolean; saoChroma: boolean }, before: Offsets[], i: number, columns: number): Offsets {
  if (i % columns > 0 && cabac.bit(FIRST.saoMerge)) return before[i - 1]!;
  if (i >= columns && cabac.bit(FIRST.saoMerge)) return before[i - columns]!;
  const planes: Offsets = [];
  for (let c = 0; c < 3; c++) {
    const own: PlaneOffsets = { type: NONE, offsets: [0, 0, 0, 0], place: 0 };
    planes.push(own);
    if (!(c ? saoChroma : saoLuma)) continue;
    if (c < 2) own.type = cabac.bit(FIRST.saoType) ? (cabac.plain() ? EDGE : BAND) : NONE;
    else own.type = planes[1]!.type;
    if (own.type === NONE) continue;
    own.offsets = own.offsets.map(() => cabac.ones(MOST_OFFSET));
    if (own.type === BAND) {
      own.offsets = own.offsets.map((offset) => (offset && cabac.plain() ? -offset : offset));
      own.place = cabac.number(5);
    } else {
      own.offsets = own.offsets.map((offset, k) => (k < 2 ? offset : -offset));
      own.place = c < 2 ? cabac.number(2) : planes[1]!.place;
    }
  }
  return planes;
}

/** Adds the offsets of all units of size × size samples. */
export function addOffsets(planes: Plane[], units: Offsets[], size: number): void {
  planes.forEach(({ samples, width, height }, c) => {
    const before = samples.slice();
    const columns = Math.ceil(width / size);
    units.forEach((unit, i) => {
      const { type, offsets, place } = unit[c]!;
      if (type === NONE) return;
      const [left, top] = [(i % columns) * size, Math.floor(i / columns) * size];
      const change = type === BAND ? bands(offsets, place) : edges(before, width, height, offsets, place);
      for (let y = top; y < Math.min(height, top + size); y++) {
        for (let x = left; x < Math.min(width, left + size); x++) {
          const value = before[y * width + x]!;
          samples[y * width + x] = Math.min(Math.max(value + change(value, x, y), 0), 255);
        }
      }
    });
  });
}

type Change = (value: number, x: number, y: number) => number;

function bands(offsets: number[], first: number): Change {
  return (value) => {
    const band = ((value >> 3) - first) & 31;
    return band < 4 ? offsets[band]! : 0;
  };
}

function edges(before: Uint8Array, width: number, height: number, offsets: number[], direction: number): Change {
  const [dx, dy] = DIRECTIONS[direction]!;
  const changes = [offsets[0]!, offsets[1]!, 0, offsets[2]!, offsets[3]!];
  return (value, x, y) => {
    if (x + dx < 0 || x + dx >= width || x - dx < 0 || x - dx >= width || y + dy < 0 || y - dy >= height) return 0;
    const at = y * width + x;
    const step = dy * width + dx;
    return changes[2 + Math.sign(value - before[at + step]!) + Math.sign(value - before[at - step]!)]!;
  };
}
