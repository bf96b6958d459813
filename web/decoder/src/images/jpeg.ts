/**
 * JPEG pictures of three components, sequential, with Huffman codes of 8 bits (ITU-T T.81, JFIF).
 *
 *     segments ─► tables, size ─► codes ─► coefficients ─► blocks ─► planes, upsampled ─► red, green, blue
 */

import { Bytes } from "../bytes.js";
import { Unsupported, check } from "../errors.js";
import { clip8 } from "../numbers.js";

const END = 0xd9;
const [SOF0, SOF1, SOF2] = [0xc0, 0xc1, 0xc2];
const [HUFFMAN, TABLES, SCAN, RESTART] = [0xc4, 0xdb, 0xda, 0xdd];
const FASTEST_BITS = 9;
/** Most bytes that the decoder reads past the end. */
const MOST_BEYOND = 4;

/** Positions of coefficients in a block, in the order of their codes. */
const ZIGZAG = Uint8Array.of(
  0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6, 7, 14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22,
  15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63,
);
/** Fractional bits of factors, and of values between the two passes of the transform. */
const FACTOR_BITS = 13;
const BETWEEN_BITS = 2;

export interface Colours {
  width: number;
  height: number;
  /** (height, width, 3): red, green, blue. */
  pixels: Uint8Array;
}

interface Component {
  across: number;
  down: number;
  table: number;
  codes: [number, number];
  /** Samples of whole blocks. `stride`: samples in a line. */
  samples: Uint8Array;
  stride: number;
  /** Size of the part within the picture. */
  width: number;
  height: number;
}

/** Decodes a JPEG. most: limit of pixels. Throws Corrupt, and Unsupported for other kinds of JPEG. */
export function readJpeg(data: Uint8Array, most: number): Colours {
  const part = new Bytes(data, "JPEG");
  check(part.byte() === 0xff && part.byte() === 0xd8, "JPEG: a wrong signature");
  const tables: Uint16Array[] = [];
  const codes: Huffman[] = [];
  let frame: { width: number; height: number; components: Map<number, Component> } | undefined;
  for (;;) {
    check(part.byte() === 0xff, "JPEG: no marker");
    const marker = part.byte();
    check(marker !== END, "JPEG: no scan");
    const size = number16(part);
    check(size >= 2, "JPEG: a segment's size");
    const segment = new Bytes(part.take(size - 2), "JPEG");
    if (marker === TABLES) readTables(segment, tables);
    else if (marker === HUFFMAN) readCodes(segment, codes);
    else if (marker === SOF0 || marker === SOF1) frame = readFrame(segment, most);
    else if (marker === RESTART && number16(segment) > 0) throw new Unsupported("a JPEG with restarts");
    else if (marker >= SOF2 && marker <= 0xcf && marker !== 0xc8 && marker !== 0xcc) throw new Unsupported("a JPEG that is not sequential");
    else if (marker === SCAN) {
      check(frame !== undefined, "JPEG: a scan without a frame");
      const components = readScan(segment, frame.components);
      decodeScan(new Codes(part.rest()), components, frame, tables, codes);
      return { width: frame.width, height: frame.height, pixels: coloured([...frame.components.values()], frame) };
    }
  }
}

function number16(part: Bytes): number {
  return 256 * part.byte() + part.byte();
}

function readTables(segment: Bytes, tables: Uint16Array[]): void {
  while (segment.left) {
    const about = segment.byte();
    tables[about & 15] = Uint16Array.from({ length: 64 }, () => (about >> 4 ? number16(segment) : segment.byte()));
  }
}

/** A Huffman code: symbols in the order of their codes, and the number of codes of each length. */
interface Huffman {
  symbols: Uint8Array;
  counts: Uint8Array;
  /** Lookup by the next FASTEST_BITS bits: length · 256 + symbol; 0 for longer codes. */
  fast: Uint16Array;
}

function readCodes(segment: Bytes, codes: Huffman[]): void {
  while (segment.left) {
    const about = segment.byte();
    const counts = segment.take(16).slice();
    const symbols = segment.take(counts.reduce((sum, count) => sum + count, 0)).slice();
    const fast = new Uint16Array(1 << FASTEST_BITS);
    let code = 0;
    let next = 0;
    for (let length = 1; length <= 16; length++, code *= 2) {
      for (let i = 0; i < counts[length - 1]!; i++, code++, next++) {
        check(code < 1 << length, "JPEG: a Huffman code has too many symbols");
        if (length > FASTEST_BITS) continue;
        const shift = FASTEST_BITS - length;
        fast.fill(256 * length + symbols[next]!, code << shift, (code + 1) << shift);
      }
    }
    codes[2 * (about & 1) + (about >> 4)] = { symbols, counts, fast };
  }
}

function readFrame(segment: Bytes, most: number): { width: number; height: number; components: Map<number, Component> } {
  if (segment.byte() !== 8) throw new Unsupported("a JPEG of more than 8 bits");
  const [height, width, count] = [number16(segment), number16(segment), segment.byte()];
  check(width > 0 && height > 0 && width * height <= most, "JPEG: wrong size");
  if (count !== 3) throw new Unsupported("a JPEG without three components");
  const raw = [0, 1, 2].map(() => {
    const [id, factors, table] = [segment.byte(), segment.byte(), segment.byte()];
    return { id, across: factors >> 4, down: factors & 15, table };
  });
  const [across, down] = [raw[0]!.across, raw[0]!.down];
  const isKnown = (a: number, d: number) => (a === across || 2 * a === across) && (d === down || 2 * d === down) && a > 0 && d > 0;
  if (!raw.every((own) => isKnown(own.across, own.down)) || across > 2 || down > 2) throw new Unsupported("a JPEG with an unsupported subsampling");
  const units = { across: Math.ceil(width / (8 * across)), down: Math.ceil(height / (8 * down)) };
  const components = new Map<number, Component>();
  for (const own of raw) {
    const stride = 8 * own.across * units.across;
    const samples = new Uint8Array(stride * 8 * own.down * units.down);
    const size = { width: Math.ceil((width * own.across) / across), height: Math.ceil((height * own.down) / down) };
    components.set(own.id, { ...own, codes: [0, 0], samples, stride, ...size });
  }
  check(components.size === 3, "JPEG: a component occurs twice");
  return { width, height, components };
}

function readScan(segment: Bytes, components: Map<number, Component>): Component[] {
  if (segment.byte() !== 3) throw new Unsupported("a JPEG with several scans");
  return [0, 1, 2].map(() => {
    const component = components.get(segment.byte());
    check(component !== undefined, "JPEG: a scan of an unknown component");
    const about = segment.byte();
    component.codes = [about >> 4, about & 15];
    return component;
  });
}

/** Reads bits after the scan's header; skips bytes 0 after 255. */
class Codes {
  private at = 0;
  private bits = 0;
  private count = 0;
  /** Bytes read past the end. */
  private beyond = 0;

  constructor(private readonly data: Uint8Array) {}

  private fill(count: number): void {
    while (this.count < count) {
      let byte = 0;
      if (this.at < this.data.length && !(this.data[this.at] === 255 && this.data[this.at + 1] !== 0)) {
        byte = this.data[this.at]!;
        this.at += byte === 255 ? 2 : 1;
      } else check(++this.beyond <= MOST_BEYOND, "JPEG: the scan is cut off");
      this.bits = ((this.bits << 8) | byte) & 0xffffff;
      this.count += 8;
    }
  }

  /** Reads a number of `count` bits. */
  number(count: number): number {
    if (count === 0) return 0;
    this.fill(count);
    this.count -= count;
    return (this.bits >> this.count) & ((1 << count) - 1);
  }

  /** Reads a signed number of `count` bits; it is negative if the highest bit is 0. */
  signed(count: number): number {
    const value = this.number(count);
    return count && value < 1 << (count - 1) ? value - (1 << count) + 1 : value;
  }

  symbol({ symbols, counts, fast }: Huffman): number {
    this.fill(16);
    const next = (this.bits >> (this.count - 16)) & 0xffff;
    const found = fast[next >> (16 - FASTEST_BITS)]!;
    if (found) {
      this.count -= found >> 8;
      return found & 255;
    }
    let first = 0;
    let number = 0;
    for (let length = 1; length <= 16; length++, first *= 2) {
      const code = next >> (16 - length);
      if (code - first < counts[length - 1]!) {
        this.count -= length;
        return symbols[number + code - first]!;
      }
      number += counts[length - 1]!;
      first += counts[length - 1]!;
    }
    check(false, "JPEG: an unknown code");
  }
}

function decodeScan(bits: Codes, components: Component[], { width, height }: { width: number; height: number }, tables: Uint16Array[], codes: Huffman[]): void {
  const [first] = components;
  const units = Math.ceil(width / (8 * Math.max(...components.map(({ across }) => across)))) * Math.ceil(height / (8 * Math.max(...components.map(({ down }) => down))));
  const columns = first!.stride / (8 * first!.across);
  const before = [0, 0, 0];
  const block = new Int32Array(64);
  for (let unit = 0; unit < units; unit++) {
    const [left, top] = [unit % columns, Math.floor(unit / columns)];
    components.forEach((component, c) => {
      const { across, down, table, codes: chosen, samples, stride } = component;
      const [scale, dc, ac] = [tables[table], codes[2 * chosen[0]], codes[2 * chosen[1] + 1]];
      check(scale !== undefined && dc !== undefined && ac !== undefined, "JPEG: tables are missing");
      for (let k = 0; k < across * down; k++) {
        before[c]! += readBlock(bits, block, scale, dc, ac, before[c]!);
        inverse(block, samples, 8 * ((top * down + Math.floor(k / across)) * stride + left * across + (k % across)), stride);
      }
    });
  }
}

/** Reads a block, dequantised; returns the difference of its DC coefficient. */
function readBlock(bits: Codes, block: Int32Array, scale: Uint16Array, dc: Huffman, ac: Huffman, before: number): number {
  block.fill(0);
  const difference = bits.signed(Math.min(bits.symbol(dc), 15));
  block[0] = (before + difference) * scale[0]!;
  for (let k = 1; k < 64; k++) {
    const symbol = bits.symbol(ac);
    const size = symbol & 15;
    if (size === 0 && symbol < 0xf0) break;
    k += symbol >> 4;
    if (size === 0) continue;
    check(k < 64, "JPEG: a block has too many coefficients");
    block[ZIGZAG[k]!] = bits.signed(size) * scale[k]!;
  }
  return difference;
}

/** Inverse cosine transform of a block into samples from `at` on: columns, then rows, rounded as in libjpeg. */
function inverse(block: Int32Array, samples: Uint8Array, at: number, stride: number): void {
  for (let x = 0; x < 8; x++) transform(block, x, 8, FACTOR_BITS - BETWEEN_BITS);
  for (let y = 0; y < 8; y++) transform(block, 8 * y, 1, FACTOR_BITS + BETWEEN_BITS + 3);
  for (let i = 0; i < 64; i++) {
    const value = block[i]! + 128;
    samples[at + (i >> 3) * stride + (i & 7)] = value < 0 ? 0 : value > 255 ? 255 : value;
  }
}

/** A number in fixed point, FACTOR_BITS fractional bits. */
function factor(value: number): number {
  return Math.round(value * 2 ** FACTOR_BITS);
}

const TURN = [factor(0.541196100), factor(1.847759065), factor(0.765366865)] as const;
const ODD = [factor(0.298631336), factor(2.053119869), factor(3.072711026), factor(1.501321110)] as const;
const SHARED = [factor(1.175875602), factor(0.899976223), factor(2.562915447), factor(1.961570560), factor(0.390180644)] as const;

/** Transforms eight values of a block in place (Loeffler, Ligtenberg and Moschytz 1989: 11 multiplications). */
function transform(v: Int32Array, at: number, step: number, shift: number): void {
  const turned = (v[at + 2 * step]! + v[at + 6 * step]!) * TURN[0];
  const even2 = turned - v[at + 6 * step]! * TURN[1];
  const even3 = turned + v[at + 2 * step]! * TURN[2];
  const even0 = (v[at]! + v[at + 4 * step]!) * 2 ** FACTOR_BITS;
  const even1 = (v[at]! - v[at + 4 * step]!) * 2 ** FACTOR_BITS;
  const [o7, o5, o3, o1] = [v[at + 7 * step]!, v[at + 5 * step]!, v[at + 3 * step]!, v[at + step]!];
  const all = (o7 + o3 + o5 + o1) * SHARED[0];
  const outer = -(o7 + o1) * SHARED[1];
  const inner = -(o5 + o3) * SHARED[2];
  const first = all - (o7 + o3) * SHARED[3];
  const second = all - (o5 + o1) * SHARED[4];
  const odd0 = o7 * ODD[0] + outer + first;
  const odd1 = o5 * ODD[1] + inner + second;
  const odd2 = o3 * ODD[2] + inner + first;
  const odd3 = o1 * ODD[3] + outer + second;
  write(v, at, step, shift, even0 + even3, odd3, 0);
  write(v, at, step, shift, even1 + even2, odd2, 1);
  write(v, at, step, shift, even1 - even2, odd1, 2);
  write(v, at, step, shift, even0 - even3, odd0, 3);
}

/** Writes values `place` and 7 − `place`. */
function write(v: Int32Array, at: number, step: number, shift: number, even: number, odd: number, place: number): void {
  const half = 1 << (shift - 1);
  v[at + place * step] = (even + odd + half) >> shift;
  v[at + (7 - place) * step] = (even - odd + half) >> shift;
}

function coloured(components: Component[], { width, height }: { width: number; height: number }): Uint8Array {
  const [luma, blueness, redness] = components.map((component) => enlarged(component, width, height, components[0]!));
  const pixels = new Uint8Array(3 * width * height);
  for (let i = 0; i < width * height; i++) {
    const [y, b, r] = [luma![i]!, blueness![i]! - 128, redness![i]! - 128];
    pixels[3 * i] = clip8(y + ((91_881 * r + 32_768) >> 16));
    pixels[3 * i + 1] = clip8(y + ((-22_554 * b - 46_802 * r + 32_768) >> 16));
    pixels[3 * i + 2] = clip8(y + ((116_130 * b + 32_768) >> 16));
  }
  return pixels;
}

/** Upsamples a component to all pixels: 3/4 of the nearer sample plus 1/4 of the other. */
function enlarged({ samples, stride, width: w, height: h, across, down }: Component, width: number, height: number, whole: Component): Uint8Array {
  const [halfX, halfY] = [across < whole.across, down < whole.down];
  const out = new Uint8Array(width * height);
  const smooth = w > 2; // as in libjpeg
  const clip = (value: number, most: number) => (value < 0 ? 0 : value > most ? most : value);
  for (let y = 0; y < height; y++) {
    const row = halfY ? y >> 1 : y;
    const otherRow = halfY && smooth ? clip(row + (y & 1 ? 1 : -1), h - 1) : row;
    for (let x = 0; x < width; x++) {
      const column = halfX ? x >> 1 : x;
      const otherColumn = halfX && smooth ? clip(column + (x & 1 ? 1 : -1), w - 1) : column;
      const near = 3 * samples[row * stride + column]! + samples[otherRow * stride + column]!;
      const far = 3 * samples[row * stride + otherColumn]! + samples[otherRow * stride + otherColumn]!;
      out[y * width + x] = (3 * near + far + (x & 1 ? 7 : 8)) >> 4;
    }
  }
  return out;
}
