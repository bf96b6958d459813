/** Exact points in the octree of a lattice (docs/payloads/bodycast-points.md, "Exact points"). */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { type Cloud, checkCounts, rgbOf } from "./cloud.js";
import { Colours, readValues } from "./colours.js";
import { FLOATS, MOST_CELL, positionsOf, readGrid } from "./exact.js";
import { type Bodies, Lattice } from "./lattice.js";
import { MixedBits } from "./mixed.js";

export const EXACT = 7;

/** The points of the frames of a chunk. Throws Corrupt. */
export function* readExactLattice(data: Uint8Array, frames: number, coloured: boolean, bodies: Bodies): Generator<Cloud> {
  const part = new Bytes(data, "bodycast: exact points");
  part.varint();
  const grid = readGrid(part);
  const corner = [0, 1, 2].map(() => part.foldedWithin(-MOST_CELL, MOST_CELL, "the corner"));
  const [placeBytes, repeatBytes, floatBytes] = [part.varint(), part.varint(), part.varint()];
  check(grid.kind === FLOATS || floatBytes === 0, "bodycast: exact points on a grid have bits of floats");
  const layer = new Lattice(part.take(placeBytes), frames, false, bodies);
  const repeatBits = new MixedBits(part.take(repeatBytes));
  const floatBits = part.take(floatBytes);
  const colourBits = new MixedBits(part.rest());
  const totals: number[] = [];
  const repeats = (count: number): Int32Array => {
    const more = readValues([...Array(count).keys()], (_, kind) => repeatBits.bit(kind, kind, kind, kind, kind, kind));
    check(more.every((extra) => extra >= 0), "bodycast: a cell of exact points holds less than one point");
    totals.push(more.reduce((sum, extra) => sum + extra + 1, 0));
    checkCounts(totals, data.length);
    return more;
  };
  const found = [...layer.frames(coloured ? new Colours(colourBits, [1, 1, 1]) : undefined, repeats)];
  repeatBits.end();
  new MixedBits(layer.rest).end(); // places have no colours
  const cells = new Float64Array(found.reduce((sum, frame) => sum + frame.cells.length, 0));
  let at = 0;
  for (const frame of found) frame.cells.forEach((value, i) => (cells[at++] = corner[i % 3]! + grid.spacing * (value >> 1)));
  const positions = positionsOf(grid, cells, floatBits);
  at = 0;
  for (const frame of found) {
    const cloud: Cloud = { positions: positions.slice(at, at + frame.cells.length) };
    at += frame.cells.length;
    if (coloured) cloud.colours = frame.colours ? rgbOf(frame.colours) : new Uint8Array(0);
    yield cloud;
  }
  colourBits.end();
}
