/** The header of a file, its index and its chunks (docs/format.md). */

import { Bytes, crc32 } from "../bytes.js";
import { BadInput, Corrupt, MocodecError, TooNew, Truncated, UnknownCodec, check } from "../errors.js";
import type { ByteSource } from "../sources.js";
import { readNames } from "./names.js";
import { type Skeleton, readSkeleton } from "./skeleton.js";
import { CODECS, RATES } from "./tables.js";
import { type Tree, readSource, readTree } from "./values.js";

const VERSION = 1;
const MAGIC = [0x6d, 0x6f, 0x63, 0x7a];
const END_MAGIC = [0x63, 0x7a];
const MOST_HEADER_BYTES = 2 ** 28;
const MOST_PAYLOAD_BYTES = 2 ** 30;
const MOST_SAMPLES = 2 ** 22;
const CLOUD_SAMPLES = 256;
const MOST_FRAMES = 2 ** 40;
const MOST_MARGIN = 8;
const CHECKSUM_BYTES = 4;
const MOST_CHUNK_HEAD_BYTES = 18;
const MOST_TAIL_BYTES = 11;

export interface Header {
  kind: "motion" | "clouds";
  /** The vertical axis: 0 x, 1 y, 2 z. */
  up: number;
  codec: string;
  rate: number;
  margin: number;
  names: string[];
  channels: number;
  skeleton: Skeleton | undefined;
  rotations: boolean;
  settings: Tree;
  source: Tree;
  /** Bytes of the extras section without its checksum, of its unpacked content, and of the signals after it; 0: none. */
  extras: { section: number; unpacked: number; signals: number };
  shared: Uint8Array[];
}

/** Position of a chunk in the file. */
export interface ChunkPlace {
  /** Number of its first frame. */
  start: number;
  frames: number;
  /** Byte offset of the chunk, which begins with its head. */
  offset: number;
  /** Bytes of the chunk with head and checksum. */
  size: number;
  payloadBytes: number;
}

/** Reads the header; `end` is the byte offset after its checksum. Throws BadInput, TooNew, Truncated, Corrupt. */
export async function readHeader(source: ByteSource): Promise<{ header: Header; end: number }> {
  const front = await source.read(0, Math.min(source.size, 16));
  if (!MAGIC.every((byte, i) => front[i] === byte)) {
    if (front.every((byte, i) => byte === MAGIC[i])) throw new Truncated(`the file ends after ${front.length} bytes`);
    if (await hasEndMagic(source)) throw new Corrupt("the first bytes of the file are damaged");
    throw new BadInput("this is not a .mocz file");
  }
  const cursor = new Bytes(front, "the header");
  cursor.take(MAGIC.length);
  const { version, length } = await versionAndLength(cursor, source);
  check(length <= MOST_HEADER_BYTES, "the header's length is damaged");
  const end = cursor.at + length + CHECKSUM_BYTES;
  if (end > source.size) {
    if (await hasEndMagic(source)) throw new Corrupt("the header's length is damaged");
    throw new Truncated("the file ends in its header");
  }
  const bytes = await source.read(0, end);
  check(checksumHolds(bytes), "the header is damaged: its checksum does not match");
  if (version > VERSION) throw new TooNew(`format version ${version}; this decoder reads up to version ${VERSION}: upgrade it`);
  check(version > 0, "format version 0, which is reserved");
  const part = new Bytes(bytes.subarray(cursor.at, end - CHECKSUM_BYTES), "the header");
  const header = await readFields(part);
  part.end();
  return { header, end };
}

async function versionAndLength(cursor: Bytes, source: ByteSource): Promise<{ version: number; length: number }> {
  try {
    return { version: cursor.byte(), length: cursor.varint() };
  } catch (error) {
    if (error instanceof MocodecError && cursor.left === 0 && !(await hasEndMagic(source))) throw new Truncated("the file ends in its header");
    throw error;
  }
}

async function hasEndMagic(source: ByteSource): Promise<boolean> {
  if (source.size < END_MAGIC.length) return false;
  const tail = await source.read(source.size - END_MAGIC.length, END_MAGIC.length);
  return END_MAGIC.every((byte, i) => tail[i] === byte);
}

/** Whether the last four bytes are the checksum of the bytes before. */
export function checksumHolds(bytes: Uint8Array): boolean {
  const body = bytes.subarray(0, bytes.length - CHECKSUM_BYTES);
  return bytes.length >= CHECKSUM_BYTES && new Bytes(bytes.subarray(body.length), "a checksum").uint32() === crc32(body);
}

async function readFields(part: Bytes): Promise<Header> {
  const flags = part.byte();
  const up = (flags >> 1) & 3;
  check(up < 3, "the header: a vertical axis that is reserved");
  const isMotion = (flags & 1) === 0;
  const codec = readCodec(part);
  const rate = readRate(part);
  const margin = flags & 8 ? part.varintWithin(0, MOST_MARGIN, "the margin") : 0;
  const names = isMotion ? readNames(part) : [];
  const channels = isMotion ? 0 : part.varintWithin(0, 3, "the channels");
  const skeleton = isMotion && flags & 16 ? await readSkeleton(part, names) : { skeleton: undefined, rotations: false };
  const settings = flags & 32 ? readTree(part) : (Object.create(null) as Tree);
  const source = flags & 64 ? readSource(part) : (Object.create(null) as Tree);
  const extras = flags & 128 ? readSizes(part) : { section: 0, unpacked: 0, signals: 0 };
  const shared: Uint8Array[] = [];
  for (let count = part.varintWithin(0, part.left, "the number of shared blobs"); count > 0; count--) {
    const head = part.varint();
    check(head % 2 === 0, "the header: shared bytes outside the file, which this version does not read");
    shared.push(part.take(head / 2));
  }
  return { kind: isMotion ? "motion" : "clouds", up, codec, rate, margin, names, channels, ...skeleton, settings, source, extras, shared };
}

function readCodec(part: Bytes): string {
  const number = part.varint();
  if (number === 0) return part.string();
  const name = CODECS[number];
  if (name === undefined) throw new UnknownCodec(`the file was made by codec number ${number}, which this decoder does not have`);
  return name;
}

function readRate(part: Bytes): number {
  const number = part.varint();
  check(number < RATES.length, "the header: a frame rate that is reserved");
  if (number) return RATES[number]![0] / RATES[number]![1];
  const denominator = part.varint();
  const rate = denominator ? part.varint() / denominator : part.float64();
  check(rate > 0 && Number.isFinite(rate), "the header: a frame rate that is not positive");
  return rate;
}

function readSizes(part: Bytes): Header["extras"] {
  const section = part.varint();
  if (section) return { section, unpacked: part.varint(), signals: 0 };
  const sizes = { section: part.varint(), unpacked: part.varint(), signals: part.varint() };
  check(sizes.section > 0 && sizes.signals > 0, "the header: the bytes of extras or signals are 0");
  return sizes;
}

/** Byte offset of the first chunk. end: byte offset of the end of the header. */
export function chunksStart(header: Header, end: number): number {
  const { section, signals } = header.extras;
  return end + (section ? section + CHECKSUM_BYTES : 0) + signals;
}

function mostFrames(header: Header): number {
  return Math.floor(MOST_SAMPLES / (header.kind === "clouds" ? CLOUD_SAMPLES : Math.max(1, header.names.length)));
}

/** Positions of all chunks, from the index. Throws Truncated, Corrupt. */
export async function readIndex(source: ByteSource, header: Header, first: number): Promise<ChunkPlace[]> {
  if (first > source.size) throw new Truncated("the file ends before its first chunk");
  const tail = await source.read(Math.max(0, source.size - MOST_TAIL_BYTES), Math.min(MOST_TAIL_BYTES, source.size));
  if (!(await hasEndMagic(source))) throw new Truncated("the file ends too early: its index is missing");
  const backwards = new Bytes(tail.slice(0, -END_MAGIC.length).reverse(), "the index's length");
  const length = backwards.varint();
  const at = source.size - END_MAGIC.length - backwards.at - length;
  check(at >= first && length >= 1 + CHECKSUM_BYTES, "the index's length is damaged");
  const bytes = await source.read(at, length);
  check(checksumHolds(bytes) && bytes[0] === 0, "the index is damaged");
  const part = new Bytes(bytes.subarray(1, -CHECKSUM_BYTES), "the index");
  const frames: number[] = [];
  const lengths: number[] = [];
  if (part.left === 0) {
    const head = new Bytes(await source.read(first, Math.min(MOST_CHUNK_HEAD_BYTES, at - first)), "the only chunk");
    frames.push(head.varint());
    lengths.push(head.varint());
  } else {
    readRuns(part, frames);
    for (let i = 0; i < frames.length; i++) lengths.push(part.varint());
  }
  part.end();
  return placed(frames, lengths, header, first, at);
}

function readRuns(part: Bytes, frames: number[]): void {
  const count = part.varintWithin(0, part.left, "the number of chunks");
  while (frames.length < count) {
    const run = part.varint();
    const each = part.varint();
    check(run > 0 && run <= count - frames.length, "the index: a run of chunks is out of range");
    for (let i = 0; i < run; i++) frames.push(each);
  }
}

function placed(frames: number[], lengths: number[], header: Header, first: number, end: number): ChunkPlace[] {
  const most = mostFrames(header);
  const chunks: ChunkPlace[] = [];
  let start = 0;
  let offset = first;
  frames.forEach((count, i) => {
    check(count >= 1 && count <= most && lengths[i]! <= MOST_PAYLOAD_BYTES, "the index: a chunk is out of range");
    const size = varintBytes(count) + varintBytes(lengths[i]!) + lengths[i]! + CHECKSUM_BYTES;
    chunks.push({ start, frames: count, offset, size, payloadBytes: lengths[i]! });
    start += count;
    offset += size;
  });
  check(offset === end && start <= MOST_FRAMES, "the index does not match the chunks");
  return chunks;
}

/** Positions of the chunks before the first incomplete one, found without the index. */
export async function walkChunks(source: ByteSource, header: Header, first: number): Promise<ChunkPlace[]> {
  const chunks: ChunkPlace[] = [];
  let start = 0;
  for (let offset = first; offset < source.size; ) {
    const head = new Bytes(await source.read(offset, Math.min(MOST_CHUNK_HEAD_BYTES, source.size - offset)), "a chunk");
    let frames: number;
    let payloadBytes: number;
    try {
      frames = head.varint();
      payloadBytes = head.varint();
    } catch {
      break;
    }
    const size = head.at + payloadBytes + CHECKSUM_BYTES;
    if (frames === 0 || frames > mostFrames(header) || payloadBytes > MOST_PAYLOAD_BYTES || offset + size > source.size) break;
    chunks.push({ start, frames, offset, size, payloadBytes });
    start += frames;
    offset += size;
  }
  return chunks;
}

/** The payload of a chunk from its bytes. Throws Corrupt. */
export function payloadOf(bytes: Uint8Array, place: ChunkPlace, number: number): Uint8Array {
  check(checksumHolds(bytes), `chunk ${number} is damaged: its checksum does not match`);
  const head = new Bytes(bytes, `chunk ${number}`);
  check(head.varint() === place.frames && head.varint() === place.payloadBytes, `chunk ${number} does not match the index`);
  return head.take(place.payloadBytes);
}

function varintBytes(value: number): number {
  let bytes = 1;
  for (let rest = Math.floor(value / 128); rest > 0; rest = Math.floor(rest / 128)) bytes++;
  return bytes;
}
