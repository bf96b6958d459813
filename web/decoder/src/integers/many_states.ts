/** Coded integers with many rANS states, for long arrays (docs/payloads/integers.md, "Many states"). */

import { Bits, Bytes } from "../bytes.js";
import { check } from "../errors.js";
import { type Fields, Laws, MANTISSA_BITS, MIXTURES, TOKENS, type Table, checkMixture, kept, lawOfExpected, magnitudeOf } from "./tables.js";

const PRECISION = 12;

/** Layout of the coded part: groups of lanes, each cut into pieces of steps. A segment is a piece of a group. */
interface Layout {
  rows: number;
  columns: number;
  transposed: boolean;
  long: number;
  lanes: number;
  wide: number;
  pieces: number;
  steps: number;
  segments: number;
}

function layoutOf(rows: number, columns: number): Layout {
  const transposed = columns > rows;
  const long = Math.max(rows, columns);
  const short = Math.min(rows, columns);
  const groups = Math.ceil(short / 64);
  const lanes = Math.ceil(short / groups);
  const most = Math.max(1, Math.min(Math.floor(4096 / short), Math.floor(long / 128)));
  const steps = Math.ceil(long / most);
  const pieces = Math.ceil(long / steps);
  return { rows, columns, transposed, long, lanes, wide: short - groups * (lanes - 1), pieces, steps, segments: groups * pieces };
}

/** Decodes the coded part (rows, columns) of an array, and its fields. */
export function manyStates(data: Uint8Array, steps: number, lanes: number, hints: Uint8Array | null): { fields: Fields; part: Float64Array; lanes: number } {
  const rest = data[2]! | (data[3]! << 8) | (data[4]! << 16);
  const fields: Fields = {
    mixture: (rest >> 15) & 15,
    shape: (rest >> 22) & 1,
    silent: (rest >> 10) & 31,
    offset: (rest >> 19) & 7,
    order: data[0]! - 1,
    large: rest >> 23,
    rows: rest & 31,
    columns: (rest >> 5) & 31,
  };
  const turns = data[5]!;
  check(turns >= 1 && turns <= 15 && data[1] === 0 && fields.order <= 2, "coded integers: a field is out of range");
  checkMixture(fields.mixture, hints !== null);
  const layout = layoutOf(kept(steps, fields.rows), kept(lanes, fields.columns));
  const states = new States(data, Math.ceil((Math.min(layout.steps, layout.lanes) * layout.segments) / turns));
  const tokens = untransposed(new Diagonals(fields, layout, states, hints).run(), layout);
  const part = withRawBits(states.rawBits(), tokens);
  return { fields, part, lanes: layout.columns };
}

class States {
  private readonly x: Uint32Array;
  private readonly data: Uint8Array;
  private at: number;
  private turn = 0;

  constructor(data: Uint8Array, count: number) {
    const part = new Bytes(data, "coded integers");
    part.take(6);
    const extra = part.take(Math.ceil(count / 2));
    let length = 16 * count;
    for (let i = 0; i < count; i++) length += (extra[i >> 1]! >> (i & 1 ? 0 : 4)) & 15;
    const heads = new Bits(part.take(Math.ceil(length / 8)), "coded integers");
    this.x = Uint32Array.from({ length: count }, (_, i) => {
      const bits = 16 + ((extra[i >> 1]! >> (i & 1 ? 0 : 4)) & 15);
      return 2 ** bits + heads.number(bits);
    });
    this.data = data;
    this.at = part.at;
  }

  /** Makes state 0 decode the next symbol. */
  restart(): void {
    this.turn = 0;
  }

  symbol(table: Table): number {
    const x = this.x[this.turn]!;
    const slot = x & 4095;
    const symbol = table.symbolOf[slot]!;
    let next = table.frequency[symbol]! * (x >>> PRECISION) + slot - table.start[symbol]!;
    if (next < 65536) {
      check(this.at + 2 <= this.data.length, "coded integers: the stream ends too early");
      next = next * 65536 + (this.data[this.at]! | (this.data[this.at + 1]! << 8));
      this.at += 2;
    }
    this.x[this.turn] = next;
    this.turn = this.turn + 1 === this.x.length ? 0 : this.turn + 1;
    return symbol;
  }

  /** Raw bits: those of all final states, then all remaining bytes. */
  rawBits(): { bits: Bits; inStates: number } {
    const inStates = 2 * this.x.length;
    const bytes = new Uint8Array(inStates + this.data.length - this.at);
    this.x.forEach((x, i) => {
      check(x >>> 16 === 1, "coded integers: the stream has a wrong end");
      bytes[2 * i] = (x >> 8) & 255;
      bytes[2 * i + 1] = x & 255;
    });
    bytes.set(this.data.subarray(this.at), inStates);
    return { bits: new Bits(bytes, "coded integers"), inStates };
  }
}

/** Decodes tokens diagonal by diagonal: all segments side by side, lane after lane. */
class Diagonals {
  private readonly tokens: Uint8Array; // (step, lane, segment)
  private readonly means: Int32Array; // (lane, segment)
  private readonly laws: Laws;
  private readonly lawOf: Uint8Array;
  private readonly tables: Table[] = [];

  constructor(
    private readonly fields: Fields,
    private readonly layout: Layout,
    private readonly states: States,
    private readonly hints: Uint8Array | null,
  ) {
    this.tokens = new Uint8Array(layout.steps * layout.lanes * layout.segments);
    this.means = new Int32Array(layout.lanes * layout.segments);
    this.laws = new Laws(fields.large === 1, fields.shape, PRECISION);
    this.lawOf = lawOfExpected(fields, this.laws.count);
  }

  run(): Uint8Array {
    const { steps, lanes, segments, wide, pieces } = this.layout;
    const escaped: number[] = [];
    for (let diagonal = 0; diagonal < steps + lanes - 1; diagonal++) {
      escaped.length = 0;
      this.states.restart();
      const first = Math.max(0, diagonal - steps + 1);
      const last = Math.min(lanes - 1, diagonal);
      for (let lane = first; lane <= last; lane++) {
        this.row(diagonal - lane, lane, lane < lanes - 1 ? segments : wide * pieces, escaped);
      }
      this.states.restart();
      for (const place of escaped) {
        const token = this.tokens[place]! + this.states.symbol(this.laws.excess());
        check(token < TOKENS, "coded integers: a token is out of range");
        this.tokens[place] = token;
      }
      for (let lane = first; lane <= last; lane++) this.move(diagonal - lane, lane);
    }
    return this.tokens;
  }

  /** Decodes the tokens of the first `count` segments at this step and lane. */
  private row(t: number, lane: number, count: number, escaped: number[]): void {
    const { tokens, means, lawOf, states, layout } = this;
    const { lanes, segments } = layout;
    const [up1, up2, left1, left2, corner, meanWeight, hintWeight] = MIXTURES[this.fields.mixture]! as [number, number, number, number, number, number, number];
    const here = (t * lanes + lane) * segments;
    const at1 = this.place(t - 1, lane);
    const at2 = this.place(t - 2, lane);
    const atLeft1 = this.place(t, lane - 1);
    const atLeft2 = this.place(t, lane - 2);
    const atCorner = this.place(t - 1, lane - 1);
    const meansAt = lane * segments;
    for (let s = 0; s < count; s++) {
      const above = at1 < 0 ? 0 : tokens[at1 + s]!;
      if (t === 0) means[meansAt + s] = above << 8;
      let expected = up1 * above + (((means[meansAt + s]! >> 4) * meanWeight) >> 4);
      if (at2 >= 0) expected += up2 * tokens[at2 + s]!;
      if (atLeft1 >= 0) expected += left1 * tokens[atLeft1 + s]!;
      if (atLeft2 >= 0) expected += left2 * tokens[atLeft2 + s]!;
      if (atCorner >= 0) expected += corner * tokens[atCorner + s]!;
      if (hintWeight) expected += hintWeight * this.hint(t, lane, s);
      const law = lawOf[expected]!;
      const table = (this.tables[law] ??= this.laws.table(law));
      const token = states.symbol(table);
      tokens[here + s] = token;
      if (token === table.symbols - 1) escaped.push(here + s);
    }
  }

  /** Index of the tokens of a step and lane; outside the array, of their substitutes; −1: they are 0. */
  private place(t: number, lane: number): number {
    if (lane < 0) {
      t += lane;
      lane = 0;
    }
    if (t < 0) {
      if (lane === 0) return -1;
      t = 0;
      lane--;
    }
    return (t * this.layout.lanes + lane) * this.layout.segments;
  }

  private move(t: number, lane: number): void {
    const { segments, lanes } = this.layout;
    const speed = t === 0 ? 1 : t < 3 ? 2 : 3;
    const here = (t * lanes + lane) * segments;
    for (let s = 0; s < segments; s++) {
      const mean = this.means[lane * segments + s]!;
      this.means[lane * segments + s] = mean + (this.tokens[here + s]! << (8 - speed)) - (mean >> speed);
    }
  }

  /** The context of a token, 0 in the padding of the last piece. */
  private hint(t: number, lane: number, segment: number): number {
    const { pieces, steps, lanes, wide, long, transposed } = this.layout;
    const along = (segment % pieces) * steps + t;
    if (along >= long) return 0;
    const group = Math.floor(segment / pieces);
    return this.hints![transposed ? group * lanes - Math.max(0, group - wide) + lane : along]!;
  }
}

/** Reorders tokens (step, lane, segment) to (rows, columns). */
function untransposed(tokens: Uint8Array, layout: Layout): Uint8Array {
  const { rows, columns, transposed, long, lanes, wide, pieces, steps, segments } = layout;
  const out = new Uint8Array(rows * columns);
  for (let segment = 0; segment < segments; segment++) {
    const group = Math.floor(segment / pieces);
    const start = (segment % pieces) * steps;
    const firstLane = group * lanes - Math.max(0, group - wide);
    const width = group < wide ? lanes : lanes - 1;
    for (let t = 0; t < steps; t++) {
      const along = start + t;
      for (let l = 0; l < width; l++) {
        const token = tokens[(t * lanes + l) * segments + segment]!;
        if (along < long) out[transposed ? (firstLane + l) * columns + along : along * columns + firstLane + l] = token;
        else check(token === 0, "coded integers: padding that is not 0");
      }
    }
  }
  return out;
}

function withRawBits(raw: { bits: Bits; inStates: number }, tokens: Uint8Array): Float64Array {
  const { bits, inStates } = raw;
  let coded = 0;
  let length = 0;
  for (const token of tokens) {
    if (token === 0) continue;
    coded++;
    length += 1 + MANTISSA_BITS[token]!;
  }
  check(length <= bits.left, "coded integers: too few bits");
  const signs = new Uint8Array(coded);
  for (let i = 0; i < coded; i++) signs[i] = bits.bit();
  const lows: number[] = [];
  for (const token of tokens) if (MANTISSA_BITS[token]! >= 32) lows.push(bits.number(32));
  const values = new Float64Array(tokens.length);
  let next = 0;
  let nextLow = 0;
  for (let i = 0; i < tokens.length; i++) {
    const token = tokens[i]!;
    if (token === 0) continue;
    const width = MANTISSA_BITS[token]!;
    const mantissa = width >= 32 ? bits.number(width - 32) * 2 ** 32 + lows[nextLow++]! : bits.number(width);
    const magnitude = magnitudeOf(token, mantissa);
    values[i] = signs[next++] ? -magnitude : magnitude;
  }
  checkRest(bits, 8 * inStates);
  return values;
}

/** Checks the unread bits: fewer than 8 in the bytes after the words, and all 0. */
function checkRest(bits: Bits, inStates: number): void {
  const unread = 8 * bits.data.length - Math.max(bits.at, inStates);
  check(unread < 8, "coded integers: bytes are left over");
  while (bits.left) check(bits.number(Math.min(32, bits.left)) === 0, "coded integers: a padding bit is not 0");
}
