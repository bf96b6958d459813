/** Arrays of the extras (docs/format.md, "Extras"). */

import { type Bytes, half } from "../bytes.js";
import { Corrupt, check } from "../errors.js";
import { inflate } from "../inflate.js";
import { inflateLzma2 } from "../lzma2.js";
import { StoredArray, itemSize, readShape, sizeOf } from "./values.js";

/** Reads an array of at most `limit` unpacked bytes. */
export function readArray(part: Bytes, limit: number): StoredArray {
  const array = new StoredArray("", [], new Uint8Array(0));
  fillArray(array, part, limit);
  return array;
}

/** Reads an array into a placeholder; returns its unpacked bytes. */
export function fillArray(array: StoredArray, part: Bytes, limit: number): number {
  array.dtype = part.string();
  const width = itemSize(array.dtype);
  array.shape = readShape(part);
  const size = width * sizeOf(array.shape);
  check(size <= limit, `${part.what}: an array of ${size} bytes`);
  const form = part.byte();
  const coder = form & 3;
  const transform = form >> 2;
  check(transform <= 3, `${part.what}: a reserved transform`);
  if (coder === 3) {
    check(transform === 0, `${part.what}: a constant with a transform`);
    array.bytes = repeated(size ? part.take(width) : new Uint8Array(0), size);
    return size;
  }
  const step = transform === 3 ? part.float64() : 1;
  const stored = transform === 3 ? 4 * sizeOf(array.shape) : size;
  check(stored <= 2 * limit + 4096, `${part.what}: an array of ${stored} bytes`);
  const bytes = decompressed(part.blob(), coder, stored);
  array.bytes = untransformed(bytes, array, transform, step);
  return Math.max(size, stored);
}

function repeated(item: Uint8Array, size: number): Uint8Array {
  const bytes = new Uint8Array(size);
  for (let at = 0; at < size; at += item.length) bytes.set(item, at);
  return bytes;
}

function decompressed(data: Uint8Array, coder: number, size: number): Uint8Array {
  const bytes = coder === 0 ? data : coder === 1 ? inflate(data, size) : inflateLzma2(data, size);
  check(bytes.length === size, "extras: an array of a wrong size");
  return bytes;
}

/** Items as in memory: undoes transposition, byte planes, differences and steps. */
function untransformed(bytes: Uint8Array, array: StoredArray, transform: number, step: number): Uint8Array {
  if (transform === 0) return bytes.slice();
  const kind = array.dtype[1]!;
  check(kind !== "S" && (transform !== 3 || kind === "f"), "extras: a transform that this type does not have");
  const width = transform === 3 ? 4 : itemSize(array.dtype) / (kind === "c" ? 2 : kind === "U" ? Math.max(1, itemSize(array.dtype) / 4) : 1);
  if (bytes.length === 0 || array.shape.length === 0) return transform === 3 ? scaled(bytes, array, step) : bytes.slice();
  const count = bytes.length / width;
  const rows = array.shape[0]!;
  const others = count / rows;
  const out = new Uint8Array(bytes.length);
  const last = array.dtype[0] === ">" && transform !== 3;
  for (let digit = 0; digit < width; digit++) {
    const plane = digit * count;
    const place = last ? width - 1 - digit : digit;
    for (let other = 0; other < others; other++) {
      for (let row = 0; row < rows; row++) out[(row * others + other) * width + place] = bytes[plane + other * rows + row]!;
    }
  }
  if (transform >= 2) accumulate(out, rows, others, width, last);
  return transform === 3 ? scaled(out, array, step) : out;
}

/** Cumulative sums along the first axis, modulo 2^bits of a number. */
function accumulate(out: Uint8Array, rows: number, others: number, width: number, bigEndian: boolean): void {
  for (let i = others; i < rows * others; i++) {
    let carry = 0;
    for (let digit = 0; digit < width; digit++) {
      const place = bigEndian ? width - 1 - digit : digit;
      const sum = out[i * width + place]! + out[(i - others) * width + place]! + carry;
      out[i * width + place] = sum & 255;
      carry = sum >> 8;
    }
  }
}

/** Transform 3: converts 32-bit integers, multiples of a step, to floats of the array's type. */
function scaled(bytes: Uint8Array, array: StoredArray, step: number): Uint8Array {
  const width = itemSize(array.dtype);
  const little = array.dtype[0] !== ">";
  const count = bytes.length / 4;
  const from = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  const out = new DataView(new ArrayBuffer(count * width));
  for (let i = 0; i < count; i++) {
    const value = from.getInt32(4 * i, true) * step;
    if (width === 8) out.setFloat64(8 * i, value, little);
    else if (width === 4) out.setFloat32(4 * i, value, little);
    else throw new Corrupt("extras: a transform that this type does not have");
  }
  return new Uint8Array(out.buffer);
}

/** The items of a numeric array (kinds b, i, u, f) as float64, last axis fastest. 64-bit integers are rounded. */
export function toNumbers(array: StoredArray): Float64Array {
  const kind = array.dtype[1]!;
  const width = itemSize(array.dtype);
  const little = array.dtype[0] !== ">";
  const view = new DataView(array.bytes.buffer, array.bytes.byteOffset, array.bytes.length);
  const read = numberReader(kind, width);
  check(read !== undefined, `extras: numbers of the type ${array.dtype}`);
  return Float64Array.from({ length: array.bytes.length / width }, (_, i) => read(view, i * width, little));
}

type NumberReader = (view: DataView, at: number, little: boolean) => number;

function numberReader(kind: string, width: number): NumberReader | undefined {
  const readers: Record<string, NumberReader> = {
    b1: (view, at) => view.getUint8(at),
    u1: (view, at) => view.getUint8(at),
    i1: (view, at) => view.getInt8(at),
    u2: (view, at, little) => view.getUint16(at, little),
    i2: (view, at, little) => view.getInt16(at, little),
    u4: (view, at, little) => view.getUint32(at, little),
    i4: (view, at, little) => view.getInt32(at, little),
    u8: (view, at, little) => Number(view.getBigUint64(at, little)),
    i8: (view, at, little) => Number(view.getBigInt64(at, little)),
    f2: (view, at, little) => half(view.getUint16(at, little)),
    f4: (view, at, little) => view.getFloat32(at, little),
    f8: (view, at, little) => view.getFloat64(at, little),
  };
  return readers[`${kind}${width}`];
}
