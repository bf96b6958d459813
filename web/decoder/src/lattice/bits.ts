/** Adaptive bits of the lattice engine: five counters, mixed, and a range coder (docs/payloads/tempo-lattice.md, "Adaptive bits"). */

import { check } from "../errors.js";

export const INPUTS = 5;
const COUNTERS = 1 << 15;
const MIXERS = 328;
const FIRST_WEIGHT = 18350;
const MOST_WEIGHT = 1 << 22;
const MOST_SEEN = 250;
const HASH = 2654435761 | 0;

const SQUASH = Int32Array.from({ length: 4096 }, (_, i) => Math.min(Math.max(Math.floor(65536 / (1 + Math.exp(-(i - 2048) / 256)) + 0.5), 16), 65520));
const STRETCH = Int32Array.from({ length: 4096 }, (_, i) => {
  const share = (i + 0.5) / 4096;
  return Math.min(Math.max(Math.floor(256 * Math.log(share / (1 - share)) + 0.5), -2047), 2047);
});
const RATE = Int32Array.from({ length: MOST_SEEN + 1 }, (_, i) => Math.floor(65536 / (i + 1.6)));

export class AdaptiveBits {
  /** Context of each input, times 257; the kind of a bit is added. */
  readonly contexts = new Int32Array(INPUTS);
  private readonly probabilities = new Uint16Array(INPUTS * COUNTERS).fill(32768);
  private readonly seen = new Uint8Array(INPUTS * COUNTERS);
  private readonly weights = new Int32Array(INPUTS * MIXERS).fill(FIRST_WEIGHT);
  private readonly slots = new Int32Array(INPUTS);
  private readonly stretched = new Int32Array(INPUTS);
  private low = 0;
  private high = 0xffffffff;
  private code = 0;
  private at = 0;

  constructor(private readonly data: Uint8Array) {
    for (let i = 0; i < 4; i++) this.code = this.code * 256 + this.next();
  }

  /** A bit of a kind, under the contexts, with the weights of a mixer. */
  bit(kind: number, mixer: number): number {
    const { contexts, slots, stretched, probabilities, weights, seen } = this;
    const first = INPUTS * mixer;
    let sum = 0;
    for (let i = 0; i < INPUTS; i++) {
      const slot = i * COUNTERS + (Math.imul(contexts[i]! + kind, HASH) >>> 17);
      slots[i] = slot;
      const st = STRETCH[probabilities[slot]! >> 4]!;
      stretched[i] = st;
      sum += weights[first + i]! * st;
    }
    const place = Math.floor(sum / 65536);
    const probability = SQUASH[(place < -2048 ? -2048 : place > 2047 ? 2047 : place) + 2048]!;
    const bit = this.decode(probability);
    const error = 65536 * bit - probability;
    for (let i = 0; i < INPUTS; i++) {
      const weight = weights[first + i]! + ((stretched[i]! * error * 3) >> 16);
      weights[first + i] = weight < -MOST_WEIGHT ? -MOST_WEIGHT : weight > MOST_WEIGHT ? MOST_WEIGHT : weight;
      const slot = slots[i]!;
      const p = probabilities[slot]!;
      const count = seen[slot]!;
      probabilities[slot] = p + Math.floor(((65535 * bit - p) * RATE[count]!) / 65536);
      if (count < MOST_SEEN) seen[slot] = count + 1;
    }
    return bit;
  }

  /** A bit of probability 1/2. */
  evenBit(): number {
    return this.decode(32768);
  }

  /** All bytes must have been read, and at most four beyond their end. */
  end(): void {
    check(this.at >= this.data.length && this.at <= this.data.length + 4, "tempo: the lattice stream does not end where it should");
  }

  private decode(probability: number): number {
    const extent = this.high - this.low;
    const middle = this.low + (extent >>> 16) * probability + (((extent & 0xffff) * probability) >>> 16);
    const bit = this.code <= middle ? 1 : 0;
    if (bit) this.high = middle;
    else this.low = middle + 1;
    while ((this.low ^ this.high) >>> 24 === 0) {
      this.low = (this.low << 8) >>> 0;
      this.high = ((this.high << 8) | 255) >>> 0;
      this.code = ((this.code << 8) | this.next()) >>> 0;
    }
    return bit;
  }

  private next(): number {
    const byte = this.at < this.data.length ? this.data[this.at]! : 0;
    this.at++;
    return byte;
  }
}
