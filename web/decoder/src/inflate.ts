/** Raw deflate (RFC 1951), with a preset dictionary and a size limit. */

import { Corrupt, check } from "./errors.js";

const LENGTH_BASE = [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
const LENGTH_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const DISTANCE_BASE = [
  1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385,
  24577,
];
const DISTANCE_BITS = DISTANCE_BASE.map((_, i) => Math.max(0, (i >> 1) - 1));
const ORDER_OF_LENGTHS = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/** A canonical Huffman code: the number of codes of each length, and the symbols in the order of their codes. */
interface Huffman {
  counts: Uint16Array;
  symbols: Uint16Array;
}

function huffman(lengths: ArrayLike<number>): Huffman {
  const counts = new Uint16Array(16);
  for (let i = 0; i < lengths.length; i++) counts[lengths[i]!]!++;
  counts[0] = 0;
  let left = 1;
  for (let length = 1; length < 16; length++) {
    left = 2 * left - counts[length]!;
    check(left >= 0, "deflate: a Huffman code has too many symbols");
  }
  const offsets = new Uint16Array(16);
  for (let length = 1; length < 15; length++) offsets[length + 1] = offsets[length]! + counts[length]!;
  const symbols = new Uint16Array(lengths.length);
  for (let i = 0; i < lengths.length; i++) if (lengths[i]) symbols[offsets[lengths[i]!]!++] = i;
  return { counts, symbols };
}

const FIXED_LITERALS = huffman(Uint8Array.from({ length: 288 }, (_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8)));
const FIXED_DISTANCES = huffman(new Uint8Array(30).fill(5));

class Inflater {
  private at = 0;
  private hold = 0;
  private count = 0;
  private out: Uint8Array;
  private size: number;

  constructor(
    private readonly data: Uint8Array,
    private readonly dictionary: Uint8Array,
    private readonly limit: number,
  ) {
    this.out = new Uint8Array(dictionary.length + Math.min(limit, Math.max(1024, 4 * data.length)));
    this.out.set(dictionary);
    this.size = dictionary.length;
  }

  /** Decodes all blocks; returns the result and the number of bytes read. */
  run(): { bytes: Uint8Array; used: number } {
    let last = 0;
    while (!last) {
      last = this.bits(1);
      const kind = this.bits(2);
      if (kind === 0) this.stored();
      else if (kind === 1) this.compressed(FIXED_LITERALS, FIXED_DISTANCES);
      else if (kind === 2) this.dynamic();
      else throw new Corrupt("deflate: a block of a reserved kind");
    }
    return { bytes: this.out.slice(this.dictionary.length, this.size), used: this.at };
  }

  private bits(count: number): number {
    while (this.count < count) {
      check(this.at < this.data.length, "deflate: the data ends too early");
      this.hold |= this.data[this.at++]! << this.count;
      this.count += 8;
    }
    const value = this.hold & ((1 << count) - 1);
    this.hold >>>= count;
    this.count -= count;
    return value;
  }

  private symbol(code: Huffman): number {
    let value = 0;
    let first = 0;
    let index = 0;
    for (let length = 1; length < 16; length++) {
      value |= this.bits(1);
      const count = code.counts[length]!;
      if (value - count < first) return code.symbols[index + value - first]!;
      index += count;
      first = (first + count) << 1;
      value <<= 1;
    }
    throw new Corrupt("deflate: an unused code");
  }

  private room(count: number): void {
    const wanted = this.size + count;
    check(wanted - this.dictionary.length <= this.limit, "deflate: more bytes than declared");
    if (wanted <= this.out.length) return;
    const larger = new Uint8Array(Math.min(2 * wanted, this.dictionary.length + this.limit));
    larger.set(this.out.subarray(0, this.size));
    this.out = larger;
  }

  private stored(): void {
    this.hold = 0;
    this.count = 0;
    check(this.at + 4 <= this.data.length, "deflate: the data ends too early");
    const count = this.data[this.at]! | (this.data[this.at + 1]! << 8);
    const inverse = this.data[this.at + 2]! | (this.data[this.at + 3]! << 8);
    this.at += 4;
    check(count === (~inverse & 0xffff) && this.at + count <= this.data.length, "deflate: a stored block does not fit");
    this.room(count);
    this.out.set(this.data.subarray(this.at, this.at + count), this.size);
    this.at += count;
    this.size += count;
  }

  private dynamic(): void {
    const literals = this.bits(5) + 257;
    const distances = this.bits(5) + 1;
    const codes = this.bits(4) + 4;
    const lengths = new Uint8Array(320);
    for (let i = 0; i < codes; i++) lengths[ORDER_OF_LENGTHS[i]!] = this.bits(3);
    const code = huffman(lengths.subarray(0, 19));
    lengths.fill(0);
    for (let i = 0; i < literals + distances; ) {
      const symbol = this.symbol(code);
      if (symbol < 16) {
        lengths[i++] = symbol;
        continue;
      }
      check(symbol !== 16 || i > 0, "deflate: nothing to repeat");
      const value = symbol === 16 ? lengths[i - 1]! : 0;
      const count = symbol === 16 ? 3 + this.bits(2) : symbol === 17 ? 3 + this.bits(3) : 11 + this.bits(7);
      check(i + count <= literals + distances, "deflate: too many lengths");
      lengths.fill(value, i, i + count);
      i += count;
    }
    check(lengths[256] !== 0, "deflate: a block without an end");
    this.compressed(huffman(lengths.subarray(0, literals)), huffman(lengths.subarray(literals, literals + distances)));
  }

  private compressed(literals: Huffman, distances: Huffman): void {
    for (;;) {
      const symbol = this.symbol(literals);
      if (symbol === 256) return;
      if (symbol < 256) {
        this.room(1);
        this.out[this.size++] = symbol;
        continue;
      }
      check(symbol < 286, "deflate: a reserved length");
      const length = LENGTH_BASE[symbol - 257]! + this.bits(LENGTH_BITS[symbol - 257]!);
      const place = this.symbol(distances);
      check(place < 30, "deflate: a reserved distance");
      const distance = DISTANCE_BASE[place]! + this.bits(DISTANCE_BITS[place]!);
      check(distance <= this.size, "deflate: a distance before the beginning");
      this.room(length);
      for (let i = 0; i < length; i++, this.size++) this.out[this.size] = this.out[this.size - distance]!;
    }
  }
}

const NO_DICTIONARY = new Uint8Array(0);

/** Inflates raw deflate data to at most `limit` bytes. The stream must end where the data ends. */
export function inflate(data: Uint8Array, limit: number, dictionary: Uint8Array = NO_DICTIONARY): Uint8Array {
  const { bytes, used } = new Inflater(data, dictionary, limit).run();
  check(used === data.length, "deflate: bytes are left over");
  return bytes;
}

/** Inflates a zlib stream (RFC 1950), and checks its Adler-32. */
export function inflateZlib(data: Uint8Array, limit: number): Uint8Array {
  check(data.length >= 6 && (data[0]! & 15) === 8 && ((data[0]! << 8) | data[1]!) % 31 === 0, "zlib: a wrong header");
  check((data[1]! & 32) === 0, "zlib: a preset dictionary");
  const { bytes, used } = new Inflater(data.subarray(2), NO_DICTIONARY, limit).run();
  check(used + 6 === data.length, "zlib: bytes are left over");
  let a = 1;
  let b = 0;
  for (let i = 0; i < bytes.length; i++) {
    a = (a + bytes[i]!) % 65521;
    b = (b + a) % 65521;
  }
  const tail = data.subarray(used + 2);
  check(((tail[0]! << 8) | tail[1]!) === b && ((tail[2]! << 8) | tail[3]!) === a, "zlib: the checksum does not match");
  return bytes;
}
