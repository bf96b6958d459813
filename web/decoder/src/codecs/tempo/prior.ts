/** Priors of tempo (docs/payloads/tempo-models.md, "The prior"), loaded when a file names one. */

import { BadInput, UnknownCodec, check } from "../../errors.js";
import { type Table, tableOfFrequencies } from "./rans.js";
import { Npz } from "./npz.js";

/** Loads the .npz file of the prior with this identifier, 8 hexadecimal digits. */
export type PriorLoader = (id: string) => Promise<Uint8Array>;

const FILES: Record<string, () => URL> = {
  b881876c: () => new URL("../priors/points.npz", import.meta.url),
  "1be90053": () => new URL("../priors/directions.npz", import.meta.url),
};

/** Loads priors from files of the package: with fetch, or from the file system in Node. */
export const bundledPriors: PriorLoader = async (id) => {
  const url = FILES[id]?.();
  if (!url) throw new UnknownCodec(`the file needs the prior ${id}, which this decoder does not have`);
  if (url.protocol === "file:") {
    const { readFile } = await import(/* @vite-ignore */ "node:fs/promises");
    return new Uint8Array(await readFile(url));
  }
  const answer = await fetch(url);
  if (!answer.ok) throw new BadInput(`the prior ${id} is not at ${url}: the server answers ${answer.status}`);
  return new Uint8Array(await answer.arrayBuffer());
};

export const SYMBOLS = 21;
export const TABLES = 168;

export class Prior {
  private readonly tables: (Table | undefined)[] = [];

  constructor(readonly arrays: Npz) {}

  /** The table of symbols with this number. */
  table(number: number): Table {
    return (this.tables[number] ??= tableOfFrequencies(this.arrays.numbers("tables").data.subarray(SYMBOLS * number, SYMBOLS * (number + 1))));
  }

  get isOfDirections(): boolean {
    return this.arrays.has("metric_root");
  }
}

const known = new WeakMap<PriorLoader, Map<string, Promise<Prior>>>();

/** The prior with this identifier, cached for each loader. */
export function loadPrior(id: string, loader: PriorLoader): Promise<Prior> {
  let priors = known.get(loader);
  if (!priors) known.set(loader, (priors = new Map()));
  let prior = priors.get(id);
  if (!prior) {
    prior = loader(id).then((bytes) => {
      const read = new Prior(new Npz(bytes));
      check(read.arrays.numbers("tables").data.length === TABLES * SYMBOLS, "a prior: tables of a wrong size");
      return read;
    });
    priors.set(id, prior);
    prior.catch(() => priors.delete(id));
  }
  return prior;
}

/** Normalised name of a point: the part after the last `:` or `|`, upper case, only 0–9 and A–Z. */
function label(name: string): string {
  return name.split(/[:|]/).at(-1)!.toUpperCase().replace(/[^0-9A-Z]/g, "");
}

/** The prior's joint with the name of each point. */
export function jointsByName(prior: Prior, names: string[]): number[] {
  const joints = new Map(prior.arrays.texts("names").map((name, joint) => [label(name), joint]));
  const found = names.map((name) => joints.get(label(name)) ?? -1);
  check(names.length === joints.size && new Set(found).size === joints.size && !found.includes(-1), "tempo: the points are not the joints of the prior");
  return found;
}
