/** PNG pictures with one value a pixel: grey, or indices of a palette, not resolved (ISO/IEC 15948). */

import { Bytes } from "../bytes.js";
import { Unsupported, check } from "../errors.js";
import { inflateZlib } from "../inflate.js";

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const GREY = 0;
const PALETTE = 3;

export interface Values {
  width: number;
  height: number;
  isPalette: boolean;
  /** (height, width). */
  pixels: Uint8Array;
}

/** Decodes a PNG. most: limit of pixels. Throws Corrupt, and Unsupported for colours, 16 bits and interlaced pictures. */
export function readPng(data: Uint8Array, most: number): Values {
  const part = new Bytes(data, "PNG");
  check(SIGNATURE.every((byte) => byte === part.byte()), "PNG: a wrong signature");
  let header: { width: number; height: number; bits: number; kind: number } | undefined;
  const parts: Uint8Array[] = [];
  for (;;) {
    const size = big(part.take(4));
    const name = String.fromCharCode(...part.take(4));
    const content = part.take(size);
    part.take(4);
    if (name === "IHDR") {
      check(size === 13, "PNG: its header");
      header = { width: big(content), height: big(content.subarray(4)), bits: content[8]!, kind: content[9]! };
      if (content[12] || (header.kind !== GREY && header.kind !== PALETTE) || header.bits > 8) throw new Unsupported("a PNG of an unsupported kind");
    } else if (name === "IDAT") parts.push(content);
    else if (name === "IEND") break;
  }
  check(header !== undefined && [1, 2, 4, 8].includes(header.bits), "PNG: no header");
  const { width, height, bits, kind } = header;
  check(width > 0 && height > 0 && width * height <= most, "PNG: its size");
  const stride = Math.ceil((width * bits) / 8);
  const lines = inflateZlib(concatenated(parts), height * (stride + 1));
  check(lines.length === height * (stride + 1), "PNG: its lines");
  unfilter(lines, height, stride);
  const pixels = new Uint8Array(width * height);
  const mask = (1 << bits) - 1;
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const at = x * bits;
      pixels[y * width + x] = (lines[y * (stride + 1) + 1 + (at >> 3)]! >> (8 - bits - (at & 7))) & mask;
    }
  }
  return { width, height, isPalette: kind === PALETTE, pixels };
}

function big(bytes: Uint8Array): number {
  return ((bytes[0]! << 24) | (bytes[1]! << 16) | (bytes[2]! << 8) | bytes[3]!) >>> 0;
}

function concatenated(parts: Uint8Array[]): Uint8Array {
  const out = new Uint8Array(parts.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

/** Undoes the prediction of each line in place; the byte before a line is the type of its filter. */
function unfilter(lines: Uint8Array, height: number, stride: number): void {
  for (let y = 0; y < height; y++) {
    const first = y * (stride + 1) + 1;
    const filter = lines[first - 1]!;
    check(filter <= 4, "PNG: an unknown filter");
    if (filter === 0) continue;
    for (let i = 0; i < stride; i++) {
      const left = i > 0 ? lines[first + i - 1]! : 0;
      const above = y > 0 ? lines[first + i - stride - 1]! : 0;
      const corner = i > 0 && y > 0 ? lines[first + i - stride - 2]! : 0;
      const predicted = filter === 1 ? left : filter === 2 ? above : filter === 3 ? (left + above) >> 1 : paeth(left, above, corner);
      lines[first + i] = lines[first + i]! + predicted;
    }
  }
}

function paeth(left: number, above: number, corner: number): number {
  const sum = left + above - corner;
  const a = Math.abs(sum - left);
  const b = Math.abs(sum - above);
  const c = Math.abs(sum - corner);
  return a <= b && a <= c ? left : b <= c ? above : corner;
}
