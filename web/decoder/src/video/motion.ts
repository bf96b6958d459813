/** Motion of blocks, and its prediction from other blocks (ITU-T H.265, 8.5.3.2). Vectors are in quarters of a sample. */

import type { Prediction } from "./slice.js";

const NONE = -1;
const MOST_SCALE = 4096;

/** Motion of each 4 × 4 block of a picture. */
export class MotionField {
  readonly across: number;
  /** Index of each block's reference in the list; −1: intra block, or not decoded. */
  readonly references: Int8Array;
  readonly x: Int16Array;
  readonly y: Int16Array;

  constructor(
    readonly width: number,
    readonly height: number,
    /** Order of the picture; `listed`: orders of the references in the list. */
    readonly order: number,
    readonly listed: number[],
  ) {
    this.across = width >> 2;
    const blocks = this.across * (height >> 2);
    this.references = new Int8Array(blocks).fill(NONE);
    this.x = new Int16Array(blocks);
    this.y = new Int16Array(blocks);
  }

  /** The block that contains this sample, if it has motion; else −1. */
  at(x: number, y: number): number {
    if (x < 0 || y < 0 || x >= this.width || y >= this.height) return NONE;
    const block = (y >> 2) * this.across + (x >> 2);
    return this.references[block]! < 0 ? NONE : block;
  }

  set({ x, y, width, height }: Part, { reference, x: mx, y: my }: Motion): void {
    const columns = width >> 2;
    for (let row = y >> 2; row < (y + height) >> 2; row++) {
      const from = row * this.across + (x >> 2);
      this.references.fill(reference, from, from + columns);
      this.x.fill(mx, from, from + columns);
      this.y.fill(my, from, from + columns);
    }
  }

  of(block: number): Motion {
    return { reference: this.references[block]!, x: this.x[block]!, y: this.y[block]! };
  }

  /** Whether two blocks have the same reference, and vectors closer than one sample. */
  isNear(a: number, b: number): boolean {
    const [first, second] = [this.listed[this.references[a]!], this.listed[this.references[b]!]];
    return first === second && Math.abs(this.x[a]! - this.x[b]!) < 4 && Math.abs(this.y[a]! - this.y[b]!) < 4;
  }

  isEqual(a: number, b: number): boolean {
    return this.references[a] === this.references[b] && this.x[a] === this.x[b] && this.y[a] === this.y[b];
  }
}

/** Index of a reference, and a vector. */
export interface Motion {
  reference: number;
  x: number;
  y: number;
}

/** A prediction part of a coding unit, which has one motion. */
export interface Part {
  x: number;
  y: number;
  width: number;
  height: number;
  /** Index in the unit, and the unit's partition: "" whole, "columns", "rows" or "quarters". */
  number: number;
  cut: Cut;
}

export type Cut = "" | "columns" | "rows" | "quarters";

/** Candidates for the motion of a part, from earlier blocks and pictures. */
export class Candidates {
  constructor(
    private readonly field: MotionField,
    private readonly collocated: MotionField | null,
    private readonly codingTreeLog2: number,
    private readonly prediction: Prediction,
  ) {}

  /** The motion of a merged part: candidate `index` (8.5.3.2.2). */
  merged(part: Part, index: number): Motion {
    const { field } = this;
    const { x, y, width, height, number, cut } = part;
    const left = cut === "columns" && number === 1 ? NONE : field.at(x - 1, y + height - 1);
    const above = cut === "rows" && number === 1 ? NONE : field.at(x + width - 1, y - 1);
    const aboveRight = field.at(x + width, y - 1);
    const belowLeft = field.at(x - 1, y + height);
    const isNew = (block: number, ...others: number[]) => block >= 0 && others.every((other) => other < 0 || !field.isEqual(block, other));
    const found: number[] = [];
    if (left >= 0) found.push(left);
    if (isNew(above, left)) found.push(above);
    if (isNew(aboveRight, above)) found.push(aboveRight);
    if (isNew(belowLeft, left)) found.push(belowLeft);
    if (found.length < 4) {
      const corner = field.at(x - 1, y - 1);
      if (isNew(corner, left, above)) found.push(corner);
    }
    if (index < found.length) return field.of(found[index]!);
    const temporal = this.temporal(part, 0);
    if (temporal && index === found.length) return { reference: 0, ...temporal };
    const zero = index - found.length - Number(temporal !== null);
    return { reference: zero < this.prediction.listed ? zero : 0, x: 0, y: 0 };
  }

  /** The predicted vector, to which the coded difference is added: candidate 0 or 1 (8.5.3.2.6). */
  predicted(part: Part, reference: number, index: number): { x: number; y: number } {
    const { field } = this;
    const { x, y, width, height } = part;
    const besides = [field.at(x - 1, y + height), field.at(x - 1, y + height - 1)].filter((block) => block >= 0);
    const aboves = [field.at(x + width, y - 1), field.at(x + width - 1, y - 1), field.at(x - 1, y - 1)].filter((block) => block >= 0);
    const isOf = (block: number) => field.listed[field.references[block]!] === field.listed[reference];
    const exact = (blocks: number[]) => blocks.filter(isOf).map((block) => field.of(block))[0];
    const scaled = (blocks: number[]) => blocks.map((block) => this.scaled(field, block, reference))[0];
    let beside: Vector | undefined = exact(besides) ?? scaled(besides);
    let above: Vector | undefined = exact(aboves);
    if (besides.length === 0) {
      beside = above;
      above = scaled(aboves);
    }
    const found = [beside, above].filter((vector) => vector !== undefined);
    if (found.length === 2 && found[0]!.x === found[1]!.x && found[0]!.y === found[1]!.y) found.pop();
    if (found.length < 2) {
      const temporal = this.temporal(part, reference);
      if (temporal) found.push(temporal);
    }
    return found[index] ?? { x: 0, y: 0 };
  }

  /** The motion of the collocated picture below right of the part, or at its middle (8.5.3.2.8). */
  private temporal({ x, y, width, height }: Part, reference: number): Vector | null {
    const { collocated, codingTreeLog2 } = this;
    if (!collocated) return null;
    const [right, below] = [x + width, y + height];
    const coarse = (value: number) => (value >> 4) << 4;
    const isInRow = y >> codingTreeLog2 === below >> codingTreeLog2;
    let block = isInRow ? collocated.at(coarse(right), below < collocated.height ? coarse(below) : -1) : NONE;
    if (right >= collocated.width) block = NONE;
    if (block < 0) block = collocated.at(coarse(x + (width >> 1)), coarse(y + (height >> 1)));
    return block < 0 ? null : this.scaled(collocated, block, reference);
  }

  /** The vector of a block, scaled to this picture's distance from its reference. */
  private scaled(from: MotionField, block: number, reference: number): Vector {
    const clip8 = (value: number) => Math.min(Math.max(value, -128), 127);
    const theirs = clip8(from.order - from.listed[from.references[block]!]!);
    const ours = clip8(this.field.order - this.field.listed[reference]!);
    const [x, y] = [from.x[block]!, from.y[block]!];
    if (theirs === ours || theirs === 0) return { x, y };
    const inverse = Math.trunc((16384 + (Math.abs(theirs) >> 1)) / theirs);
    const factor = Math.min(Math.max((ours * inverse + 32) >> 6, -MOST_SCALE), MOST_SCALE - 1);
    const stretched = (value: number) => {
      const product = factor * value;
      return Math.min(Math.max(Math.sign(product) * ((Math.abs(product) + 127) >> 8), -32768), 32767);
    };
    return { x: stretched(x), y: stretched(y) };
  }
}

interface Vector {
  x: number;
  y: number;
}
