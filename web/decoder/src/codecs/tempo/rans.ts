/** rANS with 12 bits of precision; all states share one word stream (docs/payloads/tempo.md, "Order of symbols"). */

import { Bits, Bytes } from "../../bytes.js";
import { check } from "../../errors.js";

export interface Table {
  start: Uint16Array;
  frequency: Uint16Array;
  symbolOf: Uint8Array;
}

/** A table from frequencies that sum to 4096. */
export function tableOfFrequencies(frequencies: ArrayLike<number>): Table {
  const start = new Uint16Array(frequencies.length);
  const frequency = Uint16Array.from(frequencies);
  const symbolOf = new Uint8Array(4096);
  let at = 0;
  for (let symbol = 0; symbol < frequencies.length; symbol++) {
    start[symbol] = at;
    symbolOf.fill(symbol, at, at + frequency[symbol]!);
    at += frequency[symbol]!;
  }
  check(at === 4096, "a prior: frequencies with a wrong sum");
  return { start, frequency, symbolOf };
}

/** The rANS states of a chunk. */
export class Lanes {
  readonly count: number;
  private readonly states: Uint32Array;
  private readonly data: Uint8Array;
  private at: number;

  /** Reads lengths and states, which stand before the words. */
  constructor(part: Bytes, count: number) {
    const data = part.rest();
    const heads = new Bits(data, "tempo");
    const lengths = Array.from({ length: count }, () => heads.number(4) + 16);
    this.states = Uint32Array.from(lengths, (length) => 2 ** length + heads.number(length));
    this.count = count;
    this.data = data;
    this.at = Math.ceil(heads.at / 8);
  }

  symbol(lane: number, table: Table): number {
    const x = this.states[lane]!;
    const slot = x & 4095;
    const symbol = table.symbolOf[slot]!;
    let next = table.frequency[symbol]! * (x >>> 12) + slot - table.start[symbol]!;
    if (next < 65536) {
      check(this.at + 2 <= this.data.length, "tempo: the symbols end too early");
      next = next * 65536 + (this.data[this.at]! | (this.data[this.at + 1]! << 8));
      this.at += 2;
    }
    this.states[lane] = next;
    return symbol;
  }

  /** Raw bits: 16 from each final state, then those of `raw`. */
  rawBits(): Bits {
    const inStates = 2 * this.count;
    const bytes = new Uint8Array(inStates + this.data.length - this.at);
    this.states.forEach((x, i) => {
      check(x >>> 16 === 1, "tempo: the symbols have a wrong end");
      bytes[2 * i] = (x >> 8) & 255;
      bytes[2 * i + 1] = x & 255;
    });
    bytes.set(this.data.subarray(this.at), inStates);
    return new Bits(bytes, "tempo");
  }

  /** Checks that all unread bits are 0, and that less than a byte of `raw` is unread. */
  end(raw: Bits): void {
    check(8 * raw.data.length - Math.max(raw.at, 16 * this.count) < 8, "tempo: bytes are left over");
    while (raw.left) check(raw.number(Math.min(32, raw.left)) === 0, "tempo: a padding bit is not 0");
  }
}
