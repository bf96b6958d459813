/** NAL units of an H.265 byte stream, and its parameter sets (ITU-T H.265, 7.3.2). */

import { Bits } from "../bytes.js";
import { Unsupported, check } from "../errors.js";

/** Most samples of a side: no atlas is larger. */
const MOST_SIZE = 4096;

/** A sequence parameter set (names as in the standard, without prefixes). */
export interface Sequence {
  width: number;
  height: number;
  /** Conformance window: samples cut at left, right, top, bottom. */
  window: readonly [number, number, number, number];
  /** Bits of a picture's order in its slice header. */
  orderBits: number;
  minCodingLog2: number;
  codingTreeLog2: number;
  minTransformLog2: number;
  maxTransformLog2: number;
  /** Greatest depth of transform trees, in inter and in intra blocks. */
  maxInterDepth: number;
  maxIntraDepth: number;
  hasUnevenParts: boolean;
  hasSao: boolean;
  references: ReferenceSet[];
  hasTemporalMotion: boolean;
  hasStrongSmoothing: boolean;
}

/** Earlier pictures to keep, nearest first: distance before the picture, and whether the picture may use them. */
export type ReferenceSet = { back: number; isUsed: boolean }[];

/** A picture parameter set. */
export interface PictureSet {
  hasOutputFlag: boolean;
  extraBits: number;
  hidesSigns: boolean;
  references: number;
  qp: number;
  skipsTransforms: boolean;
  qpOffsets: readonly [number, number];
  hasSliceQpOffsets: boolean;
  isWeighted: boolean;
  filtersAcrossSlices: boolean;
  overridesDeblocking: boolean;
  deblocks: boolean;
  betaOffset: number;
  tcOffset: number;
}

/** Throws Unsupported if a stream uses a tool that mocodec's encoder does not. */
export function unless(isUsed: boolean, tool: string): void {
  if (isUsed) throw new Unsupported(`a picture uses ${tool}`);
}

/** NAL units of a byte stream, between start codes. */
export function* units(data: Uint8Array): Generator<Uint8Array> {
  let start = -1;
  for (let i = 0; i <= data.length; i++) {
    const isCode = i + 2 < data.length && data[i] === 0 && data[i + 1] === 0 && data[i + 2] === 1;
    if (!isCode && i < data.length) continue;
    let stop = i;
    while (start >= 0 && stop > start && data[stop - 1] === 0) stop--;
    if (start >= 0 && stop - start > 2) yield data.subarray(start, stop);
    start = i + 3;
    i += 2;
  }
}

export function withoutEmulation(data: Uint8Array): Uint8Array {
  const out = new Uint8Array(data.length);
  let length = 0;
  let zeros = 0;
  for (const byte of data) {
    if (zeros >= 2 && byte === 3) {
      zeros = 0;
      continue;
    }
    out[length++] = byte;
    zeros = byte === 0 ? zeros + 1 : 0;
  }
  return out.subarray(0, length);
}

export class Fields extends Bits {
  flag(): boolean {
    return this.bit() === 1;
  }

  /** ue(v). */
  unsigned(most: number): number {
    let zeros = 0;
    while (!this.bit()) check(++zeros < 32, "picture: a number is too long");
    const value = 2 ** zeros - 1 + this.number(zeros);
    check(value <= most, `picture: a number is ${value}`);
    return value;
  }

  /** se(v). */
  signed(most: number): number {
    const value = this.unsigned(2 * most);
    return value % 2 ? (value + 1) / 2 : -value / 2;
  }
}

const MOST_SETS = 64;
export const MOST_REFERENCES = 16;
const MOST_BACK = 2 ** 15;
const MOST_NUMBER = 2 ** 31;

export function readSequence(bits: Fields): Sequence {
  bits.number(4);
  unless(bits.number(3) > 0, "layers");
  bits.number(1 + 96);
  bits.unsigned(15);
  unless(bits.unsigned(3) !== 3, "a format other than 4:4:4");
  unless(bits.flag(), "separate colour planes");
  const [width, height] = [bits.unsigned(MOST_SIZE), bits.unsigned(MOST_SIZE)];
  const edge = () => bits.unsigned(MOST_SIZE);
  const window = bits.flag() ? ([edge(), edge(), edge(), edge()] as const) : ([0, 0, 0, 0] as const);
  unless(bits.unsigned(8) + bits.unsigned(8) > 0, "more than 8 bits");
  const orderBits = 4 + bits.unsigned(12);
  bits.flag();
  for (let i = 0; i < 3; i++) bits.unsigned(MOST_NUMBER);
  const minCodingLog2 = 3 + bits.unsigned(3);
  const codingTreeLog2 = minCodingLog2 + bits.unsigned(3);
  const minTransformLog2 = 2 + bits.unsigned(3);
  const maxTransformLog2 = minTransformLog2 + bits.unsigned(3);
  const [maxInterDepth, maxIntraDepth] = [bits.unsigned(4), bits.unsigned(4)];
  check(codingTreeLog2 <= 6 && maxTransformLog2 <= Math.min(5, codingTreeLog2) && minTransformLog2 < minCodingLog2, "picture: sizes of blocks");
  const size = 2 ** minCodingLog2;
  check(width > 0 && height > 0 && width % size === 0 && height % size === 0, "picture: its size");
  check(window[0] + window[1] < width && window[2] + window[3] < height, "picture: its window");
  unless(bits.flag(), "scaling lists");
  const hasUnevenParts = bits.flag();
  const hasSao = bits.flag();
  unless(bits.flag(), "raw samples");
  const references = Array.from({ length: bits.unsigned(MOST_SETS) }, (_, i) => readReferenceSet(bits, i));
  unless(bits.flag(), "long-term references");
  const hasTemporalMotion = bits.flag();
  const hasStrongSmoothing = bits.flag();
  if (bits.flag()) skipUsability(bits);
  unless(bits.flag(), "extensions");
  const blocks = { minCodingLog2, codingTreeLog2, minTransformLog2, maxTransformLog2, maxInterDepth, maxIntraDepth };
  return { width, height, window, orderBits, ...blocks, hasUnevenParts, hasSao, references, hasTemporalMotion, hasStrongSmoothing };
}

/** Reads reference set `number` of the sequence, or the set of a slice, which has the next number (7.3.7). */
export function readReferenceSet(bits: Fields, number: number): ReferenceSet {
  unless(number > 0 && bits.flag(), "references that follow from others");
  const [before, after] = [bits.unsigned(MOST_REFERENCES), bits.unsigned(MOST_REFERENCES)];
  unless(after > 0, "references to later pictures");
  let back = 0;
  return Array.from({ length: before }, () => {
    back += 1 + bits.unsigned(MOST_BACK);
    return { back, isUsed: bits.flag() };
  });
}

/** Skips the video usability information (E.2.1), which does not change the decoded samples. */
function skipUsability(bits: Fields): void {
  if (bits.flag() && bits.number(8) === 255) bits.number(32);
  if (bits.flag()) bits.flag();
  if (bits.flag() && (bits.number(4), bits.flag())) bits.number(24);
  if (bits.flag()) bits.unsigned(5), bits.unsigned(5);
  bits.number(3);
  if (bits.flag()) for (let i = 0; i < 4; i++) bits.unsigned(MOST_NUMBER);
  if (bits.flag()) {
    bits.number(32);
    bits.number(32);
    if (bits.flag()) bits.unsigned(MOST_NUMBER);
    unless(bits.flag(), "a buffer model");
  }
  if (bits.flag()) {
    bits.number(3);
    for (let i = 0; i < 5; i++) bits.unsigned(MOST_NUMBER);
  }
}

export function readPictureSet(bits: Fields): PictureSet {
  bits.unsigned(63);
  bits.unsigned(15);
  unless(bits.flag(), "dependent slices");
  const hasOutputFlag = bits.flag();
  const extraBits = bits.number(3);
  const hidesSigns = bits.flag();
  unless(bits.flag(), "other initial contexts");
  const references = 1 + bits.unsigned(15);
  bits.unsigned(15);
  const qp = 26 + bits.signed(26);
  unless(bits.flag(), "constrained prediction from samples beside");
  const skipsTransforms = bits.flag();
  unless(bits.flag(), "changing quantisation steps");
  const qpOffsets = [bits.signed(12), bits.signed(12)] as const;
  const hasSliceQpOffsets = bits.flag();
  const isWeighted = bits.flag();
  bits.flag();
  unless(bits.flag(), "blocks without transform");
  unless(bits.flag(), "tiles");
  unless(bits.flag(), "rows that are coded apart");
  const filtersAcrossSlices = bits.flag();
  let [overridesDeblocking, deblocks, betaOffset, tcOffset] = [false, true, 0, 0];
  if (bits.flag()) {
    overridesDeblocking = bits.flag();
    deblocks = !bits.flag();
    if (deblocks) [betaOffset, tcOffset] = [2 * bits.signed(6), 2 * bits.signed(6)];
  }
  unless(bits.flag(), "scaling lists");
  unless(bits.flag(), "sorted references");
  unless(bits.unsigned(4) > 0, "merging in parallel");
  unless(bits.flag(), "extended slice headers");
  unless(bits.flag(), "extensions");
  const deblocking = { filtersAcrossSlices, overridesDeblocking, deblocks, betaOffset, tcOffset };
  return { hasOutputFlag, extraBits, hidesSigns, references, qp, skipsTransforms, qpOffsets, hasSliceQpOffsets, isWeighted, ...deblocking };
}
