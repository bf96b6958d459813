/** The slice header of a picture (ITU-T H.265, 7.3.6). */

import { Corrupt, check } from "../errors.js";
import { Fields, MOST_REFERENCES, type PictureSet, type ReferenceSet, type Sequence, readPictureSet, readReferenceSet, readSequence, unless, units, withoutEmulation } from "./parameters.js";

const VPS_UNIT = 32;
const SPS_UNIT = 33;
const PPS_UNIT = 34;
const FIRST_IDR_UNIT = 19;
const LAST_IDR_UNIT = 20;
/** Last type of trailing-picture units. */
const LAST_TRAILING_UNIT = 1;
const PREDICTED_SLICE = 1;
const INTRA_SLICE = 2;

/** Active parameter sets, until new ones replace them. */
export interface ParameterSets {
  sequence?: Sequence;
  picture?: PictureSet;
}

/** Parameters for decoding a picture. */
export interface Parameters extends Sequence {
  hidesSigns: boolean;
  skipsTransforms: boolean;
  qp: number;
  /** Offsets of the picture for Cb and Cr; `qpOffsets` adds those of the slice. */
  pictureQpOffsets: readonly [number, number];
  qpOffsets: readonly [number, number];
  saoLuma: boolean;
  saoChroma: boolean;
  deblocks: boolean;
  betaOffset: number;
  tcOffset: number;
  /** Low bits of the picture's order; `kept`: earlier pictures to keep. */
  order: number;
  kept: ReferenceSet;
  /** Inter prediction; null in intra pictures. */
  prediction: Prediction | null;
}

/** Parameters of inter prediction. */
export interface Prediction {
  /** Length of the reference list, which may repeat pictures of `kept`. */
  listed: number;
  /** Index of the reference whose motion predicts this picture's motion, −1: none. */
  collocated: number;
  mostMerged: number;
  /** Weights of each reference and plane; null: unweighted. */
  weights: Weight[][] | null;
}

/** Predicted samples become (sample · factor) / 2^denominatorLog2 + offset. */
export interface Weight {
  denominatorLog2: number;
  factor: number;
  offset: number;
}

/** Reads the slice of a packet, which is one picture. Its parameter sets replace those of `sets`. Throws Corrupt, Unsupported. */
export function readSlice(packet: Uint8Array, sets: ParameterSets): { parameters: Parameters; slice: Uint8Array } {
  let found: { parameters: Parameters; slice: Uint8Array } | undefined;
  for (const unit of units(packet)) {
    const type = (unit[0]! >> 1) & 63;
    const bits = new Fields(withoutEmulation(unit.subarray(2)), "picture");
    const isStart = type >= FIRST_IDR_UNIT && type <= LAST_IDR_UNIT;
    if (type === SPS_UNIT) sets.sequence = readSequence(bits);
    else if (type === PPS_UNIT) sets.picture = readPictureSet(bits);
    else if (isStart || type <= LAST_TRAILING_UNIT) {
      const { sequence, picture } = sets;
      check(sequence !== undefined && picture !== undefined, "picture: a slice without its parameters");
      unless(found !== undefined, "several slices");
      found = { parameters: readHeader(bits, sequence, picture, isStart), slice: bits.data.subarray(bits.at / 8) };
    } else unless(type < VPS_UNIT, "an order of pictures that changes");
  }
  if (!found) throw new Corrupt("picture: no slice");
  return found;
}

function readHeader(bits: Fields, sequence: Sequence, picture: PictureSet, isStart: boolean): Parameters {
  unless(!bits.flag(), "several slices");
  if (isStart) bits.flag();
  bits.unsigned(63);
  bits.number(picture.extraBits);
  const type = bits.unsigned(2);
  unless(type !== INTRA_SLICE && type !== PREDICTED_SLICE, "prediction from two pictures");
  const isPredicted = type === PREDICTED_SLICE;
  check(!(isPredicted && isStart), "picture: the first one is predicted from others");
  if (picture.hasOutputFlag) bits.flag();
  const [order, kept] = isStart ? [0, []] : readReferences(bits, sequence);
  const hasTemporal = !isStart && sequence.hasTemporalMotion && bits.flag();
  const [saoLuma, saoChroma] = sequence.hasSao ? [bits.flag(), bits.flag()] : [false, false];
  const prediction = isPredicted ? readPrediction(bits, picture, hasTemporal) : null;
  const qp = picture.qp + bits.signed(77);
  check(qp >= 0 && qp <= 51, "picture: the quantisation step is out of range");
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
  return { ...sequence, hidesSigns, skipsTransforms, qp, pictureQpOffsets, qpOffsets, saoLuma, saoChroma, deblocks, betaOffset, tcOffset, order, kept, prediction };
}

function readReferences(bits: Fields, sequence: Sequence): [number, ReferenceSet] {
  const order = bits.number(sequence.orderBits);
  const sets = sequence.references;
  if (!bits.flag()) return [order, readReferenceSet(bits, sets.length)];
  const chosen = sets[bits.number(Math.ceil(Math.log2(Math.max(1, sets.length))))];
  check(chosen !== undefined, "picture: references that do not exist");
  return [order, chosen];
}

function readPrediction(bits: Fields, picture: PictureSet, hasTemporal: boolean): Prediction {
  const listed = bits.flag() ? 1 + bits.unsigned(MOST_REFERENCES - 1) : picture.references;
  const collocated = hasTemporal ? (listed > 1 ? bits.unsigned(listed - 1) : 0) : -1;
  const weights = picture.isWeighted ? readWeights(bits, listed) : null;
  return { listed, collocated, mostMerged: 5 - bits.unsigned(4), weights };
}

/** Reads the weights (7.3.6.3). */
function readWeights(bits: Fields, listed: number): Weight[][] {
  const luma = bits.unsigned(7);
  const chroma = luma + bits.signed(7);
  check(chroma >= 0 && chroma <= 7, "picture: its weights");
  const hasLuma = Array.from({ length: listed }, () => bits.flag());
  const hasChroma = Array.from({ length: listed }, () => bits.flag());
  return hasLuma.map((isLuma, i) => {
    const planes = [0, 1, 2].map((c) => ({ denominatorLog2: c ? chroma : luma, factor: 1 << (c ? chroma : luma), offset: 0 }));
    if (isLuma) {
      planes[0]!.factor += bits.signed(128);
      planes[0]!.offset = bits.signed(128);
    }
    for (const plane of hasChroma[i] ? planes.slice(1) : []) {
      plane.factor += bits.signed(128);
      const offset = 128 + bits.signed(512) - ((128 * plane.factor) >> chroma);
      plane.offset = Math.min(Math.max(offset, -128), 127);
    }
    return planes;
  });
}
