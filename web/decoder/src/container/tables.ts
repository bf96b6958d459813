/** The literal tables of the format. `scripts/tables.py` writes tables.json from the tables of the Python package. */

import tables from "../tables.json";

export const CODECS: Record<string, string> = tables.codecs;
export const RATES = tables.rates as [number, number][];
export const VOCABULARY: string[] = tables.vocabulary.split(" ");
export const TREES: number[][] = tables.trees;
export const WORDS: string[] = tables.words;
export const MORE_WORDS: string[] = tables.moreWords;
export const SOURCES: Record<string, unknown>[] = tables.sources;
export const REFERENCE_OFFSETS: Record<string, number[][]> = tables.referenceOffsets;
export const REFERENCE_LIMITS: Record<string, number[][]> = tables.referenceLimits;
export const LIMIT_RANGES: number[][][] = tables.limitRanges;
export const LIMIT_FRAMES: number[][] = tables.limitFrames;
export const LAPLACE_RATIOS: number[] = tables.laplaceRatios;
export const GAUSS_RATIOS: number[] = tables.gaussRatios;

/** Preset dictionary for names that are not in the vocabulary. */
export function nameDictionary(): Uint8Array {
  return new TextEncoder().encode(tables.nameDictionaryHead + [...new Set(VOCABULARY)].join("\n"));
}

/** Preset dictionary for value trees: the stream of the tree typical_extras(). */
export function valueDictionary(): Uint8Array {
  return fromText(tables.valueDictionary);
}

/** Bytes of a text with one character for each byte. */
export function fromText(text: string): Uint8Array {
  return Uint8Array.from(text, (character) => character.charCodeAt(0));
}
