/** Forms of channels, which map their integers to items (docs/payloads/signals.md, "Head"). */

import { Bits, Bytes, half } from "../bytes.js";
import { check } from "../errors.js";
import { inflate } from "../inflate.js";

export const CONSTANT = 0;
export const INTEGERS = 1;
export const COUNTS = 2;
export const GRID = 3;
export const CORRECTED_COUNTS = 4;
export const PALETTE = 5;
export const COPY = 6;

const MOST_STEP = 2 ** 40;
const MOST_EXPONENT = 1200;
const MOST_PALETTE = 2 ** 14;

/** The type of a signal's items. */
export interface ItemType {
  /** b, i, u or f. */
  kind: string;
  width: number;
  little: boolean;
}

export type Form =
  | { kind: typeof CONSTANT; item: Uint8Array }
  | { kind: typeof INTEGERS; step: number }
  | { kind: typeof COUNTS | typeof CORRECTED_COUNTS; step: number; offset: number }
  | { kind: typeof GRID; exponent: number }
  | { kind: typeof PALETTE; count: number; items: Uint8Array }
  | { kind: typeof COPY; channel: number };

/** Reads the form of each channel. */
export function readForms(part: Bytes, type: ItemType, channels: number): Form[] {
  const forms: Form[] = [];
  for (let i = 0; i < channels; i++) {
    const form = readForm(part, type);
    check(form.kind !== COPY || (form.channel < i && forms[form.channel]!.kind !== COPY), "signals: a copy without an earlier channel");
    forms.push(form);
  }
  return forms;
}

function readForm(part: Bytes, type: ItemType): Form {
  const kind = part.byte();
  if (kind === CONSTANT) return { kind, item: part.take(type.width) };
  if (kind === COPY) return { kind, channel: part.varint() };
  check((kind === INTEGERS) === (type.kind !== "f"), "signals: a form that the type does not have");
  if (kind === INTEGERS) return { kind, step: part.varintWithin(1, MOST_STEP, "a step") };
  if (kind === COUNTS || kind === CORRECTED_COUNTS) return { kind, step: part.float64(), offset: part.float64() };
  if (kind === GRID) return { kind, exponent: part.foldedWithin(-MOST_EXPONENT, MOST_EXPONENT, "an exponent") };
  check(kind === PALETTE, "signals: a reserved form");
  return { kind, ...readPalette(part, type) };
}

function readPalette(part: Bytes, type: ItemType): { count: number; items: Uint8Array } {
  const count = part.varintWithin(2, MOST_PALETTE, "the entries of a palette");
  const lengths = inflate(part.blob(), count);
  check(lengths.length === count, "signals: a palette of a wrong size");
  const width = 8 * type.width;
  let bitCount = 0;
  for (const length of lengths) {
    check(length <= width, "signals: a palette entry that is too large");
    bitCount += Math.max(0, length - 1);
  }
  const bits = new Bits(part.take(Math.ceil(bitCount / 8)), "signals");
  const items = new DataView(new ArrayBuffer(count * type.width));
  let entry = 0n;
  lengths.forEach((length, i) => {
    if (length > 0) {
      const low = length - 1;
      const highPart = low > 32 ? BigInt(bits.number(low - 32)) << 32n : 0n;
      entry += (1n << BigInt(low)) | highPart | BigInt(bits.number(Math.min(low, 32)));
    }
    check(entry >> BigInt(width) === 0n, "signals: a palette entry that is too large");
    const sign = 1n << BigInt(width - 1);
    setBits(items, i, entry & sign ? entry - sign : ~entry & (2n * sign - 1n), type);
  });
  bits.end();
  return { count, items: new Uint8Array(items.buffer) };
}

/** Writes the bits of an item. */
function setBits(items: DataView, i: number, bits: bigint, { width, little }: ItemType): void {
  if (width === 8) items.setBigUint64(8 * i, bits, little);
  else if (width === 4) items.setUint32(4 * i, Number(bits), little);
  else items.setUint16(2 * i, Number(bits), little);
}

/** Form 3: for integer k, the exponent of the last bit of its float, and the number of stored bits below k's last bit. */
export function lastBit(exponent: number, k: number, width: number): { last: number; lower: number } {
  const [mantissaBits, least] = width === 2 ? [10, -24] : width === 4 ? [23, -149] : [52, -1074];
  const last = Math.max(exponent + Math.floor(Math.log2(Math.abs(k))) - mantissaBits!, least!);
  return { last, lower: Math.max(0, exponent - last) };
}

/** Writes the item of integer k as item i. extra: the correction of form 4, or the lower bits of form 3. */
export function setItem(items: DataView, i: number, form: Form, k: number, extra: number, type: ItemType): void {
  if (form.kind === INTEGERS) setInteger(items, i, k, form.step, type);
  else if (form.kind === COUNTS) setFloat(items, i, k * form.step + form.offset, type);
  else if (form.kind === CORRECTED_COUNTS) {
    setFloat(items, i, k * form.step + form.offset, type);
    if (extra) moveRank(items, i, extra, type);
  } else if (form.kind === GRID) setFloat(items, i, gridValue(form.exponent, k, extra, type.width), type);
  else if (form.kind === PALETTE) {
    check(k >= 0 && k < form.count, "signals: an entry that the palette does not have");
    for (let b = 0; b < type.width; b++) items.setUint8(i * type.width + b, form.items[k * type.width + b]!);
  }
}

function gridValue(exponent: number, k: number, lowerBits: number, width: number): number {
  if (k === 0) return 0;
  const { last, lower } = lastBit(exponent, k, width);
  const mantissa = lower > 0 ? Math.abs(k) * 2 ** lower + lowerBits : Math.floor(Math.abs(k) / 2 ** (last - exponent));
  const value = mantissa * 2 ** Math.max(last, -1000) * 2 ** Math.min(last + 1000, 0);
  return k < 0 ? -value : value;
}

function setInteger(items: DataView, i: number, k: number, step: number, { width, little }: ItemType): void {
  if (width === 8) items.setBigInt64(8 * i, BigInt(k) * BigInt(step), little);
  else if (width === 4) items.setInt32(4 * i, k * step, little);
  else if (width === 2) items.setInt16(2 * i, k * step, little);
  else items.setInt8(i, k * step);
}

function setFloat(items: DataView, i: number, value: number, { width, little }: ItemType): void {
  if (width === 8) items.setFloat64(8 * i, value, little);
  else if (width === 4) items.setFloat32(4 * i, value, little);
  else items.setUint16(2 * i, halfBits(value), little);
}

/** Replaces a float by the `by`-th float above it. */
function moveRank(items: DataView, i: number, by: number, type: ItemType): void {
  const { width, little } = type;
  const sign = 1n << BigInt(8 * width - 1);
  const bits = width === 8 ? items.getBigUint64(8 * i, little) : BigInt(width === 4 ? items.getUint32(4 * i, little) : items.getUint16(2 * i, little));
  const magnitude = bits & (sign - 1n);
  const rank = (bits & sign ? -magnitude : magnitude) + BigInt(by);
  const size = rank < 0n ? -rank : rank;
  check(size < sign, "signals: a correction that is too large");
  setBits(items, i, rank < 0n ? sign | size : size, type);
}

/** Bits of the float16 nearest to a number, halves to even. */
function halfBits(value: number): number {
  const sign = value < 0 || Object.is(value, -0) ? 0x8000 : 0;
  const magnitude = Math.abs(value);
  if (Number.isNaN(value)) return 0x7e00;
  if (magnitude >= 65520) return sign | 0x7c00;
  let low = 0;
  let high = 0x7bff;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (half(middle) <= magnitude) low = middle;
    else high = middle - 1;
  }
  const above = low === 0x7bff ? 65536 : half(low + 1);
  const rest = magnitude - half(low);
  const gap = above - half(low);
  const isUp = rest > gap / 2 || (rest === gap / 2 && low % 2 === 1);
  return sign | (low + (isUp ? 1 : 0));
}
