/** Reads .npz files: ZIP files of NumPy arrays. Arrays are unpacked at their first use. */

import { Bytes, half, text } from "../../bytes.js";
import { check } from "../../errors.js";
import { inflate } from "../../inflate.js";

export interface Numbers {
  shape: number[];
  data: Float64Array;
}

interface Entry {
  offset: number;
  method: number;
  packed: number;
  size: number;
}

const END_RECORD = 0x06054b50;
const CENTRAL = 0x02014b50;

export class Npz {
  private readonly entries = new Map<string, Entry>();
  private readonly numbersOf = new Map<string, Numbers>();

  constructor(private readonly bytes: Uint8Array) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
    let end = bytes.length - 22;
    while (end >= 0 && view.getUint32(end, true) !== END_RECORD) end--;
    check(end >= 0, "a prior: no .npz file");
    let at = view.getUint32(end + 16, true);
    for (let count = view.getUint16(end + 10, true); count > 0; count--) {
      check(at + 46 <= bytes.length && view.getUint32(at, true) === CENTRAL, "a prior: a damaged .npz file");
      const nameBytes = view.getUint16(at + 28, true);
      const name = text(bytes.subarray(at + 46, at + 46 + nameBytes));
      this.entries.set(name.replace(/\.npy$/, ""), {
        offset: view.getUint32(at + 42, true),
        method: view.getUint16(at + 10, true),
        packed: view.getUint32(at + 20, true),
        size: view.getUint32(at + 24, true),
      });
      at += 46 + nameBytes + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
    }
  }

  has(name: string): boolean {
    return this.entries.has(name);
  }

  /** A numeric array as float64. */
  numbers(name: string): Numbers {
    let found = this.numbersOf.get(name);
    if (!found) this.numbersOf.set(name, (found = toNumbers(this.array(name))));
    return found;
  }

  /** An array of strings. */
  texts(name: string): string[] {
    const { descr, shape, data } = this.array(name);
    const width = Number(/^<U(\d+)$/.exec(descr)?.[1] ?? 0);
    check(width > 0, "a prior: an array that is not text");
    const part = new Bytes(data, "a prior");
    return Array.from({ length: shape[0] ?? 1 }, () => {
      const codes = Array.from({ length: width }, () => part.uint32());
      return String.fromCodePoint(...codes.filter((code) => code !== 0));
    });
  }

  private array(name: string): { descr: string; shape: number[]; data: Uint8Array } {
    const entry = this.entries.get(name);
    check(entry !== undefined, `a prior: no array ${name}`);
    const view = new DataView(this.bytes.buffer, this.bytes.byteOffset, this.bytes.length);
    check(entry.offset + 30 <= this.bytes.length, "a prior: a damaged .npz file");
    const start = entry.offset + 30 + view.getUint16(entry.offset + 26, true) + view.getUint16(entry.offset + 28, true);
    const packed = this.bytes.subarray(start, start + entry.packed);
    const file = entry.method === 8 ? inflate(packed, entry.size) : packed;
    const part = new Bytes(file, "a prior");
    const major = part.take(8)[6]!;
    const headerBytes = part.take(major === 1 ? 2 : 4).reduceRight((value, byte) => value * 256 + byte, 0);
    const header = text(part.take(headerBytes));
    const descr = /'descr': '([^']+)'/.exec(header)?.[1];
    const extents = /'shape': \(([^)]*)\)/.exec(header)?.[1];
    check(descr !== undefined && extents !== undefined && header.includes("'fortran_order': False"), "a prior: a damaged array");
    const shape = extents.split(",").filter((extent) => extent.trim()).map(Number);
    return { descr, shape, data: part.rest() };
  }
}

function toNumbers({ descr, shape, data }: { descr: string; shape: number[]; data: Uint8Array }): Numbers {
  const count = shape.reduce((product, extent) => product * extent, 1);
  const width = Number(descr.slice(2));
  check(data.length === count * width, "a prior: an array of a wrong size");
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const readers: Record<string, (at: number) => number> = {
    f2: (at) => half(view.getUint16(at, true)),
    f4: (at) => view.getFloat32(at, true),
    f8: (at) => view.getFloat64(at, true),
    i2: (at) => view.getInt16(at, true),
    u2: (at) => view.getUint16(at, true),
    b1: (at) => view.getUint8(at),
  };
  const read = readers[descr.slice(1)];
  check(read !== undefined, `a prior: numbers of the type ${descr}`);
  return { shape, data: Float64Array.from({ length: count }, (_, i) => read(i * width)) };
}
