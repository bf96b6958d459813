/** Decodes packets of H.265 to pictures, one after the other. */

import { check } from "../errors.js";
import { type CodedPicture, PictureDecoder } from "./picture.js";
import { type ParameterSets, type Parameters, readSlice } from "./slice.js";

/** Three planes of samples, row by row. */
export interface Picture {
  width: number;
  height: number;
  planes: [Uint8Array, Uint8Array, Uint8Array];
}

/** Decodes the packets of one stream in order. */
export class VideoDecoder {
  private sets: ParameterSets = {};
  private pictures: CodedPicture[] = [];

  /** A copy of the decoder in its current state. */
  copy(): VideoDecoder {
    const other = new VideoDecoder();
    other.sets = { ...this.sets };
    other.pictures = [...this.pictures];
    return other;
  }

  /** The picture of the next packet. Throws Corrupt, and Unsupported if it needs tools that mocodec's encoder does not use. */
  decode(packet: Uint8Array): Picture {
    const { parameters, slice } = readSlice(packet, this.sets);
    const { width, height, prediction } = parameters;
    const order = this.orderOf(parameters);
    const kept = parameters.kept.map(({ back, isUsed }) => {
      const picture = this.pictures.find((one) => one.order === order - back);
      check(picture !== undefined || !isUsed, "picture: a reference is missing");
      return { picture, isUsed };
    });
    const used = kept.filter(({ isUsed }) => isUsed).map(({ picture }) => picture!);
    check(!prediction || used.length > 0, "picture: no reference");
    check(used.every(({ motion }) => motion.width === width && motion.height === height), "picture: its references have a wrong size");
    const references = Array.from({ length: prediction?.listed ?? 0 }, (_, i) => used[i % used.length]!);
    const decoded = new PictureDecoder(parameters, slice, order, references).decode();
    this.pictures = [decoded, ...kept.flatMap(({ picture }) => picture ?? [])];
    return cut(decoded, width, height, parameters.window);
  }

  /** The order of a picture: the value with these low bits that is nearest to the previous order (8.3.1). */
  private orderOf({ order, orderBits, kept }: Parameters): number {
    const before = kept.length ? (this.pictures[0]?.order ?? 0) : 0;
    const size = 2 ** orderBits;
    const nearest = Math.round((before - order) / size);
    return order + nearest * size;
  }
}

/** The part of a picture within the conformance window. */
function cut({ planes }: CodedPicture, width: number, height: number, [left, right, top, bottom]: readonly [number, number, number, number]): Picture {
  const [w, h] = [width - left - right, height - top - bottom];
  const shown = (samples: Uint8Array) => {
    const out = new Uint8Array(w * h);
    for (let y = 0; y < h; y++) out.set(samples.subarray((y + top) * width + left, (y + top) * width + left + w), y * w);
    return out;
  };
  return { width: w, height: h, planes: [shown(planes[0]!), shown(planes[1]!), shown(planes[2]!)] };
}
