/** CABAC, the arithmetic decoder of H.265, with the initial contexts of slices (ITU-T H.265, 9.3). */

import { check } from "../errors.js";

/** Initial values of the contexts, by syntax element (tables 9-5 to 9-37): for intra slices, and for predicted slices. */
const INITIAL = {
  saoMerge: [[153], [153]],
  saoType: [[200], [185]],
  split: [[139, 141, 157], [107, 139, 126]],
  isSkipped: [[], [197, 185, 201]],
  isIntra: [[], [149]],
  parts: [[184], [154, 139, 154, 154]],
  isProbable: [[184], [154]],
  chromaMode: [[63], [152]],
  isMerged: [[], [110]],
  mergeIndex: [[], [122]],
  reference: [[], [153, 153]],
  vector: [[], [140, 198]],
  vectorIndex: [[], [168]],
  hasResidual: [[], [79]],
  splitTransform: [[153, 138, 138], [124, 138, 94]],
  codedLuma: [[111, 141], [153, 111]],
  codedChroma: [[94, 138, 182, 154, 154], [149, 107, 167, 154, 154]],
  skip: [[139, 139], [139, 139]],
  lastX: [
    [110, 110, 124, 125, 140, 153, 125, 127, 140, 109, 111, 143, 127, 111, 79, 108, 123, 63],
    [125, 110, 94, 110, 95, 79, 125, 111, 110, 78, 110, 111, 111, 95, 94, 108, 123, 108],
  ],
  lastY: [
    [110, 110, 124, 125, 140, 153, 125, 127, 140, 109, 111, 143, 127, 111, 79, 108, 123, 63],
    [125, 110, 94, 110, 95, 79, 125, 111, 110, 78, 110, 111, 111, 95, 94, 108, 123, 108],
  ],
  codedBlock: [[91, 171, 134, 141], [121, 140, 61, 154]],
  significant: [
    [
      111, 111, 125, 110, 110, 94, 124, 108, 124, 107, 125, 141, 179, 153, 125, 107, 125, 141, 179, 153, 125, 107, 125, 141, 179, 153, 125,
      140, 139, 182, 182, 152, 136, 152, 136, 153, 136, 139, 111, 136, 139, 111,
    ],
    [
      155, 154, 139, 153, 139, 123, 123, 63, 153, 166, 183, 140, 136, 153, 154, 166, 183, 140, 136, 153, 154, 166, 183, 140, 136, 153, 154,
      170, 153, 123, 123, 107, 121, 107, 121, 167, 151, 183, 140, 151, 183, 140,
    ],
  ],
  aboveOne: [
    [140, 92, 137, 138, 140, 152, 138, 139, 153, 74, 149, 92, 139, 107, 122, 152, 140, 179, 166, 182, 140, 227, 122, 197],
    [154, 196, 196, 167, 154, 152, 167, 182, 182, 134, 149, 136, 153, 121, 136, 137, 169, 194, 166, 167, 154, 167, 137, 182],
  ],
  aboveTwo: [
    [138, 153, 136, 167, 152, 152],
    [107, 167, 91, 122, 107, 167],
  ],
} as const;

type Element = keyof typeof INITIAL;

/** The number of the first context of each syntax element. */
export const FIRST = (() => {
  let next = 0;
  const first = {} as Record<Element, number>;
  for (const [name, [, values]] of Object.entries(INITIAL)) {
    first[name as Element] = next;
    next += values.length;
  }
  return first;
})();

/** Table 9-46: the range of the less probable symbol, for each state and quarter of the range. */
const LESS_PROBABLE = Uint8Array.from(
  [
    [128, 176, 208, 240], [128, 167, 197, 227], [128, 158, 187, 216], [123, 150, 178, 205], [116, 142, 169, 195], [111, 135, 160, 185],
    [105, 128, 152, 175], [100, 122, 144, 166], [95, 116, 137, 158], [90, 110, 130, 150], [85, 104, 123, 142], [81, 99, 117, 135],
    [77, 94, 111, 128], [73, 89, 105, 122], [69, 85, 100, 116], [66, 80, 95, 110], [62, 76, 90, 104], [59, 72, 86, 99],
    [56, 69, 81, 94], [53, 65, 77, 89], [51, 62, 73, 85], [48, 59, 69, 80], [46, 56, 66, 76], [43, 53, 63, 72],
    [41, 50, 59, 69], [39, 48, 56, 65], [37, 45, 54, 62], [35, 43, 51, 59], [33, 41, 48, 56], [32, 39, 46, 53],
    [30, 37, 43, 50], [29, 35, 41, 48], [27, 33, 39, 45], [26, 31, 37, 43], [24, 30, 35, 41], [23, 28, 33, 39],
    [22, 27, 32, 37], [21, 26, 30, 35], [20, 24, 29, 33], [19, 23, 27, 31], [18, 22, 26, 30], [17, 21, 25, 28],
    [16, 20, 23, 27], [15, 19, 22, 25], [14, 18, 21, 24], [14, 17, 20, 23], [13, 16, 19, 22], [12, 15, 18, 21],
    [12, 14, 17, 20], [11, 14, 16, 19], [11, 13, 15, 18], [10, 12, 15, 17], [10, 12, 14, 16], [9, 11, 13, 15],
    [9, 11, 12, 14], [8, 10, 12, 14], [8, 9, 11, 13], [7, 9, 11, 12], [7, 9, 10, 12], [7, 8, 10, 11],
    [6, 8, 9, 11], [6, 7, 9, 10], [6, 7, 8, 9], [2, 2, 2, 2],
  ].flat(),
);

/** Table 9-47: the state after the less probable symbol. */
const AFTER_LESS_PROBABLE = [
  0, 0, 1, 2, 2, 4, 4, 5, 6, 7, 8, 9, 9, 11, 11, 12, 13, 13, 15, 15, 16, 16, 18, 18, 19, 19, 21, 21, 22, 22, 23, 24,
  24, 25, 26, 26, 27, 27, 28, 29, 29, 30, 30, 30, 31, 32, 32, 33, 33, 33, 34, 34, 35, 35, 35, 36, 36, 36, 37, 37, 37, 38, 38, 63,
];

/** Most bytes that the decoder's window extends past the end of a slice. */
const MOST_BYTES_BEYOND = 4;

export class Cabac {
  private readonly states: Uint8Array;
  private readonly probable: Uint8Array;
  private range = 510;
  private offset = 0;
  private at = 0;

  constructor(
    private readonly data: Uint8Array,
    qp: number,
    isPredicted: boolean,
  ) {
    const values = Object.values(INITIAL).flatMap(([alone, predicted]) => predicted.map((value, i) => (isPredicted ? value : (alone[i] ?? value))));
    this.states = new Uint8Array(values.length);
    this.probable = new Uint8Array(values.length);
    values.forEach((value, i) => {
      const slope = 5 * (value >> 4) - 45;
      const state = Math.min(Math.max(((slope * qp) >> 4) + 8 * (value & 15) - 16, 1), 126);
      this.probable[i] = Number(state > 63);
      this.states[i] = state > 63 ? state - 64 : 63 - state;
    });
    for (let i = 0; i < 9; i++) this.offset = (this.offset << 1) | this.next();
  }

  private next(): number {
    const byte = this.at >> 3;
    check(byte < this.data.length + MOST_BYTES_BEYOND, "picture: the slice is cut off");
    const bit = byte < this.data.length ? (this.data[byte]! >> (7 - (this.at & 7))) & 1 : 0;
    this.at++;
    return bit;
  }

  /** Reads a bit in a context. */
  bit(context: number): number {
    const state = this.states[context]!;
    const less = LESS_PROBABLE[4 * state + ((this.range >> 6) & 3)]!;
    let bit = this.probable[context]!;
    this.range -= less;
    if (this.offset >= this.range) {
      this.offset -= this.range;
      this.range = less;
      bit = 1 - bit;
      if (state === 0) this.probable[context] = bit;
      this.states[context] = AFTER_LESS_PROBABLE[state]!;
    } else if (state < 62) this.states[context] = state + 1;
    while (this.range < 256) {
      this.range <<= 1;
      this.offset = (this.offset << 1) | this.next();
    }
    return bit;
  }

  /** Reads a bypass bit, of probability 1/2. */
  plain(): number {
    this.offset = (this.offset << 1) | this.next();
    if (this.offset < this.range) return 0;
    this.offset -= this.range;
    return 1;
  }

  /** Reads a number of `count` bypass bits, highest first. */
  number(count: number): number {
    let value = 0;
    for (let i = 0; i < count; i++) value = 2 * value + this.plain();
    return value;
  }

  /** Counts bypass ones before the first zero, up to `most`. */
  ones(most: number): number {
    let count = 0;
    while (count < most && this.plain()) count++;
    return count;
  }

  /** Reads an exponential Golomb code of order 1, in bypass bits. */
  golomb(): number {
    let order = 1;
    let base = 0;
    while (this.plain()) {
      base += 2 ** order++;
      check(order < 18, "picture: a vector is too long");
    }
    return base + this.number(order);
  }

  /** Reads the bit that ends a slice. */
  ends(): boolean {
    this.range -= 2;
    if (this.offset >= this.range) return true;
    if (this.range < 256) {
      this.range <<= 1;
      this.offset = (this.offset << 1) | this.next();
    }
    return false;
  }
}
