/** Mixed bits (docs/payloads/bodycast-points.md). */

import { check } from "../../errors.js";
import { clip } from "../../numbers.js";

const CONTEXTS = 5;
const COUNTERS = 2 ** 15;
const WEIGHT_SETS = 2048;
const FIRST_WEIGHT = 18_350;
const MOST_SEEN = 250;
const MOST_WEIGHT = 2 ** 22;
const MOST_BEYOND = 4;

const SQUASH = Int32Array.from({ length: 4096 }, (_, x) => clip(Math.floor(65536 / (1 + Math.exp(-(x - 2048) / 256)) + 0.5), 16, 65520));
const STRETCH = Int32Array.from({ length: 4096 }, (_, x) => {
  const q = (x + 0.5) / 4096;
  return clip(Math.floor(256 * Math.log(q / (1 - q)) + 0.5), -2047, 2047);
});
const RATE = Int32Array.from({ length: MOST_SEEN + 1 }, (_, k) => Math.floor(65536 / (k + 1.6)));

export class MixedBits {
  private readonly probabilities = new Int32Array(CONTEXTS * COUNTERS).fill(2 ** 15);
  private readonly seen = new Uint8Array(CONTEXTS * COUNTERS);
  private readonly weights = new Int32Array(CONTEXTS * WEIGHT_SETS).fill(FIRST_WEIGHT);
  private readonly counters = new Int32Array(CONTEXTS);
  private readonly stretched = new Int32Array(CONTEXTS);
  private low = 0;
  private high = 2 ** 32 - 1;
  private code = 0;
  private at = 0;

  constructor(private readonly data: Uint8Array) {
    for (let i = 0; i < 4; i++) this.code = this.code * 256 + this.next();
  }

  private next(): number {
    check(this.at < this.data.length + MOST_BEYOND, "bodycast: mixed bits are cut off");
    return this.data[this.at++] ?? 0;
  }

  /** Reads a bit with five contexts. */
  bit(c0: number, c1: number, c2: number, c3: number, c4: number, set: number): number {
    const { probabilities, seen, weights, counters, stretched } = this;
    counters[0] = Math.imul(Math.imul(257, c0), 2654435761) >>> 17;
    counters[1] = COUNTERS + (Math.imul(Math.imul(257, c1), 2654435761) >>> 17);
    counters[2] = 2 * COUNTERS + (Math.imul(Math.imul(257, c2), 2654435761) >>> 17);
    counters[3] = 3 * COUNTERS + (Math.imul(Math.imul(257, c3), 2654435761) >>> 17);
    counters[4] = 4 * COUNTERS + (Math.imul(Math.imul(257, c4), 2654435761) >>> 17);
    let sum = 0;
    for (let i = 0; i < CONTEXTS; i++) {
      stretched[i] = STRETCH[probabilities[counters[i]!]! >> 4]!;
      sum += weights[CONTEXTS * set + i]! * stretched[i]!;
    }
    const p = SQUASH[clip(Math.floor(sum / 65536), -2048, 2047) + 2048]!;
    const range = this.high - this.low;
    const middle = this.low + Math.floor(range / 65536) * p + Math.floor(((range % 65536) * p) / 65536);
    const bit = this.code <= middle ? 1 : 0;
    if (bit) this.high = middle;
    else this.low = middle + 1;
    while (this.low >>> 24 === this.high >>> 24) {
      this.low = (this.low << 8) >>> 0;
      this.high = ((this.high << 8) | 255) >>> 0;
      this.code = ((this.code << 8) | this.next()) >>> 0;
    }
    const error = 65536 * bit - p;
    for (let i = 0; i < CONTEXTS; i++) {
      const at = CONTEXTS * set + i;
      weights[at] = clip(weights[at]! + ((3 * stretched[i]! * error) >> 16), -MOST_WEIGHT, MOST_WEIGHT);
      const k = counters[i]!;
      probabilities[k]! += Math.floor((((bit ? 65535 : 0) - probabilities[k]!) * RATE[seen[k]!]!) / 65536);
      if (seen[k]! < MOST_SEEN) seen[k]!++;
    }
    return bit;
  }

  /** Throws Corrupt if bytes are left. */
  end(): void {
    check(this.at >= this.data.length, "bodycast: mixed bits are left over");
  }
}
