/** Coefficients of a chunk (docs/payloads/tempo.md, "Coefficients"). */

import { type Bits, type Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { BAND_LOGS, SPREADS, exp2, log2, log2OfInteger } from "./logarithms.js";
import type { Prior } from "./prior.js";
import { Lanes, type Table } from "./rans.js";

/** Statistics that choose the tables of coefficients: log₂ of magnitudes in metres, 1/32 octave. */
export interface Statistics {
  rows: number;
  /** (rows, 18) */
  spreads: Int32Array;
  /** (rows) */
  means: Int32Array;
  prior: Prior;
}

export interface Coefficients {
  /** Frequencies with coded coefficients. */
  frequencies: number;
  /** (frequencies, rows), integers. */
  values: Float64Array;
  /** log₂ of the quantisation step in metres, 1/32 octave. */
  step: number;
  /** Five lists of `corrections` numbers each. */
  corrections: number;
  lists: Float64Array;
}

const LANES = [1, 2, 4, 8, 12, 16, 24, 32] as const;
const RAW_BITS = Uint8Array.from({ length: 21 }, (_, symbol) => (symbol <= 10 ? 0 : symbol < 20 ? symbol - 10 : 48));
const SMALLEST = Uint16Array.from({ length: 21 }, (_, symbol) => (symbol <= 10 ? symbol : 11 + 2 ** (symbol - 10) - 2));
const CLASSES = 56;
const LISTS = 5;
const SIGNED_LISTS = 3;
const LIST_TABLES = 112;
const CAP = 300;
const EXPECTED_CAP = 4800;

/** log₂ of the heading's quantisation step in radians, 1/32 octave. */
export function headingStep(frames: number): number {
  return -213 + Math.floor(log2(frames) / 2);
}

/** Reads the rest of a payload. millihertz: the frame rate; headingHasOwnStep: row 0 does not use `step`. */
export function readCoefficients(
  part: Bytes,
  frames: number,
  points: number,
  millihertz: number,
  statistics: Statistics,
  headingHasOwnStep = true,
): Coefficients {
  const first = part.varint();
  const lanes = LANES[first & 7]!;
  const folded = Math.floor(first / 16);
  const threshold = folded % 2 ? -(folded + 1) / 2 : folded / 2;
  check(Math.abs(threshold) <= 4096, "tempo: a threshold that is out of range");
  const step = part.varintWithin(0, 4096, "the step") - 2048;
  const hasLists = (first & 8) !== 0;
  const corrections = hasLists ? part.varintWithin(0, frames * points, "the number of corrections") : 0;
  const classes = Array.from({ length: hasLists ? LISTS : 0 }, () => part.varintWithin(0, CLASSES - 1, "a class"));
  const zone = new Zone(statistics, frames, millihertz, step, headingHasOwnStep ? headingStep(frames) : step, 16 * threshold);
  const { frequencies, rows } = zone;
  const values = new Float64Array(frequencies * rows);
  const lists = new Float64Array(LISTS * corrections);
  if (frequencies === 0 && corrections === 0) {
    part.end();
    return { frequencies, values, step, corrections, lists };
  }
  const stream = new Lanes(part, lanes);
  const symbols = readSymbols(stream, zone, statistics.prior);
  const listed = new Uint8Array(LISTS * corrections);
  for (let i = 0, lane = 0; i < listed.length; i++) {
    listed[i] = stream.symbol(lane, statistics.prior.table(LIST_TABLES + classes[Math.floor(i / corrections)]!));
    lane = lane + 1 === lanes ? 0 : lane + 1;
  }
  const raw = stream.rawBits();
  magnitudes(raw, symbols, values);
  signs(raw, values, values.length);
  magnitudes(raw, listed, lists);
  signs(raw, lists, SIGNED_LISTS * corrections);
  stream.end(raw);
  return { frequencies, values, step, corrections, lists };
}

/** Expected magnitudes, and the zone of coded coefficients. */
class Zone {
  readonly rows: number;
  readonly frequencies: number;
  /** (frequencies, rows): log₂ of the expected magnitude in steps, 1/32 octave. */
  readonly expected: Int32Array;
  /** Number of coded coefficients in each row. */
  readonly coded: Int32Array;

  constructor(statistics: Statistics, frames: number, millihertz: number, step: number, firstStep: number, least: number) {
    const { rows } = statistics;
    const magnitudes = expectedMagnitudes(statistics, frames, millihertz);
    this.rows = rows;
    this.coded = new Int32Array(rows);
    let frequencies = 0;
    for (let r = 0; r < rows; r++) {
      const lowest = least + (r === 0 ? firstStep : step);
      let k = frames;
      while (k > 0 && magnitudes[(k - 1) * rows + r]! < lowest) k--;
      this.coded[r] = k;
      frequencies = Math.max(frequencies, k);
    }
    this.frequencies = frequencies;
    this.expected = magnitudes.slice(0, frequencies * rows);
    for (let i = 0; i < this.expected.length; i++) this.expected[i]! -= step;
    for (let k = 0; k < frequencies; k++) this.expected[k * rows]! += step - firstStep;
  }
}

/** Cache of the last magnitudes of each model, since most chunks have the same number of frames. */
const lastMagnitudes = new WeakMap<Statistics, { frames: number; magnitudes: Int32Array }>();

/** log₂ of the expected magnitudes (frames, rows) in metres, 1/32 octave. */
function expectedMagnitudes(statistics: Statistics, frames: number, millihertz: number): Int32Array {
  const last = lastMagnitudes.get(statistics);
  if (last?.frames === frames) return last.magnitudes;
  const { rows, spreads, means } = statistics;
  const { bands, shares } = bandPlaces(frames, millihertz);
  const rise = Math.floor((log2(Math.max(millihertz, 1)) - log2(120_000)) / 2);
  const constant = Math.floor(log2(frames) / 2);
  const magnitudes = new Int32Array(frames * rows);
  for (let r = 0; r < rows; r++) {
    magnitudes[r] = means[r]! + constant;
    for (let k = 1; k < frames; k++) {
      const band = bands[k]!;
      const low = spreads[r * SPREADS + band]!;
      const high = spreads[r * SPREADS + band + 1]!;
      magnitudes[k * rows + r] = low + Math.floor(((high - low) * shares[k]!) / (BAND_LOGS[band + 1]! - BAND_LOGS[band]!)) + rise;
    }
  }
  lastMagnitudes.set(statistics, { frames, magnitudes });
  return magnitudes;
}

/** For each frequency of the DCT, the spread below it, and the distance above that spread, in 1/32 octave. */
function bandPlaces(frames: number, millihertz: number): { bands: Uint8Array; shares: Int32Array } {
  const bands = new Uint8Array(frames);
  const shares = new Int32Array(frames);
  for (let k = 0, band = 1; k < frames; k++) {
    const t = log2(Math.max(Math.floor((k * millihertz) / (2 * frames)), 1));
    while (band < 16 && BAND_LOGS[band + 1]! <= t) band++;
    bands[k] = band;
    shares[k] = Math.min(Math.max(t, BAND_LOGS[band]!), BAND_LOGS[band + 1]!) - BAND_LOGS[band]!;
  }
  return { bands, shares };
}

/** Number of frequencies that share one context of neighbours. */
function groupSize(k: number): number {
  return k < 16 ? 1 : k < 64 ? 2 : k < 128 ? 4 : 8;
}

/** Symbols (frequencies, rows); 0 outside the zone. */
function readSymbols(stream: Lanes, zone: Zone, prior: Prior): Uint8Array {
  const { frequencies, rows, expected, coded } = zone;
  const symbols = new Uint8Array(frequencies * rows);
  const before = new Neighbours(frequencies, rows);
  for (let k = 0, i = 0; k < frequencies; k++) for (let r = 0; r < rows; r++) before.set(k, r, Math.min(exp2(expected[i++]!), EXPECTED_CAP));
  const known = new Neighbours(frequencies, rows);
  const tables: Table[] = [];
  const add = new Int32Array(rows);
  for (let k = 0; k < frequencies; k += groupSize(k)) {
    const shape = CLASSES * (k === 0 ? 0 : k < 4 ? 1 : 2);
    for (let r = 0; r < rows; r++) {
      add[r] = log2OfInteger(10 + Math.min(known.sum(k, r), 65525)) - log2OfInteger((before.sum(k, r) >> 4) + 10) + 260;
    }
    const end = Math.min(k + groupSize(k), frequencies);
    let lane = 0;
    for (let f = k; f < end; f++) {
      for (let r = 0; r < rows; r++) {
        if (f >= coded[r]!) continue;
        const index = f * rows + r;
        const wanted = Math.trunc((expected[index]! + add[r]!) / 10);
        const number = shape + (wanted < 0 ? 0 : wanted > CLASSES - 1 ? CLASSES - 1 : wanted);
        const symbol = stream.symbol(lane, (tables[number] ??= prior.table(number)));
        lane = lane + 1 === stream.count ? 0 : lane + 1;
        symbols[index] = symbol;
        if (symbol) known.set(f, r, Math.min(CAP, SMALLEST[symbol]!));
      }
    }
  }
  return symbols;
}

/** Magnitudes, padded with zeros, and weighted sums over their neighbours at lower frequencies. */
class Neighbours {
  private readonly width: number;
  private readonly magnitudes: Int32Array;

  constructor(frequencies: number, rows: number) {
    this.width = rows + 8;
    this.magnitudes = new Int32Array((frequencies + 7) * this.width);
  }

  set(k: number, r: number, magnitude: number): void {
    this.magnitudes[(k + 7) * this.width + r + 4] = magnitude;
  }

  /** The weighted sum N of row r, for the group that begins at frequency k. */
  sum(k: number, r: number): number {
    const m = this.magnitudes;
    const w = this.width;
    const one = (k + 6) * w + r + 4;
    const two = one - w;
    const three = two - w;
    return (
      16 * (m[one]! + m[two]!) +
      9 * (m[one - 1]! + m[one + 1]!) +
      3 * (m[one - 4]! + m[one - 3]! + m[one - 2]! + m[one + 2]! + m[one + 3]! + m[one + 4]!) +
      3 * (m[two - 3]! + m[two - 2]! + m[two - 1]! + m[two + 1]! + m[two + 2]! + m[two + 3]!) +
      8 * m[three]! +
      6 * (m[three - w]! + m[three - 2 * w]! + m[three - 3 * w]! + m[three - 4 * w]!)
    );
  }
}

function magnitudes(raw: Bits, symbols: Uint8Array, out: Float64Array): void {
  for (let i = 0; i < symbols.length; i++) {
    const symbol = symbols[i]!;
    if (symbol) out[i] = symbol <= 10 ? symbol : SMALLEST[symbol]! + raw.number(RAW_BITS[symbol]!);
  }
}

function signs(raw: Bits, values: Float64Array, count: number): void {
  for (let i = 0; i < count; i++) if (values[i] && raw.bit()) values[i] = -values[i]!;
}
