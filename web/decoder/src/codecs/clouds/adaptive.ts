/** Adaptive bits, which code masks and octrees (docs/payloads/bodycast.md). */

import { check } from "../../errors.js";

const SCALE_BITS = 14;
const FULL = 2 ** SCALE_BITS;
const CHECK_FREQUENCY = 64;
const MOST_COUNT = 4096;

/** Counts of zeros and ones in each context of one kind of bits. */
export class Counts {
  readonly zeros: Int32Array;
  readonly ones: Int32Array;
  private readonly touched: Int32Array;
  private turn = 0;

  constructor(contexts: number) {
    this.zeros = new Int32Array(contexts).fill(2);
    this.ones = new Int32Array(contexts).fill(2);
    this.touched = new Int32Array(contexts);
  }

  /** The frequency of a zero, out of 2^14. */
  zero(context: number): number {
    const [zeros, ones] = [this.zeros[context]!, this.ones[context]!];
    return 1 + (((FULL - 2) * (255 - 2 * Math.floor((128 * ones) / (zeros + ones)))) >> 8);
  }

  /** Counts the bits of a group. */
  learn(contexts: Int32Array, bits: Uint8Array): void {
    this.turn++;
    contexts.forEach((context, i) => ((bits[i] ? this.ones : this.zeros)[context]! += 2));
    for (const context of contexts) {
      if (this.touched[context] === this.turn) continue;
      this.touched[context] = this.turn;
      const [zeros, ones] = [this.zeros[context]!, this.ones[context]!];
      if (zeros + ones <= MOST_COUNT) continue;
      this.zeros[context] = Math.max(zeros >> 1, 1);
      this.ones[context] = Math.max(ones >> 1, 1);
    }
  }
}

export class AdaptiveBits {
  private x = 0;
  private at: number;

  constructor(private readonly data: Uint8Array) {
    const size = data.length;
    this.at = size <= 4 ? size : size % 2 ? 3 : 4;
    for (let i = this.at - 1; i >= 0; i--) this.x = this.x * 256 + data[i]!;
    check(this.x % FULL >= CHECK_FREQUENCY, "bodycast: adaptive bits have a wrong beginning");
    this.take(CHECK_FREQUENCY, FULL - CHECK_FREQUENCY);
  }

  private take(start: number, frequency: number): void {
    this.x = frequency * Math.floor(this.x / FULL) + (this.x % FULL) - start;
    this.refill();
  }

  private refill(): void {
    if (this.x >= 65536 || this.at + 2 > this.data.length) return;
    this.x = this.x * 65536 + this.data[this.at]! + 256 * this.data[this.at + 1]!;
    this.at += 2;
  }

  /** Reads a group of bits, one for each context. */
  group(counts: Counts, contexts: Int32Array): Uint8Array {
    const bits = new Uint8Array(contexts.length);
    contexts.forEach((context, i) => {
      const zero = counts.zero(context);
      if (this.x % FULL < zero) this.take(0, zero);
      else {
        bits[i] = 1;
        this.take(zero, FULL - zero);
      }
    });
    counts.learn(contexts, bits);
    return bits;
  }

  /** Reads the `total` raw bits at the end. */
  raw(total: number): Uint8Array {
    check(total <= 8 * this.data.length + 32, "bodycast: adaptive bits are cut off");
    const bits = new Uint8Array(total);
    let end = total;
    while (end > 0) {
      const count = end >= 8 ? 8 : end;
      const value = this.x % 2 ** count;
      for (let i = 0; i < count; i++) bits[end - 1 - i] = (value >> i) & 1;
      this.x = Math.floor(this.x / 2 ** count);
      this.refill();
      end -= count;
    }
    check(this.x === 1 && this.at >= this.data.length, "bodycast: adaptive bits have a wrong end");
    return bits;
  }
}
