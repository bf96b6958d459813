/** Coded integers with one rANS state, for short arrays (docs/payloads/integers.md, "One state"). */

import { check } from "../errors.js";
import { type Fields, Laws, MANTISSA_BITS, MIXTURES, TOKENS, type Table, checkMixture, kept, lawOfExpected, magnitudeOf, tableOf } from "./tables.js";

const PRECISION = 14;
const MOST_SYMBOLS = 65_536;

const FIELD_TABLES: Table[] = [
  [12, 5, 8, 4, 6, 5, 5, 4, 4, 4],
  [2, 1],
  [2, 2, 2, 2, 4, 4, 4, 4, 4, 4, 4, 4, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 3, 3, 3, 3, 3, 3, 1, 1, 1, 1],
  [1, 2, 3, 5, 8, 5, 3, 2],
  [6, 2, 1],
  [20, 1],
  [...new Array<number>(31).fill(1), 120],
  [...new Array<number>(31).fill(1), 120],
].map((weights) => tableOf(weights.map(BigInt), PRECISION));

/** A rANS state of 32 bits with words of 16 bits, without tables. */
export class State {
  x = 0;
  private at: number;

  constructor(private readonly data: Uint8Array) {
    const size = data.length <= 4 ? data.length : 4 - (data.length & 1);
    for (let i = size - 1; i >= 0; i--) this.x = this.x * 256 + data[i]!;
    this.at = size;
  }

  symbol(table: Table): number {
    const slot = this.x % 16384;
    const symbol = table.symbolOf[slot]!;
    this.advance(slot, table.start[symbol]!, table.frequency[symbol]!);
    return symbol;
  }

  /** Removes the symbol in `slot`, which has this start and frequency, from the state. */
  advance(slot: number, start: number, frequency: number): void {
    this.x = frequency * (this.x >>> PRECISION) + slot - start;
    this.refill();
  }

  /** Reads the lowest `count` bits (at most 8). */
  low(count: number): number {
    const value = this.x & ((1 << count) - 1);
    this.x = this.x >>> count;
    this.refill();
    return value;
  }

  private refill(): void {
    if (this.x < 65536 && this.at < this.data.length) {
      this.x = this.x * 65536 + (this.data[this.at]! | (this.data[this.at + 1]! << 8));
      this.at += 2;
    }
  }

  /** Reads a bit string of known length from its end, eight bits at a time. */
  bitString(length: number): Uint8Array {
    const bits = new Uint8Array(length);
    for (let end = length; end > 0; ) {
      const count = end >= 8 ? 8 : end;
      const value = this.low(count);
      for (let i = 0; i < count; i++) bits[end - 1 - i] = (value >> i) & 1;
      end -= count;
    }
    return bits;
  }

  end(what: string): void {
    check(this.x === 1 && this.at === this.data.length, `${what}: the stream has a wrong end`);
  }
}

const EIGHT_FIELDS = ["mixture", "shape", "silent", "offset", "order", "large", "rows", "columns"] as const;

/** Decodes the coded part (steps, lanes) of an array, and its fields. */
export function oneState(data: Uint8Array, steps: number, lanes: number, hints: Uint8Array | null): { fields: Fields; part: Float64Array; lanes: number } {
  const state = new State(data);
  const marker = state.x % 16384;
  check(marker >= 64, "coded integers: the stream has a wrong beginning");
  state.advance(marker, 64, 16320);
  const fields = {} as Fields;
  EIGHT_FIELDS.forEach((name, i) => (fields[name] = state.symbol(FIELD_TABLES[i]!)));
  checkMixture(fields.mixture, hints !== null);
  const height = kept(steps, fields.rows);
  const width = kept(lanes, fields.columns);
  check(height * width <= MOST_SYMBOLS, "coded integers: too many symbols for one state");
  const tokens = readTokens(state, fields, height, width, hints);
  const part = withRawBits(state, tokens);
  state.end("coded integers");
  return { fields, part, lanes: width };
}

function readTokens(state: State, fields: Fields, height: number, width: number, hints: Uint8Array | null): Uint8Array {
  const laws = new Laws(fields.large === 1, fields.shape, PRECISION);
  const lawOf = lawOfExpected(fields, laws.count);
  const tables: Table[] = [];
  const [up1, up2, left1, left2, corner, meanWeight, hintWeight] = MIXTURES[fields.mixture]! as [number, number, number, number, number, number, number];
  const tokens = new Uint8Array(height * width);
  const means = new Int32Array(width);
  const before = new Uint8Array(width); // replaces the steps before the first: each lane's left neighbour at step 0
  for (let t = 0; t < height; t++) {
    const row = tokens.subarray(t * width, t * width + width);
    const above = t > 0 ? tokens.subarray((t - 1) * width, t * width) : before;
    const above2 = t > 1 ? tokens.subarray((t - 2) * width, (t - 1) * width) : before;
    const speed = t === 0 ? 1 : t < 3 ? 2 : 3;
    const hint = hints ? hintWeight * hints[t]! : 0;
    const first = above[0]!;
    for (let l = 0; l < width; l++) {
      if (t === 0 && l > 0) {
        before[l] = row[l - 1]!;
        means[l] = before[l]! << 8;
      }
      const expected =
        up1 * above[l]! +
        up2 * above2[l]! +
        left1 * (l > 0 ? row[l - 1]! : first) +
        left2 * (l > 1 ? row[l - 2]! : l === 1 ? row[0]! : first) +
        corner * (l > 0 ? above[l - 1]! : first) +
        ((meanWeight * means[l]!) >> 8) +
        hint;
      const law = lawOf[expected]!;
      const table = (tables[law] ??= laws.table(law));
      let token = state.symbol(table);
      if (token === table.symbols - 1) token += state.symbol(laws.excess());
      check(token < TOKENS, "coded integers: a token is out of range");
      row[l] = token;
      means[l]! += ((token << 8) - means[l]!) >> speed;
    }
  }
  return tokens;
}

function withRawBits(state: State, tokens: Uint8Array): Float64Array {
  let length = 0;
  for (const token of tokens) if (token) length += 1 + MANTISSA_BITS[token]!;
  const bits = state.bitString(length);
  const values = new Float64Array(tokens.length);
  let at = 0;
  for (let i = 0; i < tokens.length; i++) {
    const token = tokens[i]!;
    if (token === 0) continue;
    const negative = bits[at++];
    let mantissa = 0;
    for (let count = MANTISSA_BITS[token]!; count > 0; count--) mantissa = 2 * mantissa + bits[at++]!;
    const magnitude = magnitudeOf(token, mantissa);
    values[i] = negative ? -magnitude : magnitude;
  }
  return values;
}
