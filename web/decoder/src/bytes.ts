/** Reads numbers and blobs of a file (docs/format.md, docs/payloads/index.md). */

import { Corrupt, check } from "./errors.js";

/** Reads a byte string from front to back. Every read is checked against the bytes that remain. */
export class Bytes {
  at = 0;
  private readonly view: DataView;

  /** `what` names the part in messages of Corrupt. */
  constructor(
    readonly data: Uint8Array,
    readonly what: string,
  ) {
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  }

  get left(): number {
    return this.data.length - this.at;
  }

  /** The next `count` bytes, not copied. */
  take(count: number): Uint8Array {
    if (!(count <= this.left)) throw new Corrupt(`${this.what}: ${count} bytes are needed, ${this.left} are left`);
    this.at += count;
    return this.data.subarray(this.at - count, this.at);
  }

  rest(): Uint8Array {
    return this.take(this.left);
  }

  byte(): number {
    return this.take(1)[0]!;
  }

  /** An unsigned varint below 2^53; no part of a file needs larger ones, so they are corrupt. */
  varint(): number {
    const value = this.bigVarint();
    check(value <= Number.MAX_SAFE_INTEGER, `${this.what}: the number ${value} is too large`);
    return Number(value);
  }

  /** An unsigned varint below 2^63: a number if that is exact, else a bigint. */
  bigVarint(): number | bigint {
    let value = 0;
    let factor = 1;
    for (let count = 1; ; count++) {
      const byte = this.byte();
      const digits = byte & 127;
      if (count === 8 && (digits > 15 || byte >= 128)) return this.longVarint(value, digits, byte);
      value += digits * factor;
      factor *= 128;
      if (byte < 128) {
        check(count === 1 || byte !== 0, `${this.what}: a number is not in its shortest form`);
        return value;
      }
    }
  }

  /** Reads the rest of a varint from its eighth byte on. */
  private longVarint(low: number, digits: number, byte: number): bigint {
    let value = BigInt(low) | (BigInt(digits) << 49n);
    if (byte >= 128) {
      const last = this.byte();
      check(last > 0 && last < 128, `${this.what}: a number is too long`);
      value |= BigInt(last) << 56n;
    }
    return value;
  }

  /** A signed number: 0, −1, 1, −2, … are stored as the varints 0, 1, 2, 3, … */
  folded(): number {
    const number = this.varint();
    return number % 2 ? -(number + 1) / 2 : number / 2;
  }

  /** A signed number within limits. */
  foldedWithin(least: number, greatest: number, name: string): number {
    const value = this.folded();
    check(value >= least && value <= greatest, `${this.what}: ${name} is ${value}`);
    return value;
  }

  /** A varint within limits. */
  varintWithin(least: number, greatest: number, name: string): number {
    const value = this.varint();
    check(value >= least && value <= greatest, `${this.what}: ${name} is ${value}`);
    return value;
  }

  blob(): Uint8Array {
    return this.take(this.varint());
  }

  string(): string {
    return text(this.blob());
  }

  uint32(): number {
    this.take(4);
    return this.view.getUint32(this.at - 4, true);
  }

  int32(): number {
    return this.uint32() | 0;
  }

  float64(): number {
    this.take(8);
    return this.view.getFloat64(this.at - 8, true);
  }

  end(): void {
    check(this.left === 0, `${this.what}: ${this.left} bytes are left over`);
  }
}

const UTF8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

/** Text in UTF-8. Lone surrogates, which TextDecoder refuses, are decoded as UTF-8 would encode them. */
export function text(bytes: Uint8Array): string {
  try {
    return UTF8.decode(bytes);
  } catch {
    return textWithSurrogates(bytes);
  }
}

function textWithSurrogates(bytes: Uint8Array): string {
  let result = "";
  let plain = 0;
  for (let i = 0; i + 2 < bytes.length; i++) {
    if (bytes[i] === 0xed && (bytes[i + 1]! & 0xe0) === 0xa0 && (bytes[i + 2]! & 0xc0) === 0x80) {
      result += strict(bytes.subarray(plain, i));
      result += String.fromCharCode(0xd000 | ((bytes[i + 1]! & 63) << 6) | (bytes[i + 2]! & 63));
      plain = i + 3;
      i += 2;
    }
  }
  return result + strict(bytes.subarray(plain));
}

function strict(bytes: Uint8Array): string {
  try {
    return UTF8.decode(bytes);
  } catch {
    throw new Corrupt("a string is not UTF-8");
  }
}

/** Reads bits, the highest of each byte first. */
export class Bits {
  at = 0;

  constructor(
    readonly data: Uint8Array,
    readonly what: string,
  ) {}

  get left(): number {
    return 8 * this.data.length - this.at;
  }

  bit(): number {
    check(this.at < 8 * this.data.length, `${this.what}: too few bits`);
    const bit = (this.data[this.at >> 3]! >> (7 - (this.at & 7))) & 1;
    this.at++;
    return bit;
  }

  /** The number in the next `count` bits (at most 53), highest bit first. */
  number(count: number): number {
    check(count <= this.left, `${this.what}: too few bits`);
    let value = 0;
    let remaining = count;
    while (remaining > 0) {
      const within = 8 - (this.at & 7);
      const step = Math.min(within, remaining);
      const part = (this.data[this.at >> 3]! >> (within - step)) & ((1 << step) - 1);
      value = value * (1 << step) + part;
      this.at += step;
      remaining -= step;
    }
    return value;
  }

  /** Checks the unused bits at the end: fewer than 8, all 0. */
  end(): void {
    check(this.left < 8, `${this.what}: ${this.left} bits are left over`);
    while (this.left) check(this.bit() === 0, `${this.what}: a padding bit is not 0`);
  }
}

/** CRC-32 as in zlib and PNG. */
export function crc32(...parts: Uint8Array[]): number {
  let crc = 0xffffffff;
  for (const part of parts) {
    for (let i = 0; i < part.length; i++) crc = (crc >>> 8) ^ CRC_TABLE[(crc ^ part[i]!) & 255]!;
  }
  return ~crc >>> 0;
}

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let crc = byte;
  for (let i = 0; i < 8; i++) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  return crc >>> 0;
});

/** A float16 from its bits. */
export function half(bits: number): number {
  const exponent = (bits >> 10) & 31;
  const mantissa = bits & 1023;
  const magnitude = exponent === 0 ? mantissa * 2 ** -24 : exponent === 31 ? (mantissa ? NaN : Infinity) : (1024 + mantissa) * 2 ** (exponent - 25);
  return bits & 0x8000 ? -magnitude : magnitude;
}
