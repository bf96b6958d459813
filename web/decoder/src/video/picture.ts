/**
 * Pictures of H.265: 4:4:4, 8 bits, one slice, with the tools that mocodec's encoder uses (ITU-T H.265).
 *
 *     packet ─► parameters · slice ─► blocks: intra or inter prediction, + residual
 *            ─► deblocking ─► sample offsets
 */

import { check } from "../errors.js";
import { Cabac, FIRST } from "./cabac.js";
import { LEFT, PART_SHIFT, TOP, deblock } from "./deblocking.js";
import { predictFrom } from "./inter.js";
import { ACROSS, DOWN, MEAN, PLANAR, type Plane, predict } from "./intra.js";
import { Candidates, type Cut, type Motion, MotionField, type Part } from "./motion.js";
import { addOffsets, type Offsets, readOffsets } from "./offsets.js";
import { COLUMNS, DIAGONAL, ROWS, type Scan, readResidual } from "./residual.js";
import type { Parameters, Prediction } from "./slice.js";
import { inverse } from "./transform.js";

/** A decoded picture: three planes of samples, row by row, and its motion. */
export interface CodedPicture {
  order: number;
  planes: Uint8Array[];
  motion: MotionField;
}

const MOST_QP = 51;
const CHROMA_AS_LUMA = 4;
const CHROMA_MODES = [PLANAR, DOWN, ACROSS, MEAN];
const CHROMA_OTHER = 34;
/** The mode of inter blocks. */
const NO_MODE = -1;

export class PictureDecoder {
  private readonly planes: Plane[];
  private readonly cabac: Cabac;
  private readonly qps: number[];
  /** Facts of each 4 × 4 block: depth of its coding unit (−1: not decoded), luma mode, and the fields of `Blocks`. */
  private readonly depths: Int8Array;
  private readonly modes: Uint8Array;
  readonly edges: Uint8Array;
  private readonly isSkipped: Uint8Array;
  readonly isCoded: Uint8Array;
  readonly motion: MotionField;
  private readonly candidates: Candidates | null;
  private readonly across: number;

  /** order: number of the picture; references: pictures in the slice's list. */
  constructor(
    private readonly parameters: Parameters,
    slice: Uint8Array,
    private readonly order: number,
    private readonly references: CodedPicture[],
  ) {
    const { width, height, qp, qpOffsets, prediction, codingTreeLog2 } = parameters;
    this.across = width >> 2;
    const blocks = this.across * (height >> 2);
    this.planes = [0, 1, 2].map(() => ({ width, height, samples: new Uint8Array(width * height), isDecoded: new Uint8Array(blocks) }));
    this.depths = new Int8Array(blocks).fill(-1);
    this.modes = new Uint8Array(blocks).fill(MEAN);
    this.edges = new Uint8Array(blocks);
    this.isSkipped = new Uint8Array(blocks);
    this.isCoded = new Uint8Array(blocks);
    this.motion = new MotionField(width, height, order, references.map((reference) => reference.order));
    const collocated = prediction && references[prediction.collocated]?.motion;
    this.candidates = prediction && new Candidates(this.motion, collocated ?? null, codingTreeLog2, prediction);
    this.cabac = new Cabac(slice, qp, prediction !== null);
    this.qps = [qp, ...qpOffsets.map((offset) => Math.min(Math.max(qp + offset, 0), MOST_QP))];
  }

  decode(): CodedPicture {
    const { parameters, planes, cabac } = this;
    const { width, height, codingTreeLog2, saoLuma, saoChroma } = parameters;
    const size = 1 << codingTreeLog2;
    const columns = Math.ceil(width / size);
    const units = columns * Math.ceil(height / size);
    const offsets: Offsets[] = [];
    for (let i = 0; i < units; i++) {
      if (saoLuma || saoChroma) offsets.push(readOffsets(cabac, parameters, offsets, i, columns));
      this.quadtree((i % columns) * size, Math.floor(i / columns) * size, codingTreeLog2, 0);
      check(cabac.ends() === (i === units - 1), "picture: the slice has a wrong end");
    }
    if (parameters.deblocks) deblock(planes, this, parameters);
    if (offsets.length) addOffsets(planes, offsets, size);
    return { order: this.order, planes: planes.map(({ samples }) => samples), motion: this.motion };
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
    const size = 1 << log2;
    this.fill(this.depths, x, y, size, depth);
    this.markEdges(x, y, size, size, 0);
    const { prediction } = parameters;
    if (prediction) {
      const left = x > 0 ? this.isSkipped[this.block(x - 1, y)]! : 0;
      const above = y > 0 ? this.isSkipped[this.block(x, y - 1)]! : 0;
      if (cabac.bit(FIRST.isSkipped + left + above)) {
        this.fill(this.isSkipped, x, y, size, 1);
        this.movePart({ x, y, width: size, height: size, number: 0, cut: "" }, prediction, true);
        return this.finish(x, y, size);
      }
      if (!cabac.bit(FIRST.isIntra)) return this.movedUnit(x, y, log2, prediction);
    }
    const isQuartered = log2 === parameters.minCodingLog2 && cabac.bit(FIRST.parts) === 0;
    const parts = isQuartered ? 4 : 1;
    const partSize = size >> Number(isQuartered);
    const probable = Array.from({ length: parts }, () => cabac.bit(FIRST.isProbable) === 1);
    const luma = probable.map((isProbable, i) => {
      const [px, py] = [x + (i & 1) * partSize, y + (i >> 1) * partSize];
      const mode = this.lumaMode(px, py, isProbable);
      this.fill(this.modes, px, py, partSize, mode);
      return mode;
    });
    const chroma = luma.map((mode) => {
      const choice = cabac.bit(FIRST.chromaMode) ? cabac.number(2) : CHROMA_AS_LUMA;
      if (choice === CHROMA_AS_LUMA) return mode;
      return CHROMA_MODES[choice] === mode ? CHROMA_OTHER : CHROMA_MODES[choice]!;
    });
    const maxDepth = parameters.maxIntraDepth + Number(isQuartered);
    this.transformTree({ isMoved: false, splitsFirst: isQuartered, isQuartered, maxDepth, luma, chroma }, x, y, log2, 0, 0, true, true);
  }

  /** Decodes an inter unit that has vectors or a residual (not skipped). */
  private movedUnit(x: number, y: number, log2: number, prediction: Prediction): void {
    const { cabac, parameters } = this;
    const parts = partsOf(x, y, 1 << log2, this.readCut(log2));
    let isMerged = false;
    for (const part of parts) {
      if (part.number) this.markEdges(part.x, part.y, part.width, part.height, PART_SHIFT);
      isMerged = this.movePart(part, prediction, false);
    }
    const isWhole = parts.length === 1;
    if ((isWhole && isMerged) || cabac.bit(FIRST.hasResidual)) {
      const splitsFirst = parameters.maxInterDepth === 0 && !isWhole;
      this.transformTree({ isMoved: true, splitsFirst, isQuartered: false, maxDepth: parameters.maxInterDepth, luma: [], chroma: [] }, x, y, log2, 0, 0, true, true);
    }
    this.finish(x, y, 1 << log2);
  }

  /** part_mode (7.3.8.5): the partition of a unit, and its first part's size in quarters of the unit. */
  private readCut(log2: number): { cut: Cut; quarters: number } {
    const { cabac, parameters } = this;
    if (cabac.bit(FIRST.parts)) return { cut: "", quarters: 4 };
    const isSmallest = log2 === parameters.minCodingLog2;
    const isRows = cabac.bit(FIRST.parts + 1) === 1;
    const cut = isRows ? "rows" : "columns";
    if (isSmallest) {
      const isQuartered = !isRows && log2 > 3 && cabac.bit(FIRST.parts + 2) === 0;
      return { cut: isQuartered ? "quarters" : cut, quarters: 2 };
    }
    if (!parameters.hasUnevenParts || cabac.bit(FIRST.parts + 3)) return { cut, quarters: 2 };
    return { cut, quarters: cabac.plain() ? 3 : 1 };
  }

  /** Reads the motion of a part and predicts its samples. Returns whether the part is merged. */
  private movePart(part: Part, prediction: Prediction, isSkipped: boolean): boolean {
    const { cabac, motion, candidates, references } = this;
    const isMerged = isSkipped || cabac.bit(FIRST.isMerged) === 1;
    const own = isMerged ? candidates!.merged(part, this.mergeIndex(prediction)) : this.readMotion(part, prediction);
    motion.set(part, own);
    const reference = references[own.reference];
    check(reference !== undefined, "picture: a reference that does not exist");
    for (const [c, { samples }] of this.planes.entries()) {
      predictFrom(reference.planes[c]!, samples, c, this.parameters, part, own, prediction.weights?.[own.reference]![c] ?? null);
    }
    return isMerged;
  }

  private mergeIndex({ mostMerged }: Prediction): number {
    if (mostMerged < 2 || !this.cabac.bit(FIRST.mergeIndex)) return 0;
    return 1 + this.cabac.ones(mostMerged - 2);
  }

  private readMotion(part: Part, { listed }: Prediction): Motion {
    const { cabac } = this;
    let reference = 0;
    while (reference < Math.min(2, listed - 1) && cabac.bit(FIRST.reference + reference)) reference++;
    if (reference === 2) reference += cabac.ones(listed - 3);
    const isOther = [cabac.bit(FIRST.vector), cabac.bit(FIRST.vector)];
    const isLong = isOther.map((is) => is && cabac.bit(FIRST.vector + 1));
    const [dx, dy] = isOther.map((is, i) => {
      if (!is) return 0;
      const size = isLong[i] ? 2 + cabac.golomb() : 1;
      return cabac.plain() ? -size : size;
    }) as [number, number];
    const { x, y } = this.candidates!.predicted(part, reference, cabac.bit(FIRST.vectorIndex));
    return { reference, x: ((x + dx) << 16) >> 16, y: ((y + dy) << 16) >> 16 };
  }

  /** Marks the samples of a unit as decoded. */
  private finish(x: number, y: number, size: number): void {
    for (const { isDecoded } of this.planes) this.fill(isDecoded, x, y, size, 1);
  }

  private markEdges(x: number, y: number, width: number, height: number, shift: number): void {
    for (let row = y; row < y + height; row += 4) this.edges[this.block(x, row)]! |= LEFT << shift;
    for (let column = x; column < x + width; column += 4) this.edges[this.block(column, y)]! |= TOP << shift;
  }

  /** Reads the luma mode: one of the three most probable modes, or another (8.4.2). */
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
    const { minTransformLog2, maxTransformLog2 } = parameters;
    const isForced = unit.splitsFirst && depth === 0;
    let isSplit = log2 > maxTransformLog2 || (isForced && log2 > minTransformLog2);
    if (!isSplit && log2 > minTransformLog2 && depth < unit.maxDepth) isSplit = cabac.bit(FIRST.splitTransform + 5 - log2) === 1;
    const cb = hasCb && cabac.bit(FIRST.codedChroma + depth) === 1;
    const cr = hasCr && cabac.bit(FIRST.codedChroma + depth) === 1;
    if (isSplit) {
      const half = 1 << (log2 - 1);
      for (let i = 0; i < 4; i++) {
        const own = unit.isQuartered && depth === 0 ? i : part;
        this.transformTree(unit, x + (i & 1) * half, y + (i >> 1) * half, log2 - 1, depth + 1, own, cb, cr);
      }
      return;
    }
    const isLumaCoded = (unit.isMoved && depth === 0 && !cb && !cr) || cabac.bit(FIRST.codedLuma + Number(depth === 0)) === 1;
    const isCoded = [isLumaCoded, cb, cr];
    const size = 1 << log2;
    this.markEdges(x, y, size, size, 0);
    if (isLumaCoded) this.fill(this.isCoded, x, y, size, 1);
    for (const [c, plane] of this.planes.entries()) {
      const mode = unit.isMoved ? NO_MODE : (c ? unit.chroma : unit.luma)[part]!;
      if (!unit.isMoved) predict(plane, x, y, log2, mode, c === 0, parameters.hasStrongSmoothing);
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
    inverse(values, log2, this.qps[c]!, c === 0 && log2 === 2 && mode !== NO_MODE, about);
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
  /** Whether it is an inter unit. */
  isMoved: boolean;
  splitsFirst: boolean;
  isQuartered: boolean;
  maxDepth: number;
  /** Intra modes of one part, or of four. */
  luma: number[];
  chroma: number[];
}

/** The parts of a unit. quarters: height or width of the first part, in quarters of the unit. */
function partsOf(x: number, y: number, size: number, { cut, quarters }: { cut: Cut; quarters: number }): Part[] {
  const first = (size * quarters) >> 2;
  const part = (dx: number, dy: number, width: number, height: number, number: number): Part => ({ x: x + dx, y: y + dy, width, height, number, cut });
  if (cut === "") return [part(0, 0, size, size, 0)];
  if (cut === "rows") return [part(0, 0, size, first, 0), part(0, first, size, size - first, 1)];
  if (cut === "columns") return [part(0, 0, first, size, 0), part(first, 0, size - first, size, 1)];
  return [0, 1, 2, 3].map((i) => part((i & 1) * first, (i >> 1) * first, first, first, i));
}
