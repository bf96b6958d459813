/** Lanes of residuals: an adaptive coder with initial tables for noise (docs/payloads/signals.md, "Residuals"). */

import { Bits, Bytes } from "../bytes.js";
import { GAUSS_RATIOS, LAPLACE_RATIOS } from "../container/tables.js";
import { check } from "../errors.js";

const HIGH = 16;
const LOW = 4;
const HALF = 32;
const TOTAL = 1 << 15;
const HIGH_FLOOR = 8;
const LOW_FLOOR = 64;
const CONTEXTS = 44;
const FIRST_SCALED = 40;
const START_CODES = 144;
const MOST_ZEROS = 30;
const SLOWER_AFTER = 64;
const MOST_SIZE = 2 ** 30;

interface FirstTables {
  high: Int32Array;
  /** Low tables (16, 4). */
  low: Int32Array;
}

const firstTables: (FirstTables | undefined)[] = [];

function firstTablesOf(context: number): FirstTables {
  return (firstTables[context] ??= makeFirstTables(context));
}

function makeFirstTables(context: number): FirstTables {
  const both = [masses(BigInt(LAPLACE_RATIOS[context]!), false), masses(BigInt(GAUSS_RATIOS[context]!), true)];
  const mass = Array.from({ length: 2 * HALF }, (_, n) => both[0]![Math.abs(n - HALF)]! + both[1]![Math.abs(n - HALF)]!);
  const high = Array.from({ length: HIGH }, (_, h) => mass.slice(LOW * h, LOW * (h + 1)).reduce((sum, m) => sum + m, 0));
  const low = new Int32Array(HIGH * LOW);
  for (let h = 0; h < HIGH; h++) low.set(startsOf(mass.slice(LOW * h, LOW * (h + 1)), LOW_FLOOR), LOW * h);
  return { high: Int32Array.from(startsOf(high, HIGH_FLOOR)), low };
}

/** Mass of each magnitude 0 … 32 in a Laplace or Gauss distribution. */
function masses(ratio: bigint, isGauss: boolean): number[] {
  const weights = [1n << 30n];
  let factor = ratio;
  for (let n = 0; n < HALF; n++) {
    const weight = (weights[n]! * factor) >> 30n;
    weights.push(weight > 1n ? weight : 1n);
    if (isGauss) factor = (factor * ratio * ratio) >> 60n;
  }
  const total = 2n * weights.reduce((sum, weight) => sum + weight, 0n) - weights[0]!;
  return weights.map((weight) => Number((weight << 30n) / total));
}

function startsOf(mass: number[], floor: number): number[] {
  const total = Math.max(1, mass.reduce((sum, m) => sum + m, 0));
  let before = 0;
  return mass.map((m, i) => {
    const start = Math.floor((TOTAL * before) / total);
    before += m;
    return Math.min(TOTAL - floor * (mass.length - i), Math.max(floor * i, start));
  });
}

/** Adaptive tables of a lane, with one rANS state. */
class Tables {
  private readonly high = new Int32Array(CONTEXTS * HIGH);
  private readonly low = new Int32Array(CONTEXTS * HIGH * LOW);
  private readonly seenHigh = new Uint8Array(CONTEXTS);
  private readonly seenLow = new Uint8Array(CONTEXTS * HIGH);
  private readonly isMade = new Uint8Array(CONTEXTS);
  private at = 0;

  constructor(
    private state: number,
    private readonly words: Uint8Array,
  ) {}

  prepare(context: number): void {
    if (this.isMade[context]) return;
    this.isMade[context] = 1;
    const first = firstTablesOf(context);
    this.high.set(first.high, context * HIGH);
    this.low.set(first.low, context * HIGH * LOW);
  }

  highSymbol(context: number): number {
    return this.symbol(this.high, context * HIGH, HIGH, HIGH_FLOOR, this.seenHigh, context);
  }

  lowSymbol(context: number, high: number): number {
    const number = context * HIGH + high;
    return this.symbol(this.low, number * LOW, LOW, LOW_FLOOR, this.seenLow, number);
  }

  private symbol(starts: Int32Array, first: number, count: number, floor: number, seen: Uint8Array, number: number): number {
    const slot = this.state & (TOTAL - 1);
    let s = 0;
    for (let half = count >> 1; half > 0; half >>= 1) if (starts[first + s + half]! <= slot) s += half;
    const start = starts[first + s]!;
    const end = s + 1 < count ? starts[first + s + 1]! : TOTAL;
    this.state = (end - start) * (this.state >>> 15) + slot - start;
    if (this.state < 65536) {
      check(this.at + 2 <= this.words.length, "signals: the words end too early");
      this.state = this.state * 65536 + (this.words[this.at]! | (this.words[this.at + 1]! << 8));
      this.at += 2;
    }
    const rate = seen[number]! < SLOWER_AFTER ? 7 : 8;
    if (seen[number]! < SLOWER_AFTER) seen[number]!++;
    for (let i = 0; i < count; i++) {
      const target = i <= s ? floor * i : TOTAL - floor * (count - i);
      starts[first + i]! += (target - starts[first + i]!) >> rate;
    }
    return s;
  }

  end(): void {
    check(this.state === 65536 && this.at === this.words.length, "signals: a lane has a wrong end");
  }
}

/** Reads the residuals of a lane, integers. */
export function readLane(part: Bytes, count: number): Float64Array {
  const start = part.byte();
  check(start < START_CODES, "signals: a lane with an unknown start");
  const state = part.uint32();
  check(state >= 65536, "signals: a state that is too small");
  const tables = new Tables(state, part.take(2 * part.varint()));
  const raw = new Bits(part.blob(), "signals");
  const out = new Float64Array(count);
  let fast = (4 + (start % 4)) * 2 ** (start >> 2);
  let slow = fast;
  for (let i = 0; i < count; i++) {
    const mean = fast + slow;
    const place = mean < 2 ** 32 ? 31 - Math.clz32(mean) : 63 - Math.clz32(mean / 2 ** 32);
    const level = 4 * place + (Math.floor(mean / 2 ** (place - 2)) % 4) - 36;
    const shift = Math.max(0, (level >> 2) - 2);
    const context = shift ? FIRST_SCALED + (level & 3) : Math.max(0, level + 28);
    tables.prepare(context);
    const high = tables.highSymbol(context);
    let v: number;
    if (high === 0 || high === HIGH - 1) {
      let zeros = 0;
      while (!raw.bit()) check(++zeros <= MOST_ZEROS, "signals: a residual that is too large");
      const b = 2 ** zeros + raw.number(zeros);
      v = high === 0 ? -28 - b : 27 + b;
    } else {
      v = LOW * high + tables.lowSymbol(context, high) - HALF;
    }
    const residual = v * 2 ** shift + raw.number(shift);
    out[i] = residual;
    const size = 256 * Math.min(Math.abs(residual), MOST_SIZE);
    fast = Math.max(2, fast + Math.floor((size - fast) / 8));
    slow = Math.max(2, slow + Math.floor((size - slow) / 64));
  }
  tables.end();
  check(raw.left < 8, "signals: raw bits are left over");
  return out;
}
