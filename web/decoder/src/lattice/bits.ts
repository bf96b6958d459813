/** Adaptive bits of the lattice engine: five mixed counters and a range coder (docs/payloads/tempo-lattice.md, "Adaptive bits"). */

import { check } from "../errors.js";

export const INPUTS = 5;
const COUNTERS = 1 << 15;
const MIXERS = 328;
const FIRST_WEIGHT = 18350;
const MOST_WEIGHT = 1 << 22;
const MOST_SEEN = 250;
const HASH = 2654435761 | 0;

export const SQUASH = Int32Array.from({ length: 4096 }, (_, i) => Math.min(Math.max(Math.floor(65536 / (1 + Math.exp(-(i - 2048) / 256)) + 0.5), 16), 65520));
export const STRETCH = Int32Array.from({ length: 4096 }, (_, i) => {
  const share = (i + 0.5) / 4096;
  return Math.min(Math.max(Math.floor(256 * Math.log(share / (1 - share)) + 0.5), -2047), 2047);
});
export const RATE = Int32Array.from({ length: MOST_SEEN + 1 }, (_, i) => Math.floor(65536 / (i + 1.6)));

/** Updates a mixer's weight after a bit. */
function shifted(weight: number, stretched: number, error: number): number {
  const moved = weight + (Math.imul(stretched, error) >> 16);
  return moved < -MOST_WEIGHT ? -MOST_WEIGHT : moved > MOST_WEIGHT ? MOST_WEIGHT : moved;
}

export class AdaptiveBits {
  /** Context of each input, times 257; `bit` adds the kind of bit. */
  readonly contexts = new Int32Array(INPUTS);
  private readonly probabilities = new Uint16Array(INPUTS * COUNTERS).fill(32768);
  private readonly seen = new Uint8Array(INPUTS * COUNTERS);
  private readonly weights = new Int32Array(INPUTS * MIXERS).fill(FIRST_WEIGHT);
  /** Low and high end of the range, and the code within it. */
  private readonly range = Uint32Array.of(0, 0xffffffff, 0);
  private at = 0;

  constructor(private readonly data: Uint8Array) {
    for (let i = 0; i < 4; i++) this.range[2] = (this.range[2]! << 8) | this.next();
  }

  /** Reads a bit of a kind in the current contexts, with the weights of a mixer. */
  bit(kind: number, mixer: number): number {
    const { contexts, probabilities, weights } = this;
    const slot0 = Math.imul(contexts[0]! + kind, HASH) >>> 17;
    const slot1 = COUNTERS + (Math.imul(contexts[1]! + kind, HASH) >>> 17);
    const slot2 = 2 * COUNTERS + (Math.imul(contexts[2]! + kind, HASH) >>> 17);
    const slot3 = 3 * COUNTERS + (Math.imul(contexts[3]! + kind, HASH) >>> 17);
    const slot4 = 4 * COUNTERS + (Math.imul(contexts[4]! + kind, HASH) >>> 17);
    const stretched0 = STRETCH[probabilities[slot0]! >> 4]!;
    const stretched1 = STRETCH[probabilities[slot1]! >> 4]!;
    const stretched2 = STRETCH[probabilities[slot2]! >> 4]!;
    const stretched3 = STRETCH[probabilities[slot3]! >> 4]!;
    const stretched4 = STRETCH[probabilities[slot4]! >> 4]!;
    const first = INPUTS * mixer;
    const sum =
      weights[first]! * stretched0 +
      weights[first + 1]! * stretched1 +
      weights[first + 2]! * stretched2 +
      weights[first + 3]! * stretched3 +
      weights[first + 4]! * stretched4;
    const place = Math.floor(sum / 65536);
    const probability = SQUASH[(place < -2048 ? -2048 : place > 2047 ? 2047 : place) + 2048]!;
    const bit = this.decode(probability);
    const error = 3 * (65536 * bit - probability);
    weights[first] = shifted(weights[first]!, stretched0, error);
    weights[first + 1] = shifted(weights[first + 1]!, stretched1, error);
    weights[first + 2] = shifted(weights[first + 2]!, stretched2, error);
    weights[first + 3] = shifted(weights[first + 3]!, stretched3, error);
    weights[first + 4] = shifted(weights[first + 4]!, stretched4, error);
    const goal = 65535 * bit;
    this.count(slot0, goal);
    this.count(slot1, goal);
    this.count(slot2, goal);
    this.count(slot3, goal);
    this.count(slot4, goal);
    return bit;
  }

  /** Moves a counter's probability towards 0 or 65535. Products fit in 31 bits, since a new counter starts at 32768. */
  private count(slot: number, goal: number): void {
    const { probabilities, seen } = this;
    const p = probabilities[slot]!;
    const count = seen[slot]!;
    probabilities[slot] = p + (Math.imul(goal - p, RATE[count]!) >> 16);
    if (count < MOST_SEEN) seen[slot] = count + 1;
  }

  /** Reads a bit of probability 1/2. */
  evenBit(): number {
    return this.decode(32768);
  }

  /** Checks that all bytes were read, and at most four past the end. */
  end(): void {
    check(this.at >= this.data.length && this.at <= this.data.length + 4, "tempo: the lattice stream has a wrong end");
  }

  private decode(probability: number): number {
    const { range } = this;
    let low = range[0]!;
    let high = range[1]!;
    const extent = high - low;
    const middle = low + (extent >>> 16) * probability + (Math.imul(extent & 0xffff, probability) >>> 16);
    const bit = range[2]! <= middle ? 1 : 0;
    if (bit) high = middle;
    else low = middle + 1;
    while ((low ^ high) >>> 24 === 0) {
      low = (low << 8) >>> 0;
      high = ((high << 8) | 255) >>> 0;
      range[2] = (range[2]! << 8) | this.next();
    }
    range[0] = low;
    range[1] = high;
    return bit;
  }

  private next(): number {
    const byte = this.at < this.data.length ? this.data[this.at]! : 0;
    this.at++;
    return byte;
  }
}
