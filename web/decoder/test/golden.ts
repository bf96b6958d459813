/** Golden files of the Python package, and their decoded values. */

import { readFileSync, readdirSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { UnknownCodec, type PriorLoader } from "../src/index.js";

const GOLDEN = new URL("../../../tests/golden/", import.meta.url);
const PRIORS = new URL("../../../src/mocodec/priors/", import.meta.url);
const PRIOR_FILES: Record<string, string> = { b881876c: "points.npz", "1be90053": "directions.npz" };

export interface Twin {
  codec: string;
  rate: number;
  up: string;
  names: string[];
  positions: (number[] | null)[][];
  rotations?: number[][][];
  signals?: Record<string, { rate: number; dtype: string; labels: string[]; values: unknown }>;
}

export function goldenNames(): string[] {
  return readdirSync(fileURLToPath(GOLDEN)).filter((name) => name.endsWith(".mocz")).map((name) => name.slice(0, -5));
}

export function goldenBytes(name: string): Uint8Array {
  return new Uint8Array(readFileSync(new URL(`${name}.mocz`, GOLDEN)));
}

export function goldenTwin(name: string): Twin {
  const text = readFileSync(new URL(`${name}.json`, GOLDEN), "utf8");
  return JSON.parse(text.replace(/(?<=[[ ,])(-?Infinity|NaN)(?=[\],])/g, '"$1"')) as Twin; // Python's JSON has NaN
}

export const priors: PriorLoader = async (id) => {
  const name = PRIOR_FILES[id];
  if (!name) throw new UnknownCodec(`no prior ${id}`);
  return new Uint8Array(readFileSync(new URL(name, PRIORS)));
};
