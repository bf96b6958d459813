/**
 * Pictures of H.265 that stand alone: 4:4:4, 8 bits, one slice, with the tools that mocodec's encoder uses (ITU-T H.265).
 *
 *     packet ─► parameters · slice ─► blocks: prediction from samples beside + residual ─► deblocking ─► sample offsets
 */

import { check } from "../errors.js";
import { Cabac, FIRST } from "./cabac.js";
import { deblock } from "./deblocking.js";
import { ACROSS, DOWN, MEAN, PLANAR, type Plane, predict } from "./intra.js";
import { addOffsets, type Offsets, readOffsets } from "./offsets.js";
import { type Parameters, readPicture } from "./parameters.js";
import { COLUMNS, DIAGONAL, ROWS, type Scan, readResidual } from "./residual.js";
import { inverse } from "./transform.js";

/** Three planes of samples, row by row. */
export interface Picture {
  width: number;
  height: number;
  planes: [Uint8Array, Uint8Array, Uint8Array];
}

const MOST_QP = 51;
const CHROMA_AS_LUMA = 4;
const CHROMA_MODES = [PLANAR, DOWN, ACROSS, MEAN];
const CHROMA_OTHER = 34;

/** The picture of a packet. Throws Corrupt, and Unsupported if it needs other pictures or tools. */
export function decodePicture(packet: Uint8Array): Picture {
  const { parameters, slice } = readPicture(packet);
  return new Decoder(parameters, slice).decode();
}

class Decoder {
  private readonly planes: Plane[];
  private readonly cabac: Cabac;
  private readonly qps: number[];
  /** Of each block of 4 × 4: depth of its coding unit, −1 before; mode of its luma; bits 1 and 2: an edge at its left and top. */
  private readonly depths: Int8Array;
  private readonly modes: Uint8Array;
  private readonly edges: Uint8Array;
  private readonly across: number;

  constructor(
    private readonly parameters: Parameters,
    slice: Uint8Array,
  ) {
    const { width, height, qp, qpOffsets } = parameters;
    this.across = width >> 2;
    const blocks = this.across * (height >> 2);
    this.planes = [0, 1, 2].map(() => ({ width, height, samples: new Uint8Array(width * height), isDecoded: new Uint8Array(blocks) }));
    this.depths = new Int8Array(blocks).fill(-1);
    this.modes = new Uint8Array(blocks).fill(MEAN);
    this.edges = new Uint8Array(blocks);
    this.cabac = new Cabac(slice, qp);
    this.qps = [qp, ...qpOffsets.map((offset) => Math.min(Math.max(qp + offset, 0), MOST_QP))];
  }

  decode(): Picture {
    const { parameters, planes, cabac } = this;
    const { width, height, codingTreeLog2, saoLuma, saoChroma } = parameters;
    const size = 1 << codingTreeLog2;
    const columns = Math.ceil(width / size);
    const units = columns * Math.ceil(height / size);
    const offsets: Offsets[] = [];
    for (let i = 0; i < units; i++) {
      if (saoLuma || saoChroma) offsets.push(readOffsets(cabac, parameters, offsets, i, columns));
      this.quadtree((i % columns) * size, Math.floor(i / columns) * size, codingTreeLog2, 0);
      check(cabac.ends() === (i === units - 1), "picture: its slice has another end");
    }
    if (parameters.deblocks) deblock(planes, this.edges, parameters);
    if (offsets.length) addOffsets(planes, offsets, size);
    const [left, right, top, bottom] = parameters.window;
    const [w, h] = [width - left - right, height - top - bottom];
    const cut = ({ samples }: Plane) => {
      const out = new Uint8Array(w * h);
      for (let y = 0; y < h; y++) out.set(samples.subarray((y + top) * width + left, (y + top) * width + left + w), y * w);
      return out;
    };
    return { width: w, height: h, planes: [cut(planes[0]!), cut(planes[1]!), cut(planes[2]!)] };
  }

  private fill(map: Uint8Array | Int8Array, x: number, y: number, size: number, value: number): void {
    const from = x >> 2;
    const to = Math.min(this.across, (x + size) >> 2);
    for (let row = y >> 2; row < Math.min(this.parameters.height, y + size) >> 2; row++) map.fill(value, row * this.across + from, row * this.across + Math.max(to, from + 1));
  }

  private block(x: number, y: number): number {
    return (y >> 2) * this.across + (x >> 2);
  }

  private quadtree(x: number, y: number, log2: number, depth: number): void {
    const { width, height, minCodingLog2 } = this.parameters;
    const size = 1 << log2;
    let isSplit = log2 > minCodingLog2;
    if (isSplit && x + size <= width && y + size <= height) {
      const left = x > 0 && this.depths[this.block(x - 1, y)]! > depth;
      const above = y > 0 && this.depths[this.block(x, y - 1)]! > depth;
      isSplit = this.cabac.bit(FIRST.split + Number(left) + Number(above)) === 1;
    }
    if (!isSplit) return this.codingUnit(x, y, log2, depth);
    const half = size >> 1;
    for (const [dx, dy] of [[0, 0], [half, 0], [0, half], [half, half]] as const) {
      if (x + dx < width && y + dy < height) this.quadtree(x + dx, y + dy, log2 - 1, depth + 1);
    }
  }

  private codingUnit(x: number, y: number, log2: number, depth: number): void {
    const { cabac, parameters } = this;
    const isQuartered = log2 === parameters.minCodingLog2 && cabac.bit(FIRST.parts) === 0;
    const parts = isQuartered ? 4 : 1;
    const size = (1 << log2) >> Number(isQuartered);
    this.fill(this.depths, x, y, 1 << log2, depth);
    const probable = Array.from({ length: parts }, () => cabac.bit(FIRST.isProbable) === 1);
    const luma = probable.map((isProbable, i) => {
      const [px, py] = [x + (i & 1) * size, y + (i >> 1) * size];
      const mode = this.lumaMode(px, py, isProbable);
      this.fill(this.modes, px, py, size, mode);
      return mode;
    });
    const chroma = luma.map((mode) => {
      const choice = cabac.bit(FIRST.chromaMode) ? cabac.number(2) : CHROMA_AS_LUMA;
      if (choice === CHROMA_AS_LUMA) return mode;
      return CHROMA_MODES[choice] === mode ? CHROMA_OTHER : CHROMA_MODES[choice]!;
    });
    this.transformTree({ x, y, log2, isQuartered, luma, chroma }, x, y, log2, 0, 0, true, true);
  }

  /** 8.4.2: one of the three most probable modes, or one of the others. */
  private lumaMode(x: number, y: number, isProbable: boolean): number {
    const left = x > 0 ? this.modes[this.block(x - 1, y)]! : MEAN;
    const above = y % (1 << this.parameters.codingTreeLog2) > 0 ? this.modes[this.block(x, y - 1)]! : MEAN;
    let candidates: number[];
    if (left !== above) candidates = [left, above, [PLANAR, MEAN, DOWN].find((mode) => mode !== left && mode !== above)!];
    else if (left < 2) candidates = [PLANAR, MEAN, DOWN];
    else candidates = [left, 2 + ((left + 29) % 32), 2 + ((left - 1) % 32)];
    if (isProbable) return candidates[this.cabac.ones(2)]!;
    let mode = this.cabac.number(5);
    for (const candidate of candidates.sort((a, b) => a - b)) if (mode >= candidate) mode++;
    return mode;
  }

  private transformTree(unit: CodingUnit, x: number, y: number, log2: number, depth: number, part: number, hasCb: boolean, hasCr: boolean): void {
    const { cabac, parameters } = this;
    const { minTransformLog2, maxTransformLog2, maxDepth } = parameters;
    const isForced = unit.isQuartered && depth === 0;
    let isSplit = log2 > maxTransformLog2 || isForced;
    if (!isSplit && log2 > minTransformLog2 && depth < maxDepth + Number(unit.isQuartered)) {
      isSplit = cabac.bit(FIRST.splitTransform + 5 - log2) === 1;
    }
    const cb = hasCb && cabac.bit(FIRST.codedChroma + depth) === 1;
    const cr = hasCr && cabac.bit(FIRST.codedChroma + depth) === 1;
    if (isSplit) {
      const half = 1 << (log2 - 1);
      for (let i = 0; i < 4; i++) {
        this.transformTree(unit, x + (i & 1) * half, y + (i >> 1) * half, log2 - 1, depth + 1, isForced ? i : part, cb, cr);
      }
      return;
    }
    const isCoded = [cabac.bit(FIRST.codedLuma + Number(depth === 0)) === 1, cb, cr];
    const size = 1 << log2;
    for (let row = y; row < y + size; row += 4) this.edges[this.block(x, row)]! |= 1;
    for (let column = x; column < x + size; column += 4) this.edges[this.block(column, y)]! |= 2;
    for (const [c, plane] of this.planes.entries()) {
      const mode = (c ? unit.chroma : unit.luma)[part]!;
      predict(plane, x, y, log2, mode, c === 0, parameters.hasStrongSmoothing);
      if (isCoded[c]) this.residual(plane, x, y, log2, c, mode);
      this.fill(plane.isDecoded, x, y, size, 1);
    }
  }

  private residual(plane: Plane, x: number, y: number, log2: number, c: number, mode: number): void {
    const size = 1 << log2;
    const values = new Int32Array(size * size);
    let scan: Scan = DIAGONAL;
    if (log2 <= 3 && mode >= 6 && mode <= 14) scan = COLUMNS;
    else if (log2 <= 3 && mode >= 22 && mode <= 30) scan = ROWS;
    const about = readResidual(this.cabac, log2, c, scan, this.parameters, values);
    inverse(values, log2, this.qps[c]!, c === 0 && log2 === 2, about);
    const { samples, width } = plane;
    for (let row = 0; row < size; row++) {
      const at = (y + row) * width + x;
      for (let i = 0; i < size; i++) {
        const value = samples[at + i]! + values[row * size + i]!;
        samples[at + i] = value < 0 ? 0 : value > 255 ? 255 : value;
      }
    }
  }
}

interface CodingUnit {
  x: number;
  y: number;
  log2: number;
  isQuartered: boolean;
  /** Modes of one part, or of four. */
  luma: number[];
  chroma: number[];
}
