/** Raw LZMA2, as in XZ files: chunks of LZMA or of plain bytes. */

import { Corrupt, check } from "./errors.js";

const BIT_MODEL_TOTAL = 2048;
const MOVE_BITS = 5;
const STATES = 12;
const DICTIONARY_BYTES = 2 ** 22;

/** Decompresses a stream to at most `limit` bytes. The stream must end where the data ends. */
export function inflateLzma2(data: Uint8Array, limit: number): Uint8Array {
  const decoder = new Lzma2(data, limit);
  return decoder.run();
}

/** Reads bits with adaptive probabilities. */
class RangeDecoder {
  private range = 0xffffffff;
  private code = 0;
  private at: number;

  constructor(
    private readonly data: Uint8Array,
    start: number,
    private readonly end: number,
  ) {
    check(end - start >= 5 && data[start] === 0, "LZMA2: a chunk has a wrong beginning");
    this.at = start + 1;
    for (let i = 0; i < 4; i++) this.code = ((this.code << 8) | data[this.at++]!) >>> 0;
  }

  bit(model: Uint16Array, index: number): number {
    this.normalise();
    const p = model[index]!;
    const bound = (this.range >>> 11) * p;
    if (this.code < bound) {
      this.range = bound;
      model[index] = p + ((BIT_MODEL_TOTAL - p) >> MOVE_BITS);
      return 0;
    }
    this.range -= bound;
    this.code -= bound;
    model[index] = p - (p >> MOVE_BITS);
    return 1;
  }

  /** Reads a number of `count` bits without a model, highest bit first. */
  direct(count: number): number {
    let value = 0;
    for (let i = 0; i < count; i++) {
      this.normalise();
      this.range >>>= 1;
      const bit = this.code >= this.range ? 1 : 0;
      if (bit) this.code -= this.range;
      value = value * 2 + bit;
    }
    return value;
  }

  /** Reads a number of `count` bits with a tree of models from `start` on, highest bit first. */
  tree(model: Uint16Array, start: number, count: number): number {
    let node = 1;
    for (let i = 0; i < count; i++) node = 2 * node + this.bit(model, start + node);
    return node - 2 ** count;
  }

  /** `tree`, but lowest bit first. */
  reverseTree(model: Uint16Array, start: number, count: number): number {
    let node = 1;
    let value = 0;
    for (let i = 0; i < count; i++) {
      const bit = this.bit(model, start + node);
      node = 2 * node + bit;
      value |= bit << i;
    }
    return value;
  }

  /** Checks that the whole chunk was read. */
  finish(): void {
    this.normalise();
    check(this.at === this.end && this.code === 0, "LZMA2: a chunk has a wrong end");
  }

  private normalise(): void {
    if (this.range >= 0x1000000) return;
    check(this.at < this.end, "LZMA2: a chunk ends too early");
    this.range = (this.range << 8) >>> 0;
    this.code = ((this.code << 8) | this.data[this.at++]!) >>> 0;
  }
}

/** Models of match lengths, 2 to 273. */
class Lengths {
  private readonly choice = new Uint16Array(2).fill(BIT_MODEL_TOTAL / 2);
  private readonly low = new Uint16Array(16 * 8).fill(BIT_MODEL_TOTAL / 2);
  private readonly middle = new Uint16Array(16 * 8).fill(BIT_MODEL_TOTAL / 2);
  private readonly high = new Uint16Array(256).fill(BIT_MODEL_TOTAL / 2);

  read(range: RangeDecoder, position: number): number {
    if (!range.bit(this.choice, 0)) return 2 + range.tree(this.low, 8 * position, 3);
    if (!range.bit(this.choice, 1)) return 10 + range.tree(this.middle, 8 * position, 3);
    return 18 + range.tree(this.high, 0, 8);
  }
}

const halves = (count: number) => new Uint16Array(count).fill(BIT_MODEL_TOTAL / 2);

/** All models, which a state reset initialises. */
class Models {
  readonly isMatch = halves(STATES * 16);
  readonly isRep = halves(STATES);
  readonly isRep0 = halves(STATES);
  readonly isRep0Long = halves(STATES * 16);
  readonly isRep1 = halves(STATES);
  readonly isRep2 = halves(STATES);
  readonly slots = halves(4 * 64);
  readonly distances = halves(128);
  readonly align = halves(16);
  readonly lengths = new Lengths();
  readonly repeatedLengths = new Lengths();
  readonly literals: Uint16Array;
  state = 0;
  reps: [number, number, number, number] = [0, 0, 0, 0];

  constructor(literalBits: number) {
    this.literals = halves(0x300 << literalBits);
  }
}

class Lzma2 {
  private out: Uint8Array;
  private size = 0;
  /** Start of the dictionary. */
  private dictionary = 0;
  private lc = 0;
  private lp = 0;
  private pb = 0;
  private models: Models | undefined;

  constructor(
    private readonly data: Uint8Array,
    private readonly limit: number,
  ) {
    this.out = new Uint8Array(Math.min(limit, Math.max(1024, 4 * data.length)));
  }

  run(): Uint8Array {
    const { data } = this;
    for (let at = 0; ; ) {
      check(at < data.length, "LZMA2: the data ends too early");
      const control = data[at++]!;
      if (control === 0) {
        check(at === data.length, "LZMA2: bytes are left over");
        return this.out.slice(0, this.size);
      }
      at = control < 0x80 ? this.plain(control, at) : this.packed(control, at);
    }
  }

  private room(count: number): void {
    const wanted = this.size + count;
    check(wanted <= this.limit, "LZMA2: more bytes than declared");
    if (wanted <= this.out.length) return;
    const larger = new Uint8Array(Math.min(2 * wanted, this.limit));
    larger.set(this.out.subarray(0, this.size));
    this.out = larger;
  }

  private plain(control: number, at: number): number {
    check(control <= 2 && at + 2 <= this.data.length, "LZMA2: a reserved chunk");
    const count = this.data[at]! * 256 + this.data[at + 1]! + 1;
    const end = at + 2 + count;
    check(end <= this.data.length, "LZMA2: the data ends too early");
    this.room(count);
    if (control === 1) this.dictionary = this.size;
    this.out.set(this.data.subarray(at + 2, end), this.size);
    this.size += count;
    return end;
  }

  private packed(control: number, at: number): number {
    const reset = (control >> 5) & 3;
    const head = reset >= 2 ? 5 : 4;
    check(at + head <= this.data.length, "LZMA2: the data ends too early");
    const count = ((control & 31) << 16) + this.data[at]! * 256 + this.data[at + 1]! + 1;
    const end = at + head + this.data[at + 2]! * 256 + this.data[at + 3]! + 1;
    check(end <= this.data.length, "LZMA2: the data ends too early");
    if (reset >= 2) this.readProperties(this.data[at + 4]!);
    if (reset === 3) this.dictionary = this.size;
    if (reset >= 1 && this.models) this.models = new Models(this.lc + this.lp);
    this.room(count);
    this.decode(new RangeDecoder(this.data, at + head, end), this.size + count);
    return end;
  }

  private readProperties(byte: number): void {
    check(byte < 225, "LZMA2: properties that are out of range");
    this.lc = byte % 9;
    this.lp = Math.floor(byte / 9) % 5;
    this.pb = Math.floor(byte / 45);
    check(this.lc + this.lp <= 4, "LZMA2: properties that are out of range");
    this.models = new Models(this.lc + this.lp);
  }

  private decode(range: RangeDecoder, end: number): void {
    const models = this.models;
    if (!models) throw new Corrupt("LZMA2: a chunk without properties");
    while (this.size < end) {
      const position = (this.size - this.dictionary) & ((1 << this.pb) - 1);
      if (!range.bit(models.isMatch, models.state * 16 + position)) {
        this.literal(range, models);
        continue;
      }
      const length = range.bit(models.isRep, models.state) ? this.repeat(range, models, position) : this.match(range, models, position);
      const distance = models.reps[0] + 1;
      check(distance <= this.size - this.dictionary && distance <= DICTIONARY_BYTES, "LZMA2: a distance before the beginning");
      check(this.size + length <= end, "LZMA2: a match beyond its chunk");
      for (let i = 0; i < length; i++, this.size++) this.out[this.size] = this.out[this.size - distance]!;
    }
    range.finish();
  }

  private literal(range: RangeDecoder, models: Models): void {
    const { out, size, lc, lp } = this;
    const before = size > this.dictionary ? out[size - 1]! : 0;
    const place = (((size - this.dictionary) & ((1 << lp) - 1)) << lc) + (before >> (8 - lc));
    const base = 0x300 * place;
    let symbol = 1;
    if (models.state >= 7) {
      check(models.reps[0] < size - this.dictionary, "LZMA2: a distance before the beginning");
      let matched = out[size - models.reps[0] - 1]!;
      while (symbol < 0x100) {
        const expected = (matched >> 7) & 1;
        matched <<= 1;
        const bit = range.bit(models.literals, base + ((1 + expected) << 8) + symbol);
        symbol = 2 * symbol + bit;
        if (bit !== expected) break;
      }
    }
    while (symbol < 0x100) symbol = 2 * symbol + range.bit(models.literals, base + symbol);
    out[this.size++] = symbol & 255;
    const { state } = models;
    models.state = state < 4 ? 0 : state < 10 ? state - 3 : state - 6;
  }

  private match(range: RangeDecoder, models: Models, position: number): number {
    models.reps = [0, models.reps[0], models.reps[1], models.reps[2]];
    models.state = models.state < 7 ? 7 : 10;
    const length = models.lengths.read(range, position);
    const slot = range.tree(models.slots, 64 * Math.min(length - 2, 3), 6);
    if (slot < 4) models.reps[0] = slot;
    else {
      const bits = (slot >> 1) - 1;
      const base = (2 | (slot & 1)) * 2 ** bits;
      models.reps[0] =
        slot < 14 ? base + range.reverseTree(models.distances, base - slot, bits) : base + 16 * range.direct(bits - 4) + range.reverseTree(models.align, 0, 4);
    }
    return length;
  }

  private repeat(range: RangeDecoder, models: Models, position: number): number {
    const { state, reps } = models;
    if (!range.bit(models.isRep0, state)) {
      if (!range.bit(models.isRep0Long, state * 16 + position)) {
        models.state = state < 7 ? 9 : 11;
        return 1;
      }
    } else {
      const which = !range.bit(models.isRep1, state) ? 1 : !range.bit(models.isRep2, state) ? 2 : 3;
      const distance = reps[which]!;
      reps.copyWithin(1, 0, which);
      reps[0] = distance;
    }
    models.state = state < 7 ? 8 : 11;
    return models.repeatedLengths.read(range, position);
  }
}
