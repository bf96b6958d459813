/** Tokens, laws and their frequency tables (docs/payloads/integers.md). Laws need integers of 1,900 bits and are computed once. */

import { Corrupt, check } from "../errors.js";

export const TOKENS = 252;

/** Mantissa bits of a token. */
export const MANTISSA_BITS = Uint8Array.from({ length: TOKENS }, (_, token) => (token < 16 ? 0 : ((token - 16) >> 2) + 2));

/** The smallest magnitude of a token. */
export const TOKEN_FLOOR = Float64Array.from({ length: TOKENS }, (_, token) =>
  token < 16 ? token : (4 + (token & 3)) * 2 ** MANTISSA_BITS[token]!,
);

/** The token of a magnitude. */
export function tokenOf(magnitude: number): number {
  let token = 0;
  while (token + 1 < TOKENS && TOKEN_FLOOR[token + 1]! <= magnitude) token++;
  return token;
}

/** The magnitude of a token with these mantissa bits. Throws Corrupt beyond 2^53, which no field needs. */
export function magnitudeOf(token: number, mantissa: number): number {
  const magnitude = TOKEN_FLOOR[token]! + mantissa;
  if (magnitude > Number.MAX_SAFE_INTEGER) throw new Corrupt("coded integers: a number is too large");
  return magnitude;
}

/** Frequencies that sum to 2^precision; `symbolOf` names the symbol of each slot. */
export interface Table {
  symbols: number;
  start: Uint16Array;
  frequency: Uint16Array;
  symbolOf: Uint8Array;
}

export function tableOf(weights: bigint[], precision: number): Table {
  const used = weights.reduce((count, w) => count + (w ? 1 : 0), 0);
  const room = BigInt(2 ** precision - used);
  const total = weights.reduce((sum, w) => sum + w, 0n);
  const start = new Uint16Array(weights.length);
  const frequency = new Uint16Array(weights.length);
  const symbolOf = new Uint8Array(2 ** precision);
  let below = 0n;
  let at = 0;
  weights.forEach((w, symbol) => {
    if (w) frequency[symbol] = 1 + Number((room * (below + w)) / total - (room * below) / total);
    start[symbol] = at;
    symbolOf.fill(symbol, at, at + frequency[symbol]!);
    at += frequency[symbol]!;
    below += w;
  });
  return { symbols: weights.length, start, frequency, symbolOf };
}

/** The scale of a law: 40, 50 or 63, times 2^(law // 3). */
function sigma(law: number): bigint {
  return BigInt([40, 50, 63][law % 3]!) << BigInt(Math.floor(law / 3));
}

function lawWeights(law: number, shape: number, precision: number): bigint[] {
  const s = sigma(law);
  const [linear, square] = shape === 0 ? [25n, 0n] : [16n, 5n];
  const f = 300n * s * s;
  const power = f ** 12n << 62n;
  const weights: bigint[] = [];
  let survival = 1n << 62n;
  for (let token = 1; token < TOKENS; token++) {
    const a = 4096n * BigInt(TOKEN_FLOOR[token]!) - 2048n;
    const beyond = power / (f + a * (linear * s + square * a)) ** 12n;
    weights.push(survival > beyond ? survival - beyond : 1n);
    survival = beyond;
    if (token > 1 && survival << BigInt(precision - 1) < 1n << 62n) break;
  }
  weights.push(survival > 1n ? survival : 1n);
  return weights;
}

const SHORT_LADDER = 54;
const LONG_LADDER = 210;
const ESCAPES = 255;

const cache = new Map<number, Table>();

/** The laws of a ladder and a shape, and the table of excess, computed at their first use. */
export class Laws {
  readonly count: number;

  constructor(
    private readonly large: boolean,
    private readonly shape: number,
    private readonly precision: number,
  ) {
    this.count = large ? LONG_LADDER : SHORT_LADDER;
  }

  /** The table of a law; its last symbol is an escape. */
  table(law: number): Table {
    return this.cached(law, () => lawWeights(law, this.shape, this.precision));
  }

  /** The table of the excess after an escape. */
  excess(): Table {
    return this.cached(ESCAPES - (this.large ? 1 : 0), () => {
      const reach = this.precision === 12 ? (this.large ? TOKENS : 64) : this.table(this.count - 1).symbols;
      return Array.from({ length: reach }, (_, e) => BigInt(Math.floor(2 ** 20 / (e + 1) ** 2)));
    });
  }

  private cached(law: number, weights: () => bigint[]): Table {
    const key = (law * 2 + this.shape) * 16 + this.precision;
    let table = cache.get(key);
    if (!table) cache.set(key, (table = tableOf(weights(), this.precision)));
    return table;
  }
}

let usual: Uint8Array | undefined;

/** The law of each expected token (unit 1/16), without `offset`. Large tokens need more than 53 bits. */
function usualLaws(): Uint8Array {
  if (usual) return usual;
  usual = new Uint8Array(4096);
  const scales = Array.from({ length: LONG_LADDER }, (_, law) => (sigma(law) * 9n) / 8n);
  let law = 0;
  for (let expected = 1; expected < 4096; expected++) {
    const token = Math.min(expected >> 4, 250);
    const low = BigInt(TOKEN_FLOOR[token]!);
    const high = BigInt(TOKEN_FLOOR[token + 1]!);
    const part = BigInt(expected < 4032 ? expected - 16 * token : 0);
    const scale = 240n * (16n * low + (high - low) * part) + 512n;
    while (law < LONG_LADDER && scales[law]! < scale) law++;
    usual[expected] = law;
  }
  return usual;
}

/** The eight fields of a stream. */
export interface Fields {
  mixture: number;
  shape: number;
  silent: number;
  offset: number;
  order: number;
  large: number;
  rows: number;
  columns: number;
}

/** The law of each expected token E (0 … 4095, unit 1/16). */
export function lawOfExpected(fields: Fields, laws: number): Uint8Array {
  const usual = usualLaws();
  const result = new Uint8Array(4096);
  for (let expected = 1; expected < 4096; expected++) {
    result[expected] = Math.min(Math.max(usual[expected]! + fields.offset - 4, 0), laws - 1);
  }
  result[0] = fields.silent;
  return result;
}

/** Weights of the tokens (t−1, l), (t−2, l), (t, l−1), (t, l−2), (t−1, l−1), the mean of the lane, and the context. */
export const MIXTURES: readonly (readonly number[])[] = [
  [5, 2, 5, 2, 2, 0, 0],
  [0, 0, 0, 0, 0, 16, 0],
  [3, 1, 7, 3, 2, 0, 0],
  [0, 0, 8, 5, 3, 0, 0],
  [4, 2, 3, 2, 1, 4, 0],
  [7, 3, 3, 1, 2, 0, 0],
  [0, 0, 0, 0, 0, 0, 0],
  [3, 1, 3, 1, 0, 0, 8],
  [2, 0, 2, 0, 0, 4, 8],
  [1, 0, 1, 0, 0, 2, 12],
];

/** Number of coded steps or lanes, the first ones of `extent`. */
export function kept(extent: number, thirtySeconds: number): number {
  return Math.max(1, Math.ceil((extent * (thirtySeconds + 1)) / 32));
}

export function checkMixture(mixture: number, hasContexts: boolean): void {
  check(mixture < MIXTURES.length && (mixture < 7 || hasContexts), "coded integers: a mixture that needs contexts");
}
