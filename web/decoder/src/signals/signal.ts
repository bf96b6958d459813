/** Signals of the extras: analog channels, residuals, angles. Samples are read on demand. */

import { Bytes, crc32 } from "../bytes.js";
import { toNumbers } from "../container/arrays.js";
import { type CodedSignal, StoredArray, type StoredSignal, type Tree, type Value, itemSize } from "../container/values.js";
import { BadInput, check } from "../errors.js";
import { inflate } from "../inflate.js";
import type { ByteSource } from "../sources.js";
import { readChunk } from "./chunk.js";
import { type Form, type ItemType, readForms } from "./forms.js";

const MOST_CHUNK_SAMPLES = 2 ** 16;
const MOST_CHUNK_BYTES = 2 ** 28;
const CHECKSUM_BYTES = 4;

/** A signal beside the points. */
export interface Signal {
  /** Path in the tree of extras: keys, joined by dots. */
  path: string;
  /** Samples a second. */
  rate: number;
  labels: string[];
  units: string[];
  /** A NumPy type string. */
  dtype: string;
  /** Samples, then the axes of the channels. */
  shape: number[];
  /** Samples a … b − 1 as float64: (b − a, channels), row by row. */
  read(a?: number, b?: number): Promise<Float64Array>;
}

/** Layout of a coded signal. */
interface Head {
  chunkSamples: number;
  forms: Form[];
  sizes: number[];
}

/** A coded signal's head, and the place of its chunks in the file. */
export interface CodedPlace {
  head: Head;
  offset: number;
  type: ItemType;
}

export function itemType(dtype: string): ItemType {
  check(/^[<>|][biuf]\d$/.test(dtype), `extras: a signal of the type ${dtype}`);
  return { kind: dtype[1]!, width: itemSize(dtype), little: dtype[0] !== ">" };
}

/** Reads the head of a coded signal from the extras section. bytes: size of its chunks. */
export function readHead(part: Bytes, signal: CodedSignal): { head: Head; bytes: number; type: ItemType } {
  const type = itemType(signal.dtype);
  const channels = signal.shape.slice(1).reduce((product, extent) => product * extent, 1);
  const samples = signal.shape[0]!;
  const length = part.varintWithin(0, MOST_CHUNK_BYTES, "the length of a head");
  const fields = new Bytes(inflate(part.blob(), length), "signals");
  check(fields.data.length === length && channels <= length, "signals: a head of a wrong size");
  const chunkSamples = fields.varintWithin(1, Math.min(MOST_CHUNK_SAMPLES, samples), "the samples of a chunk");
  check(chunkSamples * channels * type.width <= MOST_CHUNK_BYTES, "signals: a chunk that is too large");
  const forms = readForms(fields, type, channels);
  const count = Math.ceil(samples / chunkSamples);
  check(count <= fields.left, "signals: too few chunks");
  const sizes = Array.from({ length: count }, () => fields.varint());
  fields.end();
  return { head: { chunkSamples, forms, sizes }, bytes: sizes.reduce((sum, size) => sum + size + CHECKSUM_BYTES, 0), type };
}

/** All signals of a tree. placeOf: heads and chunks of coded signals. */
export function signalsOf(tree: Tree, source: ByteSource, placeOf: Map<CodedSignal, CodedPlace>): Signal[] {
  const found: Signal[] = [];
  const visit = (value: Value, path: string): void => {
    if (value === null || typeof value !== "object" || value instanceof Uint8Array || value instanceof StoredArray) return;
    if (isSignal(value)) found.push(signalOf(value, path, source, placeOf));
    else if (Array.isArray(value)) value.forEach((item, i) => visit(item, `${path}.${i}`));
    else for (const key of Object.keys(value)) visit((value as Tree)[key]!, path ? `${path}.${key}` : key);
  };
  visit(tree, "");
  return found;
}

function isSignal(value: object): value is StoredSignal | CodedSignal {
  return "rate" in value && "units" in value && Object.getPrototypeOf(value) !== null && !Array.isArray(value);
}

function signalOf(signal: StoredSignal | CodedSignal, path: string, source: ByteSource, placeOf: Map<CodedSignal, CodedPlace>): Signal {
  const { rate, labels, units } = signal;
  if ("samples" in signal) {
    const { dtype, shape } = signal.samples;
    return { path, rate, labels, units, dtype, shape, read: async (a, b) => slice(toNumbers(signal.samples), shape, a, b) };
  }
  const { dtype, shape } = signal;
  return { path, rate, labels, units, dtype, shape, read: (a, b) => readCoded(source, placeOf.get(signal)!, shape, a, b) };
}

function checkRange(shape: number[], a = 0, b = shape[0]!): [number, number] {
  if (!(Number.isInteger(a) && Number.isInteger(b) && a >= 0 && a <= b && b <= shape[0]!)) {
    throw new BadInput(`samples ${a} to ${b} of a signal of ${shape[0]} samples`);
  }
  return [a, b];
}

function slice(values: Float64Array, shape: number[], a?: number, b?: number): Float64Array {
  const [from, to] = checkRange(shape, a, b);
  const channels = shape[0] ? values.length / shape[0] : 0;
  return values.slice(from * channels, to * channels);
}

async function readCoded(source: ByteSource, { head, offset, type }: CodedPlace, shape: number[], a?: number, b?: number): Promise<Float64Array> {
  const [from, to] = checkRange(shape, a, b);
  const { chunkSamples, forms, sizes } = head;
  const channels = forms.length;
  const out = new Float64Array((to - from) * channels);
  let at = offset;
  for (let i = 0; i < sizes.length; i++) {
    const start = i * chunkSamples;
    const count = Math.min(chunkSamples, shape[0]! - start);
    if (start < to && start + count > from) {
      const bytes = await source.read(at, sizes[i]! + CHECKSUM_BYTES);
      const payload = bytes.subarray(0, sizes[i]!);
      check(crc32(payload) === new Bytes(bytes.subarray(sizes[i]!), "a checksum").uint32(), `chunk ${i} of a signal is damaged`);
      const items = readChunk(payload, forms, type, count);
      const numbers = toNumbers(new StoredArray(`${type.little ? "<" : ">"}${type.kind}${type.width}`, [count, channels], items));
      const [first, last] = [Math.max(from, start), Math.min(to, start + count)];
      out.set(numbers.subarray((first - start) * channels, (last - start) * channels), (first - from) * channels);
    }
    at += sizes[i]! + CHECKSUM_BYTES;
  }
  return out;
}
