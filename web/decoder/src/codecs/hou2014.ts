/** The codec `hou2014`: a DCT along time and one basis across points (docs/payloads/hou2014.md). Also the fallback of tempo. */

import { Bytes } from "../bytes.js";
import { addCorrections } from "../corrections.js";
import { inverseDct } from "../dct.js";
import { check } from "../errors.js";
import { readIntegers, readIntegersWithin } from "../integers/read.js";
import { loadKernels } from "../kernels.js";
import { Gaps, readBasis, stepOf } from "../stages.js";
import type { ChunkDecoder, Decoded, StoredChunk } from "./codec.js";

const MEAN = 1;
const WEIGHTS = 2;
const BOUND = 4;
const UNIT = 8;
const ALLOCATED = 16;
const ADAPTIVE = 32;
const SHARED = 64;
const MOST_RUNG = 4096;

/** Facts from the header that hou2014 needs. */
export interface HouFacts {
  points: number;
  parents: number[] | undefined;
  shared: Uint8Array[];
}

interface Transform {
  columns: number;
  /** (3 · points, columns). */
  values: Float64Array;
}

interface Clip {
  frames: number;
  frequencies: number;
}

/** Opens the decoder, from the shared bytes. */
export async function openHou2014(facts: HouFacts): Promise<ChunkDecoder> {
  await loadKernels();
  return new Hou2014(facts);
}

class Hou2014 implements ChunkDecoder {
  private readonly flags: number;
  private readonly components: number;
  private readonly rung: number;
  private readonly clipFrames: number;
  private readonly unit: number;
  private readonly maxError: number;
  private readonly weights: Float64Array | undefined;
  private readonly mean: Float64Array;
  private readonly transforms: Transform[];

  constructor(private readonly facts: HouFacts) {
    const { points, shared } = facts;
    const part = new Bytes(shared[0]!, "hou2014");
    this.flags = part.varintWithin(0, 127, "the flags");
    this.components = part.varint();
    this.rung = part.foldedWithin(-MOST_RUNG, MOST_RUNG, "the step");
    this.clipFrames = this.flags & ADAPTIVE ? 0 : part.varint();
    check((this.flags & ADAPTIVE) !== 0 || this.clipFrames >= 1, "hou2014: clips without frames");
    this.unit = this.flags & UNIT ? positive(part.float64()) : 0.01;
    this.maxError = this.flags & BOUND ? positive(part.float64()) : 0;
    if (this.flags & WEIGHTS) {
      this.weights = readIntegersWithin(part.blob(), points, 1, -MOST_RUNG, MOST_RUNG, "hou2014: weights").map(stepOf);
    }
    const meanRung = this.flags & MEAN ? part.foldedWithin(-MOST_RUNG, MOST_RUNG, "the step of the mean pose") : 0;
    const meanStep = this.unit * stepOf(meanRung);
    this.mean = this.flags & MEAN ? readIntegers(part.blob(), points, 3).map((v) => v * meanStep) : new Float64Array(3 * points);
    if (this.flags & SHARED) {
      part.end();
      this.transforms = shared.slice(1).map((blob) => this.readTransform(new Bytes(blob, "hou2014")));
      check(this.transforms.length > 0, "hou2014: no transform");
    } else {
      check(shared.length === 1, "hou2014: too many shared blobs");
      this.transforms = [this.readTransform(part)];
    }
    check(this.transforms.every(({ columns }) => this.components <= columns), "hou2014: more components than columns");
  }

  private readTransform(part: Bytes): Transform {
    const { points, parents } = this.facts;
    const form = part.varintWithin(0, 2, "the form of a transform");
    const columns = part.varintWithin(0, 3 * points, "the columns of a transform");
    if (form === 2) {
      const bytes = part.rest();
      check(bytes.length === 6 * points * columns, "hou2014: a transform of a wrong size");
      const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
      return { columns, values: Float64Array.from({ length: 3 * points * columns }, (_, i) => view.getInt16(2 * i, true) / 32768) };
    }
    let precision = part.varintWithin(0, 96, "a precision");
    for (const drop of readIntegers(part.blob(), Math.max(0, columns - 1), 1)) {
      precision -= drop;
      check(precision >= 0 && precision <= 96, "hou2014: a precision that is out of range");
    }
    check(form === 0 || parents !== undefined, "hou2014: a transform that needs a skeleton");
    const alike = new Int32Array(3 * points).fill(-1);
    for (let p = 0; p < points; p++) {
      const other = form === 0 ? p - 1 : parents![p]!;
      if (other >= 0) for (let c = 0; c < 3; c++) alike[3 * p + c] = 3 * other + c;
    }
    return { columns, values: readBasis(part.rest(), 3 * points, columns, alike) };
  }

  decode(window: StoredChunk[], which: number): Decoded {
    const { frames, payload } = window[which]!;
    const { points } = this.facts;
    const part = new Bytes(payload, "hou2014");
    const clips = this.readClips(part, frames);
    const count = clips.length;
    const offsets = this.flags & ALLOCATED ? readIntegersWithin(part.blob(), count, 1, -MOST_RUNG, MOST_RUNG, "hou2014: offsets") : new Float64Array(count);
    const choice =
      this.transforms.length > 1 ? readIntegersWithin(part.blob(), count, 1, 0, this.transforms.length - 1, "hou2014: transforms") : new Float64Array(count);
    const total = clips.reduce((sum, clip) => sum + clip.frequencies, 0);
    const coefficients = readIntegers(part.blob(), total, this.components);
    const spectra = this.perClip(clips, coefficients);
    const positions = new Float64Array(3 * frames * points);
    let at = 0;
    clips.forEach((clip, i) => {
      const scale = this.unit * stepOf(this.rung + offsets[i]!);
      const curves = inverseDct(spectra[i]!.map((v) => v * scale), clip.frequencies, clip.frames, this.components);
      this.place(curves, clip.frames, this.transforms[choice[i]!]!, positions.subarray(3 * at * points));
      at += clip.frames;
    });
    const gaps = Gaps.read(part.blob(), frames, points);
    if (this.flags & BOUND) addCorrections(part.rest(), positions, frames, points, this.maxError, gaps);
    part.end();
    gaps.restore(positions);
    return { positions };
  }

  marks({ frames, payload }: StoredChunk): Record<string, number[]> {
    let start = 0;
    const clip = this.readClips(new Bytes(payload, "hou2014"), frames).map(({ frames: length }) => (start += length) - length);
    return { clip };
  }

  private readClips(part: Bytes, frames: number): Clip[] {
    const lengths: number[] = [];
    if (this.flags & ADAPTIVE) {
      const count = part.varintWithin(1, Math.min(frames, part.left), "the number of clips");
      for (let i = 0; i < count; i++) lengths.push(part.varintWithin(1, frames, "the frames of a clip"));
      check(lengths.reduce((sum, length) => sum + length, 0) === frames, "hou2014: clips that do not fit");
    } else {
      for (let left = frames; left > 0; left -= this.clipFrames) lengths.push(Math.min(left, this.clipFrames));
    }
    const longest = lengths.reduce((most, length) => Math.max(most, length), 0);
    const band = part.varintWithin(0, longest, "the kept frequencies");
    return lengths.map((length) => ({ frames: length, frequencies: Math.ceil((band * length) / longest) }));
  }

  /** Coefficients (frequencies, components) of each clip; rows are sorted by f · longest // frames, then by clip. */
  private perClip(clips: Clip[], coefficients: Float64Array): Float64Array[] {
    const k = this.components;
    const longest = clips.reduce((most, clip) => Math.max(most, clip.frames), 0);
    const rows = clips.flatMap((clip, i) =>
      Array.from({ length: clip.frequencies }, (_, f) => ({ key: Math.floor((f * longest) / clip.frames), clip: i, f })),
    );
    rows.sort((a, b) => a.key - b.key || a.clip - b.clip);
    const out = clips.map((clip) => new Float64Array(clip.frequencies * k));
    rows.forEach(({ clip, f }, i) => out[clip]!.set(coefficients.subarray(i * k, (i + 1) * k), f * k));
    return out;
  }

  /** Y = X Bᵀ, divided by the weights, plus the mean pose; out begins at the first frame. */
  private place(curves: Float64Array, frames: number, { columns, values }: Transform, out: Float64Array): void {
    const k = this.components;
    const dimensions = this.mean.length;
    for (let t = 0; t < frames; t++) {
      for (let d = 0; d < dimensions; d++) {
        let sum = 0;
        for (let c = 0; c < k; c++) sum += curves[t * k + c]! * values[d * columns + c]!;
        if (this.weights) sum /= this.weights[Math.floor(d / 3)]!;
        out[t * dimensions + d] = sum + this.mean[d]!;
      }
    }
  }
}

function positive(value: number): number {
  check(value > 0 && Number.isFinite(value), "hou2014: a length that is not positive");
  return value;
}
