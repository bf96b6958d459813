/** An open file: its header facts and its frames. */

import { chunkDecoder } from "./codecs/index.js";
import type { Body } from "./codecs/bodies.js";
import type { Cloud, PointDecoder } from "./codecs/clouds/cloud.js";
import type { ChunkDecoder, Decoded, StoredChunk } from "./codecs/codec.js";
import { type PriorLoader, bundledPriors } from "./codecs/tempo/prior.js";
import { type ChunkPlace, type Header, chunksStart, payloadOf, readHeader, readIndex, walkChunks } from "./container/header.js";
import type { Skeleton } from "./container/skeleton.js";
import type { Tree } from "./container/values.js";
import { BadInput, Corrupt, FrameOutOfRange, MocodecError, Truncated, Unsupported } from "./errors.js";
import type { Extras } from "./extras.js";
import { type ByteSource, type Source, byteSource } from "./sources.js";

export interface OpenOptions {
  /** Loads priors by their identifier (8 hexadecimal digits); default: those of the package. */
  priors?: PriorLoader;
  /** Passed to fetch: headers, credentials, signal. */
  request?: RequestInit;
  /** Without a usable index, scan the chunks; damaged chunks become gaps, listed in `damage`. */
  salvage?: boolean;
}

/** Facts from the header and index; reading them decodes no frames. */
export interface Info {
  kind: "motion" | "clouds";
  codec: string;
  /** Bytes of the whole file. */
  bytes: number;
  frames: number;
  /** Frames a second. */
  rate: number;
  /** Seconds: frames / rate. */
  duration: number;
  /** The vertical axis. Positions are in metres, in the axes of the source. */
  up: "x" | "y" | "z";
  /** Names of the points. */
  names: string[];
  /** Point clouds only. */
  colours: boolean;
  normals: boolean;
  skeleton: Skeleton | undefined;
  /** Whether the file has rotations of the joints. */
  rotations: boolean;
  /** Settings of the encoder that differ from its defaults. */
  settings: Tree;
  /** Error bound that the file promises, metres; undefined without one. */
  maxError: number | undefined;
  /** Facts about the original file: format, units, metres in a unit, … */
  source: Tree;
  chunks: ChunkPlace[];
  /** Neighbouring chunks on each side that a chunk needs. */
  margin: number;
  /** Bytes of the extras section, of its unpacked content, and of the coded signals. */
  extras: { section: number; unpacked: number; signals: number };
}

/** A run of frames that could not be decoded. */
export interface Damage {
  start: number;
  frames: number;
  error: MocodecError;
}

/** Size of the cache of decoded chunks: short reads in sequence decode each chunk once. */
const KEPT_CHUNKS = 4;
/** Most numbers that one call returns: 2 GiB. */
const MOST_VALUES = 2 ** 28;

/** Opens a `.mocz` file: a URL (read by range requests), a Blob or File, or bytes. */
export async function open(source: Source, options: OpenOptions = {}): Promise<MoczFile> {
  const bytes = await byteSource(source, options.request);
  const { header, end } = await readHeader(bytes);
  const first = chunksStart(header, end);
  let chunks: ChunkPlace[];
  try {
    chunks = await readIndex(bytes, header, first);
  } catch (error) {
    if (!options.salvage || !(error instanceof MocodecError)) throw error;
    chunks = await walkChunks(bytes, header, first);
  }
  return new MoczFile(bytes, header, end, chunks, options.priors ?? bundledPriors, options.salvage ?? false);
}

export class MoczFile {
  readonly info: Info;
  /** Frames that became gaps because their chunks are damaged; filled only with `salvage`. */
  readonly damage: Damage[] = [];
  private decoder: Promise<ChunkDecoder> | undefined;
  private readonly decoded = new Map<number, Decoded>();
  private pointDecoder: PointDecoder | undefined;
  /** The last read chunk of clouds. */
  private cloudsOfChunk: CloudChunk | undefined;

  constructor(
    private readonly source: ByteSource,
    private readonly header: Header,
    private readonly headerEnd: number,
    private readonly chunks: ChunkPlace[],
    private readonly priors: PriorLoader,
    private readonly salvage: boolean,
  ) {
    const last = chunks.at(-1);
    const frames = last ? last.start + last.frames : 0;
    const { codec, rate, names, channels, skeleton, rotations, settings, margin, extras } = header;
    const maxError = settings["max_error"];
    this.info = {
      kind: header.kind,
      codec,
      bytes: source.size,
      frames,
      rate,
      duration: frames / rate,
      up: (["x", "y", "z"] as const)[header.up]!,
      names,
      colours: (channels & 1) === 1,
      normals: (channels & 2) === 2,
      skeleton,
      rotations,
      settings,
      maxError: typeof maxError === "number" ? maxError : undefined,
      source: header.source,
      chunks,
      margin,
      extras,
    };
  }

  /** Positions of frames a … b − 1: (b − a, points, 3) in metres, row by row; NaN in gaps. Throws FrameOutOfRange. */
  async frames(a = 0, b = this.info.frames): Promise<Float64Array> {
    return this.joined(a, b, 3 * this.info.names.length, (decoded) => decoded.positions);
  }

  /** Local rotations of frames a … b − 1: (b − a, joints, 4), quaternions, w first. Throws BadInput without rotations. */
  async rotations(a = 0, b = this.info.frames): Promise<Float64Array> {
    if (!this.info.rotations) throw new BadInput("the file has no rotations");
    return this.joined(a, b, 4 * this.info.names.length, (decoded) => decoded.rotations);
  }

  /**
   * Bodies of point clouds (`lien2006` and `bodycast`), and the poses of each body in frames a … b − 1, (b − a, links, 2, 3): origin and
   * tip of each link in metres, NaN in frames without the body. Throws BadInput for motions.
   */
  async poses(a = 0, b = this.info.frames): Promise<{ bodies: Body[]; poses: Float64Array[] }> {
    const { codec } = this.info;
    if (codec !== "lien2006" && codec !== "bodycast") throw new BadInput("the file has no bodies");
    this.checkRange(a, b);
    const { poseDecoder } = await import("./codecs/bodies.js");
    const decoder = poseDecoder(codec, this.header.shared);
    const poses = decoder.bodies.map((body) => new Float64Array(6 * body.parents.length * (b - a)));
    for (let i = this.chunkOf(a); i < this.chunks.length && this.chunks[i]!.start < b; i++) {
      const place = this.chunks[i]!;
      const payload = payloadOf(await this.source.read(place.offset, place.size), place, i);
      decoder.decode({ frames: place.frames, payload }).forEach((values, body) => {
        const lanes = values.length / place.frames;
        const [from, to] = [Math.max(a, place.start), Math.min(b, place.start + place.frames)];
        poses[body]!.set(values.subarray((from - place.start) * lanes, (to - place.start) * lanes), (from - a) * lanes);
      });
    }
    return { bodies: decoder.bodies, poses };
  }

  /**
   * Point clouds: yields frames a … b − 1 as they are decoded. Read in order: a frame may need the earlier frames of its chunk. Throws
   * BadInput for motions, and Unsupported for pictures of other encoders.
   */
  async *clouds(a = 0, b = this.info.frames): AsyncGenerator<Cloud> {
    if (this.info.kind !== "clouds") throw new BadInput("the file has no point clouds");
    this.checkRange(a, b);
    this.pointDecoder ??= await this.newPointDecoder();
    for (let i = this.chunkOf(a); i < this.chunks.length && this.chunks[i]!.start < b; i++) {
      const place = this.chunks[i]!;
      if (this.cloudsOfChunk?.number !== i) {
        const bytes = await this.source.read(place.offset, place.size);
        this.cloudsOfChunk = { number: i, decoded: [], rest: cloudsOf(this.pointDecoder, bytes, place, i) };
      }
      const chunk = this.cloudsOfChunk;
      const from = Math.max(a, place.start);
      for (let frame = from; frame < Math.min(b, place.start + place.frames); frame++) yield this.cloudOf(chunk, place, frame - place.start);
    }
  }

  private async newPointDecoder(): Promise<PointDecoder> {
    const { codec, colours } = this.info;
    const { shared } = this.header;
    if (codec === "bodycast") return new (await import("./codecs/clouds/bodycast.js")).BodycastPoints(shared, colours);
    if (codec === "lien2006") return new (await import("./codecs/clouds/lien2006.js")).LienPoints(shared);
    throw new BadInput("the file has no point clouds");
  }

  private cloudOf({ decoded, rest }: CloudChunk, { start, frames }: ChunkPlace, frame: number): Cloud {
    try {
      while (decoded.length <= frame) {
        const next = rest.next();
        if (next.done) throw new Corrupt("a chunk could not be decoded");
        decoded.push(next.value);
        if (decoded.length === frames) rest.next(); // checks that no bytes are left
      }
    } catch (error) {
      this.cloudsOfChunk = undefined;
      if (!this.salvage || !(error instanceof Corrupt || error instanceof Truncated)) throw error;
      this.damage.push({ start: start + decoded.length, frames: frames - decoded.length, error });
      while (decoded.length < frames) decoded.push({ positions: new Float64Array(0), ...(this.info.colours && { colours: new Uint8Array(0) }) });
    }
    return decoded[frame]!;
  }

  /** All content besides the points: parameters, events, arrays and signals. */
  async extras(): Promise<Extras> {
    const { readExtras } = await import("./extras.js");
    return readExtras(this.source, this.header, this.headerEnd);
  }

  /**
   * Frames at which a "clip" (`hou2014`), a "segment" or a "key frame" (`liu2006`) begins, by kind. Reads all chunks and decodes no
   * positions; with `salvage`, damaged chunks have none.
   */
  async marks(): Promise<Record<string, number[]>> {
    const found: Record<string, number[]> = {};
    if (this.header.kind === "clouds") return found;
    const decoder = await this.chunkDecoder();
    for (const [i, place] of (decoder.marks ? this.chunks : []).entries()) {
      try {
        const payload = payloadOf(await this.source.read(place.offset, place.size), place, i);
        for (const [label, frames] of Object.entries(decoder.marks!({ frames: place.frames, payload }))) {
          (found[label] ??= []).push(...frames.map((frame) => place.start + frame));
        }
      } catch (error) {
        if (!this.salvage || !(error instanceof Corrupt || error instanceof Truncated)) throw error;
      }
    }
    return found;
  }

  private chunkDecoder(): Promise<ChunkDecoder> {
    return (this.decoder ??= chunkDecoder(this.header.codec, { ...this.header, points: this.header.names.length }, this.priors));
  }

  private async joined(a: number, b: number, lanes: number, part: (decoded: Decoded) => Float64Array | undefined): Promise<Float64Array> {
    this.checkRange(a, b);
    if (this.header.kind === "clouds") throw new Unsupported("point clouds have no named points; see clouds() and poses()");
    if ((b - a) * lanes > MOST_VALUES) throw new BadInput(`${b - a} frames at once are too many: ask for fewer`);
    const result = new Float64Array((b - a) * lanes);
    const first = this.chunkOf(a);
    const window = await this.window(first, b);
    for (let i = first; i < this.chunks.length && this.chunks[i]!.start < b; i++) {
      const { start, frames: count } = this.chunks[i]!;
      const values = part(await this.decode(i, window));
      const from = Math.max(a, start);
      const to = Math.min(b, start + count);
      if (!values) result.fill(NaN, (from - a) * lanes, (to - a) * lanes);
      else result.set(values.subarray((from - start) * lanes, (to - start) * lanes), (from - a) * lanes);
    }
    return result;
  }

  private checkRange(a: number, b: number): void {
    const { frames } = this.info;
    if (!(Number.isInteger(a) && Number.isInteger(b) && a >= 0 && a <= b && b <= frames)) {
      throw new FrameOutOfRange(`frames ${a} to ${b} of a file of ${frames} frames`);
    }
  }

  /** The number of the chunk of a frame. */
  private chunkOf(frame: number): number {
    let low = 0;
    let high = this.chunks.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.chunks[middle]!.start <= frame) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Reads in one request the chunks that frames up to `end` need, from chunk `first` on, except cached chunks. */
  private async window(first: number, end: number): Promise<Window> {
    const kept = new Map(this.decoded);
    const needed: number[] = [];
    for (let i = first; i < this.chunks.length && this.chunks[i]!.start < end; i++) if (!kept.has(i)) needed.push(i);
    if (needed.length === 0) return { kept, offset: 0, bytes: new Uint8Array(0) };
    const from = Math.max(0, needed[0]! - this.info.margin);
    const to = Math.min(this.chunks.length - 1, needed.at(-1)! + this.info.margin);
    const { offset } = this.chunks[from]!;
    const { offset: lastOffset, size } = this.chunks[to]!;
    return { kept, offset, bytes: await this.source.read(offset, lastOffset + size - offset) };
  }

  private async decode(number: number, window: Window): Promise<Decoded> {
    const kept = window.kept.get(number);
    if (kept) return kept;
    const decoder = await this.chunkDecoder();
    const from = Math.max(0, number - this.info.margin);
    const to = Math.min(this.chunks.length - 1, number + this.info.margin);
    const { frames, start } = this.chunks[number]!;
    let decoded: Decoded;
    try {
      const stored: StoredChunk[] = [];
      for (let i = from; i <= to; i++) stored.push({ frames: this.chunks[i]!.frames, payload: this.payload(i, window) });
      decoded = decoder.decode(stored, number - from);
    } catch (error) {
      if (!this.salvage || !(error instanceof MocodecError)) throw error;
      this.damage.push({ start, frames, error });
      decoded = { positions: new Float64Array(3 * frames * this.info.names.length).fill(NaN) };
    }
    this.decoded.set(number, decoded);
    if (this.decoded.size > KEPT_CHUNKS) this.decoded.delete(this.decoded.keys().next().value!);
    return decoded;
  }

  private payload(number: number, window: Window): Uint8Array {
    const place = this.chunks[number]!;
    const at = place.offset - window.offset;
    return payloadOf(window.bytes.subarray(at, at + place.size), place, number);
  }
}

/** Bytes of consecutive chunks, and the cached decoded chunks. */
interface Window {
  kept: Map<number, Decoded>;
  offset: number;
  bytes: Uint8Array;
}

/** A chunk of point clouds: decoded frames, and a generator of the rest. */
interface CloudChunk {
  number: number;
  decoded: Cloud[];
  rest: Generator<Cloud>;
}

function* cloudsOf(decoder: PointDecoder, bytes: Uint8Array, place: ChunkPlace, number: number): Generator<Cloud> {
  yield* decoder.decode({ frames: place.frames, payload: payloadOf(bytes, place, number) });
}
