/** Corrections, which guarantee a bound on the error (docs/payloads/stages.md). */

import { Bits, Bytes } from "./bytes.js";
import { check } from "./errors.js";
import { readIntegers } from "./integers/read.js";
import { readLattice, readNetwork } from "./lattice/lattice.js";
import type { Gaps } from "./stages.js";

const RUNS = 0;
const DENSE = 1;
const ENGINE = 2;

/** Adds the corrections of a bound `maxError` (metres) to positions (frames, points, 3). */
export function addCorrections(data: Uint8Array, positions: Float64Array, frames: number, points: number, maxError: number, gaps: Gaps): void {
  if (data.length === 0) return;
  const bound = maxError - Math.min(1e-9, maxError / 1000);
  const spacing = (2 / Math.sqrt(3)) * bound;
  const form = data[0];
  if (form === DENSE) {
    add(positions, readIntegers(data.subarray(1), frames, 3 * points), spacing);
  } else if (form === ENGINE) {
    const part = new Bytes(data.subarray(1), "corrections");
    const network = readNetwork(part.blob(), points);
    const samples = readLattice(part.rest(), frames, points, gaps.apart(), network);
    add(positions, samples, (2 / Math.sqrt(5)) * (1 - 1e-9) * bound);
  } else {
    check(form === RUNS, "corrections: a reserved form");
    addRuns(data.subarray(1), positions, frames, points, spacing);
  }
}

function add(positions: Float64Array, values: Float64Array, unit: number): void {
  for (let i = 0; i < values.length; i++) positions[i]! += values[i]! * unit;
}

function addRuns(data: Uint8Array, positions: Float64Array, frames: number, points: number, spacing: number): void {
  const part = new Bytes(data, "corrections");
  const count = part.varintWithin(0, frames * points, "the number of runs");
  const waitBytes = part.varint();
  const lengthBytes = part.varint();
  const apart = new Bits(part.take(Math.ceil(count / 8)), "corrections");
  const waiting = Uint8Array.from({ length: count }, () => apart.bit());
  apart.end();
  const waits = readIntegers(part.take(waitBytes), waiting.reduce((sum, bit) => sum + bit, 0), 1);
  const lengths = readIntegers(part.take(lengthBytes), count, 1);
  const values = readIntegers(part.rest(), count, 3);
  let at = 0;
  let next = 0;
  for (let i = 0; i < count; i++) {
    const wait = waiting[i] ? waits[next++]! + 1 : 0;
    const length = lengths[i]! + 1;
    check(wait >= (waiting[i] ?? 0) && length >= 1 && at + wait + length <= frames * points, "corrections: a run is out of range");
    at += wait;
    for (let k = at; k < at + length; k++) {
      const place = 3 * ((k % frames) * points + Math.floor(k / frames));
      for (let c = 0; c < 3; c++) positions[place + c]! += values[3 * i + c]! * spacing;
    }
    at += length;
  }
}
