/** Logarithms to base 2 in units of 1/32 octave, computed from tables (docs/payloads/tempo.md, "Logarithms"). */

/** Frequencies of the spreads, millihertz. */
export const BAND = [0, 200, 350, 500, 700, 1000, 1400, 2000, 2800, 4000, 5600, 8000, 11000, 16000, 22000, 32000, 45000, 60000] as const;
export const SPREADS = BAND.length;
/** First spread of each of the four bands, and the end. */
export const BAND_STARTS = [0, 5, 8, 10, 18] as const;

const LOG = Int32Array.from({ length: 256 }, (_, i) => Math.round(32 * Math.log2(1 + i / 256)));
const LOWEST = -512;
const HIGHEST = 1023;
const EXP = Int32Array.from({ length: HIGHEST - LOWEST + 1 }, (_, i) => Math.min(2 ** 20, Math.round(16 * 2 ** ((i + LOWEST) / 32))));
EXP[-160 - LOWEST] = 0;

const FLOAT = new Float64Array(1);
const WORDS = new Uint32Array(FLOAT.buffer);

/** log2 of a positive number: exponent and fraction are those of its float64. */
export function log2(value: number): number {
  FLOAT[0] = value;
  let high = WORDS[1]!;
  let exponent = (high >>> 20) & 2047;
  if (exponent === 0) {
    FLOAT[0] = value * 2 ** 64; // subnormal
    high = WORDS[1]!;
    exponent = ((high >>> 20) & 2047) - 64;
  }
  return 32 * (exponent - 1023) + LOG[(high >>> 12) & 255]!;
}

/** log2 of a positive integer below 2^31. */
export function log2OfInteger(value: number): number {
  const exponent = 31 - Math.clz32(value);
  return 32 * exponent + LOG[(exponent >= 8 ? value >> (exponent - 8) : value << (8 - exponent)) & 255]!;
}

/** 16 · 2^(x / 32). */
export function exp2(x: number): number {
  return EXP[(x < LOWEST ? LOWEST : x > HIGHEST ? HIGHEST : x) - LOWEST]!;
}

export const BAND_LOGS = Int32Array.from(BAND, (frequency) => (frequency ? log2(frequency) : 0));

const FRACTION = Array.from({ length: 32 }, (_, i) => Math.round(2 ** (i / 32) * 2 ** 20) / 2 ** 20);

/** 4^(x / 32) of an integer x, from a table: equal on all machines. */
export function square(x: number): number {
  return FRACTION[(((2 * x) % 32) + 32) % 32]! * 2 ** Math.floor((2 * x) / 32);
}
