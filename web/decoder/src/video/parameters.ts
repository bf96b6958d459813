/** Parameter sets and the slice header of an H.265 picture that stands alone (ITU-T H.265, 7.3). */

import { Bits } from "../bytes.js";
import { Corrupt, Unsupported, check } from "../errors.js";

const VPS_UNIT = 32;
const SPS_UNIT = 33;
const PPS_UNIT = 34;
const FIRST_IDR_UNIT = 19;
const LAST_IDR_UNIT = 20;
const INTRA_SLICE = 2;
/** Samples of a side: an atlas is never larger. */
const MOST_SIZE = 4096;

/** What the syntax of a picture needs (names as in the standard, without prefixes). */
export interface Parameters {
  width: number;
  height: number;
  /** Samples of the conformance window: left, right, top, bottom are cut. */
  window: readonly [number, number, number, number];
  minCodingLog2: number;
  codingTreeLog2: number;
  minTransformLog2: number;
  maxTransformLog2: number;
  maxDepth: number;
  hasSao: boolean;
  hasStrongSmoothing: boolean;
  hidesSigns: boolean;
  skipsTransforms: boolean;
  qp: number;
  /** Of Cb and Cr in the picture, and with the slice's added. */
  pictureQpOffsets: readonly [number, number];
  qpOffsets: readonly [number, number];
  saoLuma: boolean;
  saoChroma: boolean;
  deblocks: boolean;
  betaOffset: number;
  tcOffset: number;
}

type Sequence = Pick<
  Parameters,
  "width" | "height" | "window" | "minCodingLog2" | "codingTreeLog2" | "minTransformLog2" | "maxTransformLog2" | "maxDepth" | "hasSao" | "hasStrongSmoothing"
>;

interface Picture {
  hasOutputFlag: boolean;
  extraBits: number;
  hidesSigns: boolean;
  qp: number;
  skipsTransforms: boolean;
  qpOffsets: readonly [number, number];
  hasSliceQpOffsets: boolean;
  filtersAcrossSlices: boolean;
  overridesDeblocking: boolean;
  deblocks: boolean;
  betaOffset: number;
  tcOffset: number;
}

/** The parameters of a packet of one picture, and its coded slice. Throws Corrupt, Unsupported. */
export function readPicture(packet: Uint8Array): { parameters: Parameters; slice: Uint8Array } {
  let sequence: Sequence | undefined;
  let picture: Picture | undefined;
  let found: { parameters: Parameters; slice: Uint8Array } | undefined;
  for (const unit of units(packet)) {
    const type = (unit[0]! >> 1) & 63;
    const bits = new Fields(withoutEmulation(unit.subarray(2)), "picture");
    if (type === SPS_UNIT) sequence = readSequence(bits);
    else if (type === PPS_UNIT) picture = readPictureParameters(bits);
    else if (type >= FIRST_IDR_UNIT && type <= LAST_IDR_UNIT) {
      check(sequence !== undefined && picture !== undefined, "picture: a slice without its parameters");
      unless(found !== undefined, "several slices");
      found = { parameters: readSlice(bits, sequence, picture), slice: bits.data.subarray(bits.at / 8) };
    } else unless(type < VPS_UNIT, "pictures that need others");
  }
  if (!found) throw new Corrupt("picture: no slice");
  return found;
}

/** Throws Unsupported if a stream uses a tool that mocodec's encoder does not. */
function unless(isUsed: boolean, tool: string): void {
  if (isUsed) throw new Unsupported(`a picture uses ${tool}`);
}

/** Units of a byte stream, between start codes. */
function* units(data: Uint8Array): Generator<Uint8Array> {
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

function withoutEmulation(data: Uint8Array): Uint8Array {
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

class Fields extends Bits {
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

/** Orders of reference pictures, which a picture that stands alone does not use. */
const MOST_SETS = 64;
const MOST_NUMBER = 2 ** 31;

function readSequence(bits: Fields): Sequence {
  bits.number(4);
  unless(bits.number(3) > 0, "layers");
  bits.number(1 + 96);
  bits.unsigned(15);
  unless(bits.unsigned(3) !== 3, "another format than 4:4:4");
  unless(bits.flag(), "separate colour planes");
  const [width, height] = [bits.unsigned(MOST_SIZE), bits.unsigned(MOST_SIZE)];
  const edge = () => bits.unsigned(MOST_SIZE);
  const window = bits.flag() ? ([edge(), edge(), edge(), edge()] as const) : ([0, 0, 0, 0] as const);
  unless(bits.unsigned(8) + bits.unsigned(8) > 0, "more than 8 bits");
  bits.unsigned(12);
  bits.flag();
  for (let i = 0; i < 3; i++) bits.unsigned(MOST_NUMBER);
  const minCodingLog2 = 3 + bits.unsigned(3);
  const codingTreeLog2 = minCodingLog2 + bits.unsigned(3);
  const minTransformLog2 = 2 + bits.unsigned(3);
  const maxTransformLog2 = minTransformLog2 + bits.unsigned(3);
  bits.unsigned(4);
  const maxDepth = bits.unsigned(4);
  check(codingTreeLog2 <= 6 && maxTransformLog2 <= Math.min(5, codingTreeLog2) && minTransformLog2 < minCodingLog2, "picture: sizes of blocks");
  const size = 2 ** minCodingLog2;
  check(width > 0 && height > 0 && width % size === 0 && height % size === 0, "picture: its size");
  check(window[0] + window[1] < width && window[2] + window[3] < height, "picture: its window");
  unless(bits.flag(), "scaling lists");
  bits.flag();
  const hasSao = bits.flag();
  unless(bits.flag(), "raw samples");
  skipReferenceSets(bits);
  unless(bits.flag(), "long-term references");
  bits.flag();
  const hasStrongSmoothing = bits.flag();
  if (bits.flag()) skipUsability(bits);
  unless(bits.flag(), "extensions");
  return { width, height, window, minCodingLog2, codingTreeLog2, minTransformLog2, maxTransformLog2, maxDepth, hasSao, hasStrongSmoothing };
}

function skipReferenceSets(bits: Fields): void {
  const sets = bits.unsigned(MOST_SETS);
  let deltas = 0;
  for (let i = 0; i < sets; i++) {
    if (i && bits.flag()) {
      bits.flag();
      bits.unsigned(MOST_NUMBER);
      let kept = 0;
      for (let j = 0; j <= deltas; j++) kept += Number(bits.flag() || bits.flag());
      deltas = kept;
    } else {
      deltas = bits.unsigned(16) + bits.unsigned(16);
      for (let j = 0; j < deltas; j++) bits.unsigned(MOST_NUMBER), bits.flag();
    }
  }
}

/** Video usability information (E.2.1): shape of samples, ranges and timing, none of which changes the decoded samples. */
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

function readPictureParameters(bits: Fields): Picture {
  bits.unsigned(63);
  bits.unsigned(15);
  unless(bits.flag(), "dependent slices");
  const hasOutputFlag = bits.flag();
  const extraBits = bits.number(3);
  const hidesSigns = bits.flag();
  bits.flag();
  bits.unsigned(15);
  bits.unsigned(15);
  const qp = 26 + bits.signed(26);
  bits.flag();
  const skipsTransforms = bits.flag();
  unless(bits.flag(), "changing quantisation steps");
  const qpOffsets = [bits.signed(12), bits.signed(12)] as const;
  const hasSliceQpOffsets = bits.flag();
  bits.number(2);
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
  bits.flag();
  bits.unsigned(4);
  unless(bits.flag(), "extended slice headers");
  unless(bits.flag(), "extensions");
  return { hasOutputFlag, extraBits, hidesSigns, qp, skipsTransforms, qpOffsets, hasSliceQpOffsets, filtersAcrossSlices, overridesDeblocking, deblocks, betaOffset, tcOffset };
}

function readSlice(bits: Fields, sequence: Sequence, picture: Picture): Parameters {
  unless(!bits.flag(), "several slices");
  bits.flag();
  bits.unsigned(63);
  bits.number(picture.extraBits);
  unless(bits.unsigned(2) !== INTRA_SLICE, "prediction from other pictures");
  if (picture.hasOutputFlag) bits.flag();
  const [saoLuma, saoChroma] = sequence.hasSao ? [bits.flag(), bits.flag()] : [false, false];
  const qp = picture.qp + bits.signed(77);
  check(qp >= 0 && qp <= 51, "picture: its quantisation step");
  const offset = () => (picture.hasSliceQpOffsets ? bits.signed(12) : 0);
  const [cb, cr] = picture.qpOffsets;
  const qpOffsets = [cb + offset(), cr + offset()] as const;
  let { deblocks, betaOffset, tcOffset } = picture;
  if (picture.overridesDeblocking && bits.flag()) {
    deblocks = !bits.flag();
    if (deblocks) [betaOffset, tcOffset] = [2 * bits.signed(6), 2 * bits.signed(6)];
  }
  if (picture.filtersAcrossSlices && (saoLuma || saoChroma || deblocks)) bits.flag();
  check(bits.flag(), "picture: no end of the slice header");
  while (bits.at % 8) bits.flag();
  const { hidesSigns, skipsTransforms, qpOffsets: pictureQpOffsets } = picture;
  return { ...sequence, hidesSigns, skipsTransforms, qp, pictureQpOffsets, qpOffsets, saoLuma, saoChroma, deblocks, betaOffset, tcOffset };
}
