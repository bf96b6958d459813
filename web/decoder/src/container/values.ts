/** Value trees: settings, source and extras (docs/format.md, "Value trees"). */

import { Bytes, text } from "../bytes.js";
import { Corrupt, check } from "../errors.js";
import { inflate } from "../inflate.js";
import { MORE_WORDS, SOURCES, WORDS, valueDictionary } from "./tables.js";

/** A value of a tree. Integers beyond 2^53 are bigint; dicts are objects without a prototype. */
export type Value = null | boolean | number | bigint | string | Uint8Array | StoredArray | StoredSignal | CodedSignal | Value[] | Tree;
export interface Tree {
  [key: string]: Value;
}

/** An array of extras. bytes: its items as in memory, last axis fastest; empty until the section is read. */
export class StoredArray {
  constructor(
    /** A NumPy type string with its byte order, such as `<f4`. */
    public dtype: string,
    public shape: number[],
    public bytes: Uint8Array,
  ) {}
}

/** A signal with its samples in an array of the extras (type 12). */
export class StoredSignal {
  constructor(
    readonly rate: number,
    readonly labels: string[],
    readonly units: string[],
    readonly samples: StoredArray,
  ) {}
}

/** A signal with its chunks in the section of signals (type 15). */
export class CodedSignal {
  constructor(
    readonly rate: number,
    readonly labels: string[],
    readonly units: string[],
    readonly dtype: string,
    readonly shape: number[],
  ) {}
}

const MOST_STREAM_BYTES = 1 << 26;
const MOST_LEVELS = 64;
/** Replaces the length of a stream that is deflated with the laboratory dictionary. */
const LAB_WORDS = 1;
const MOST_DIMENSIONS = 16;
const MOST_ARRAY_BYTES_IN_TREE = 64;

/** Reads the stream of a tree, inflated if it is deflated. labWords: first part of the laboratory dictionary, for extras only. */
export function treeStream(part: Bytes, labWords?: Uint8Array): Uint8Array {
  const head = part.varint();
  const size = head === LAB_WORDS ? part.varint() : Math.floor(head / 2);
  check(size <= MOST_STREAM_BYTES, `${part.what}: a tree of ${size} bytes`);
  if (head % 2 === 0) return part.take(size);
  check(head !== LAB_WORDS || labWords !== undefined, `${part.what}: a dictionary that only extras have`);
  const dictionary = head === LAB_WORDS ? Uint8Array.from([...labWords!, ...valueDictionary()]) : valueDictionary();
  const bytes = inflate(part.blob(), size, dictionary);
  check(bytes.length === size, `${part.what}: a tree of a wrong size`);
  return bytes;
}

/** Reads a tree without arrays. */
export function readTree(part: Bytes): Tree {
  return new TreeReader(new Bytes(treeStream(part), part.what), false).all();
}

/** Reads the source of a recording: an entry of the table SOURCES, updated by a tree. */
export function readSource(part: Bytes): Tree {
  const number = part.varint();
  check(number < SOURCES.length, `${part.what}: a reserved number of a source`);
  return Object.assign(Object.create(null), SOURCES[number], readTree(part)) as Tree;
}

export class TreeReader {
  /** Arrays of type 11 and coded signals, in the order of the tree; their data come after the tree. */
  readonly pending: (StoredArray | CodedSignal)[] = [];
  private level = 0;

  constructor(
    private readonly part: Bytes,
    private readonly arraysAllowed: boolean,
  ) {}

  all(): Tree {
    const tree = Object.create(null) as Tree;
    while (this.part.left) this.entry(tree);
    return tree;
  }

  private entry(tree: Tree): void {
    const key = this.value();
    check(typeof key === "string" && !(key in tree), `${this.part.what}: a key that is not a string or occurs twice`);
    tree[key] = this.value();
  }

  private value(): Value {
    const kind = this.part.byte();
    if (kind >= 128) {
      check(kind - 128 < WORDS.length, `${this.part.what}: a reserved word`);
      return WORDS[kind - 128]!;
    }
    if (kind >= 96) return text(this.part.take(kind - 96));
    if (kind >= 32) return kind - 32;
    if (kind >= 9 && kind !== 10 && kind !== 14) return this.extrasValue(kind);
    return this.plainValue(kind);
  }

  private plainValue(kind: number): Value {
    const part = this.part;
    switch (kind) {
      case 0:
        return null;
      case 1:
        return false;
      case 2:
        return true;
      case 3:
        return signed(part);
      case 4:
        return this.decimal();
      case 5:
        return part.float64();
      case 6:
        return part.string();
      case 7:
        return this.nested(() => this.items(this.count()));
      case 8:
        return this.nested(() => {
          const tree = Object.create(null) as Tree;
          for (let count = this.count(); count > 0; count--) this.entry(tree);
          return tree;
        });
      case 10:
        return largeInteger(part.blob());
      default: {
        const word = part.varint();
        check(kind === 14 && word < MORE_WORDS.length, `${part.what}: a reserved value`);
        return MORE_WORDS[word]!;
      }
    }
  }

  private extrasValue(kind: number): Value {
    check(this.arraysAllowed && kind < 16, `${this.part.what}: a reserved value, or one of extras only`);
    if (kind === 9) return this.part.blob();
    if (kind === 11) return this.postponed(new StoredArray("", [], new Uint8Array(0)));
    if (kind === 13) return this.smallArray();
    const rate = this.value();
    const labels = this.value();
    const units = this.value();
    check(typeof rate === "number" && rate > 0 && isTexts(labels) && isTexts(units), `${this.part.what}: a signal of an unknown form`);
    if (kind === 12) {
      const samples = this.value();
      check(samples instanceof StoredArray, `${this.part.what}: a signal without samples`);
      return new StoredSignal(rate, labels, units, samples);
    }
    const dtype = this.value();
    check(typeof dtype === "string", `${this.part.what}: a signal without a type`);
    const shape = readShape(this.part);
    check(shape.length > 0, `${this.part.what}: a signal without an axis`);
    return this.postponed(new CodedSignal(rate, labels, units, dtype, shape));
  }

  private postponed<T extends StoredArray | CodedSignal>(item: T): T {
    this.pending.push(item);
    return item;
  }

  private smallArray(): StoredArray {
    const dtype = this.value();
    check(typeof dtype === "string", `${this.part.what}: an array without a type`);
    const shape = readShape(this.part);
    const size = itemSize(dtype) * sizeOf(shape);
    check(size <= MOST_ARRAY_BYTES_IN_TREE, `${this.part.what}: a large array in a tree`);
    return new StoredArray(dtype, shape, this.part.take(size));
  }

  private decimal(): number {
    const digits = this.part.folded();
    const power = this.part.folded();
    check(Math.abs(digits) < 2 ** 53 && Math.abs(power) <= 400, `${this.part.what}: a decimal that is out of range`);
    return Number(`${digits}e${power}`);
  }

  private count(): number {
    return this.part.varintWithin(0, this.part.left, "the number of values");
  }

  private items(count: number): Value[] {
    const items: Value[] = [];
    for (let i = 0; i < count; i++) items.push(this.value());
    return items;
  }

  private nested<T>(read: () => T): T {
    this.level++;
    check(this.level < MOST_LEVELS, `${this.part.what}: a tree that is too deep`);
    const result = read();
    this.level--;
    return result;
  }
}

export function isTexts(value: Value): value is string[] {
  return Array.isArray(value) && value.every((item) => typeof item === "string");
}

/** Reads the number of dimensions, then each dimension. */
export function readShape(part: Bytes): number[] {
  const dimensions = part.varintWithin(0, MOST_DIMENSIONS, "the number of dimensions");
  return Array.from({ length: dimensions }, () => part.varint());
}

export function sizeOf(shape: number[]): number {
  return shape.reduce((product, extent) => product * extent, 1);
}

/** Bytes of an item of a NumPy type string. */
export function itemSize(dtype: string): number {
  const match = /^[<>|=]([biufcSUmM])(\d{1,6})(\[[^\]]*\])?$/.exec(dtype);
  check(match !== null, `extras: the type ${dtype}`);
  return Number(match[2]) * (match[1] === "U" ? 4 : 1);
}

function signed(part: Bytes): number | bigint {
  const number = part.bigVarint();
  if (typeof number === "number") return number % 2 ? -(number + 1) / 2 : number / 2;
  const value = number % 2n ? -(number + 1n) / 2n : number / 2n;
  return exact(value);
}

function largeInteger(bytes: Uint8Array): number | bigint {
  check(bytes.length <= 4096, "a tree: an integer of too many bytes");
  let value = 0n;
  for (let i = bytes.length - 1; i >= 0; i--) value = (value << 8n) | BigInt(bytes[i]!);
  return exact(BigInt.asIntN(8 * bytes.length, value));
}

function exact(value: bigint): number | bigint {
  const number = Number(value);
  return Number.isSafeInteger(number) ? number : value;
}

/** Throws Corrupt if an event of the extras has no time. */
export function checkEvents(tree: Tree): void {
  const events = tree["events"];
  if (events === undefined) return;
  const good =
    Array.isArray(events) &&
    events.every((event) => {
      const time = event !== null && typeof event === "object" ? (event as Tree)["time_s"] : undefined;
      return typeof time === "number" && Number.isFinite(time);
    });
  if (!good) throw new Corrupt("extras: events without a time");
}
