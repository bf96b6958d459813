/** Names of points and joints (docs/format.md, "Names"). */

import type { Bytes } from "../bytes.js";
import { text } from "../bytes.js";
import { Corrupt, check } from "../errors.js";
import { inflate } from "../inflate.js";
import { VOCABULARY, nameDictionary } from "./tables.js";

const MOST_NAMES = 65_536;
const MOST_TEXT_BYTES = 1 << 22;

/** Reads the names of the header. */
export function readNames(part: Bytes): string[] {
  const head = part.varint();
  const count = Math.floor(head / 8);
  check(count <= MOST_NAMES, `${part.what}: ${count} names`);
  const prefix = head & 4 ? part.string() : "";
  const form = head & 3;
  let names: string[];
  if (form === 0) names = runs(part, count);
  else if (form === 1) names = numbered(part, count);
  else if (form === 2) names = joined(part, count);
  else throw new Corrupt(`${part.what}: a reserved form of names`);
  return prefix ? names.map((name) => prefix + name) : names;
}

function runs(part: Bytes, count: number): string[] {
  const names: string[] = [];
  while (names.length < count) {
    const start = part.varint();
    if (start === 0) {
      names.push(part.string());
      continue;
    }
    const run = part.varint();
    check(
      run >= 1 && run <= count - names.length && start - 1 + run <= VOCABULARY.length,
      `${part.what}: a run of names that the vocabulary does not have`,
    );
    names.push(...VOCABULARY.slice(start - 1, start - 1 + run));
  }
  return names;
}

function numbered(part: Bytes, count: number): string[] {
  const stem = part.string();
  const first = part.varint();
  check(stem.length * count <= MOST_TEXT_BYTES, `${part.what}: names that are too long`);
  return Array.from({ length: count }, (_, i) => `${stem}${first + i}`);
}

function joined(part: Bytes, count: number): string[] {
  const size = part.varintWithin(0, MOST_TEXT_BYTES, "the size of names");
  const bytes = inflate(part.blob(), size, nameDictionary());
  check(bytes.length === size, `${part.what}: names of a wrong size`);
  const names = text(bytes).split("\n");
  check(names.length === count, `${part.what}: a wrong number of names`);
  return names;
}
