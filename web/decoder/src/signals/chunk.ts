/** Chunks of coded signals (docs/payloads/signals.md, "Payload of a chunk"). */

import { Bits, Bytes } from "../bytes.js";
import { Corrupt, check } from "../errors.js";
import { inflate } from "../inflate.js";
import { inflateLzma2 } from "../lzma2.js";
import { CONSTANT, COPY, CORRECTED_COUNTS, type Form, GRID, type ItemType, lastBit, setItem } from "./forms.js";
import { readLane } from "./residuals.js";

const REMOVED = 1;
const SAME_AS_BEFORE = 2;
const ONE_SPECIAL = 4;
const PREDICTED = 8;
const ITEMS = 16;
const KEPT = 0;
const REPEATED = 1;
const SPECIAL = 2;
const MOST = 2 ** 29;
const REFERENCE_TAPS = 3;

interface Predictor {
  shift: number;
  bias: number;
  own: number[];
  others: { channel: number; taps: number[] }[];
}

interface Record {
  form: Form;
  /** All items, if the record stores them verbatim. */
  items: Uint8Array | undefined;
  /** A code for each sample. */
  codes: Uint8Array;
  special: Uint8Array;
  first: number;
  predictor: Predictor | undefined;
  residuals: Float64Array;
  corrections: Float64Array | undefined;
  lower: Uint8Array;
  /** Integers of all samples, once computed; null during the computation. */
  integers: Float64Array | null | undefined;
}

/** Decodes the items (samples, channels) of a chunk. */
export function readChunk(payload: Uint8Array, forms: Form[], type: ItemType, samples: number): Uint8Array {
  const part = new Bytes(payload, "signals");
  const records: (Record | undefined)[] = [];
  let codes = new Uint8Array(samples);
  for (const form of forms) {
    if (form.kind === CONSTANT || form.kind === COPY) {
      records.push(undefined);
      continue;
    }
    const { record, removed } = readRecord(part, form, type, samples, codes);
    if (removed) codes = record.codes as Uint8Array<ArrayBuffer>;
    records.push(record);
  }
  part.end();
  const out = new Uint8Array(samples * forms.length * type.width);
  forms.forEach((form, channel) => {
    if (form.kind === COPY) return;
    const items = form.kind === CONSTANT ? undefined : itemsOf(records, channel, type);
    for (let t = 0; t < samples; t++) {
      const item = form.kind === CONSTANT ? form.item : items!.subarray(t * type.width, (t + 1) * type.width);
      out.set(item, (t * forms.length + channel) * type.width);
    }
  });
  forms.forEach((form, channel) => {
    for (let t = 0; form.kind === COPY && t < samples; t++) {
      const row = t * forms.length;
      out.copyWithin((row + channel) * type.width, (row + form.channel) * type.width, (row + form.channel + 1) * type.width);
    }
  });
  return out;
}

function readRecord(part: Bytes, form: Form, type: ItemType, samples: number, before: Uint8Array): { record: Record; removed: boolean } {
  const flags = part.byte();
  const record: Record = {
    form,
    items: undefined,
    codes: new Uint8Array(samples),
    special: new Uint8Array(0),
    first: 0,
    predictor: undefined,
    residuals: new Float64Array(0),
    corrections: undefined,
    lower: new Uint8Array(0),
    integers: undefined,
  };
  if (flags === ITEMS) {
    record.items = inflateLzma2(part.blob(), samples * type.width);
    check(record.items.length === samples * type.width, "signals: items of a wrong size");
    return { record, removed: false };
  }
  const removed = (flags & REMOVED) !== 0;
  check(flags < ITEMS && (removed || (flags & (SAME_AS_BEFORE | ONE_SPECIAL)) === 0), "signals: reserved flags");
  if (removed) readRemoved(part, flags, record, type, before);
  const kept = record.codes.reduce((sum, code) => sum + (code === KEPT ? 1 : 0), 0);
  if (kept === 0) return { record, removed };
  record.first = part.foldedWithin(-MOST, MOST, "the first sample");
  if (flags & PREDICTED) record.predictor = readPredictor(part);
  record.residuals = readLane(part, kept);
  if (form.kind === CORRECTED_COUNTS) record.corrections = readLane(part, kept);
  if (form.kind === GRID) record.lower = part.blob();
  return { record, removed };
}

function readRemoved(part: Bytes, flags: number, record: Record, type: ItemType, before: Uint8Array): void {
  const samples = record.codes.length;
  if (flags & SAME_AS_BEFORE) record.codes = before;
  else {
    record.codes = inflate(part.blob(), samples);
    check(record.codes.length === samples && record.codes.every((code) => code <= SPECIAL), "signals: codes that are out of range");
  }
  const count = record.codes.reduce((sum, code) => sum + (code === SPECIAL ? 1 : 0), 0);
  check(samples === 0 || record.codes.some((code) => code !== REPEATED), "signals: only repeated samples");
  record.special = new Uint8Array(count * type.width);
  if (flags & ONE_SPECIAL) {
    const item = count ? part.take(type.width) : record.special;
    for (let i = 0; i < count; i++) record.special.set(item, i * type.width);
  } else {
    record.special = inflate(part.blob(), count * type.width);
    check(record.special.length === count * type.width, "signals: special items of a wrong size");
  }
}

function readPredictor(part: Bytes): Predictor {
  const [shift, order, count] = [part.byte(), part.byte(), part.byte()];
  check(shift <= 48 && order <= 32 && count <= 16, "signals: a predictor that is out of range");
  const channels = Array.from({ length: count }, () => part.varint());
  const bias = part.folded();
  const tap = () => part.foldedWithin(-(2 ** 52), 2 ** 52, "a tap");
  const own = Array.from({ length: order }, tap);
  return { shift, bias, own, others: channels.map((channel) => ({ channel, taps: Array.from({ length: REFERENCE_TAPS }, tap) })) };
}

/** Integers of all samples of a channel, which other channels may refer to. */
function integersOf(records: (Record | undefined)[], channel: number): Float64Array {
  const record = records[channel];
  check(record !== undefined && record.items === undefined, "signals: a reference to a channel without integers");
  check(record.integers !== null, "signals: channels that refer to each other");
  if (record.integers) return record.integers;
  record.integers = null;
  const { codes } = record;
  const kept = restored(record, records);
  const out = new Float64Array(codes.length);
  const start = codes.findIndex((code) => code !== REPEATED);
  let next = 0;
  let last = codes[start] === KEPT ? kept[0]! : 0;
  for (let t = 0; t < codes.length; t++) {
    if (codes[t] === KEPT) last = kept[next++]!;
    else if (codes[t] === SPECIAL) last = 0;
    out[t] = last;
  }
  record.integers = out;
  return out;
}

/** Integers of the kept samples. */
function restored(record: Record, records: (Record | undefined)[]): Float64Array {
  const { predictor, residuals, first, codes } = record;
  if (!predictor) return residuals.map((residual) => first + residual);
  const others = predictor.others.map(({ channel, taps }) => ({ y: integersOf(records, channel), taps }));
  const out = new Float64Array(residuals.length);
  const predict = new Prediction(predictor, others, out, first);
  let place = 0;
  for (let t = 0; t < codes.length; t++) {
    if (codes[t] !== KEPT) continue;
    out[place] = predict.at(place, t) + residuals[place]!;
    place++;
  }
  return out;
}

/** Σ tap · sample, modulo 2^64: in float64 if exact, else in big integers. */
class Prediction {
  private readonly base: number;

  constructor(
    private readonly predictor: Predictor,
    private readonly others: { y: Float64Array; taps: number[] }[],
    private readonly x: Float64Array,
    private readonly first: number,
  ) {
    this.base = predictor.bias + Math.floor(2 ** predictor.shift / 2);
  }

  at(place: number, t: number): number {
    const { own, shift } = this.predictor;
    let sum = this.base;
    let size = Math.abs(sum);
    for (let i = 0; i < own.length; i++) {
      const product = own[i]! * (place > i ? this.x[place - 1 - i]! : this.first);
      sum += product;
      size += Math.abs(product);
    }
    for (const { y, taps } of this.others) {
      for (let j = 0; j < REFERENCE_TAPS; j++) {
        const product = taps[j]! * y[t > j ? t - j : 0]!;
        sum += product;
        size += Math.abs(product);
      }
    }
    const value = size <= Number.MAX_SAFE_INTEGER ? Math.floor(sum / 2 ** shift) : this.exact(place, t);
    return Math.min(MOST, Math.max(-MOST, value));
  }

  private exact(place: number, t: number): number {
    const { own, shift, bias } = this.predictor;
    let sum = BigInt(bias) + (1n << BigInt(shift)) / 2n;
    own.forEach((tap, i) => (sum += BigInt(tap) * BigInt(place > i ? this.x[place - 1 - i]! : this.first)));
    for (const { y, taps } of this.others) taps.forEach((tap, j) => (sum += BigInt(tap) * BigInt(y[t > j ? t - j : 0]!)));
    return Number(BigInt.asIntN(64, sum) >> BigInt(shift));
  }
}

/** The items of all samples of a channel. */
function itemsOf(records: (Record | undefined)[], channel: number, type: ItemType): Uint8Array {
  const record = records[channel]!;
  if (record.items) return record.items;
  const { codes, special, form, corrections } = record;
  const { width } = type;
  const integers = integersOf(records, channel);
  const items = new DataView(new ArrayBuffer(codes.length * width));
  const bytes = new Uint8Array(items.buffer);
  const lower = new Bits(record.lower, "signals");
  const start = codes.findIndex((code) => code !== REPEATED);
  let kept = 0;
  let specials = 0;
  for (let t = 0; t < codes.length; t++) {
    if (codes[t] === KEPT) {
      const k = integers[t]!;
      check(Number.isSafeInteger(k), "signals: a sample that is out of range");
      const extra = form.kind === GRID && k !== 0 ? lower.number(lowerBits(form.exponent, k, width)) : (corrections?.[kept] ?? 0);
      setItem(items, t, form, k, extra, type);
      kept++;
    } else if (codes[t] === SPECIAL) {
      bytes.set(special.subarray(specials * width, (specials + 1) * width), t * width);
      specials++;
    } else if (t > start) bytes.copyWithin(t * width, (t - 1) * width, t * width);
  }
  for (let t = 0; t < start; t++) bytes.copyWithin(t * width, start * width, (start + 1) * width);
  if (form.kind === GRID) lower.end();
  return bytes;
}

function lowerBits(exponent: number, k: number, width: number): number {
  const { lower } = lastBit(exponent, k, width);
  if (lower > 52) throw new Corrupt("signals: an exponent that the type does not have");
  return lower;
}
