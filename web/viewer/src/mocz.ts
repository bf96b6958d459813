/** Opens .mocz files with the decoder in web/decoder, and says of them what the page shows. */

import { type MoczFile, type PriorLoader, type Source, open } from "../../decoder/src/index.js";
import { findLinks } from "./links.ts";
import { fromBase64 } from "./packed.ts";
import type { Facts, Media } from "./session.ts";

const opened = new Map<number, MoczFile>();
const BINS = 1024;
/** Decoding point clouds pauses after this long, milliseconds, so that the page can draw. */
const BUSY_MS = 30;
const SAMPLED_FRAMES = 24;
/** Of longer recordings, opening does not read all chunks for gaps and marks. */
const MOST_READ_FRAMES = 20_000;
/** More marks of a kind would fill the timeline from end to end. */
const MOST_MARKS = 5_000;

/** Priors from a folder beside the page. */
const priors: PriorLoader = async (id) => {
  const url = new URL(`priors/${id}.npz`, location.href);
  const response = await fetch(url).catch(() => null);
  if (!response?.ok) throw new Error(`the file needs the prior ${id}, which is not beside this page: use "mocodec view"`);
  return new Uint8Array(await response.arrayBuffer());
};

/** Open a file; damaged chunks become gaps. */
export async function openFile(source: Source): Promise<MoczFile> {
  return open(source, { priors, salvage: true });
}

/** The file behind a media. */
export async function fileOf(media: Extract<Media, { type: "mocz" }>): Promise<MoczFile> {
  if (media.id !== undefined) return opened.get(media.id)!;
  if (media.url !== undefined) return openFile(new URL(media.url, location.href).href);
  return openFile(fromBase64(media.base64 ?? ""));
}

/** The facts about an open file; it decodes a few frames for links and, of short recordings, all for gaps and marks. */
export async function factsOf(file: MoczFile, name: string): Promise<Facts> {
  const { info } = file;
  const id = opened.size;
  opened.set(id, file);
  const notes: string[] = [];
  let events: Facts["events"] = [];
  try {
    events = (await file.extras()).events.map((event) => ({ label: event.label, seconds: event.time }));
  } catch (error) {
    notes.push(error instanceof Error ? error.message : String(error));
  }
  const { kind } = info;
  const { names, links } = kind === "clouds" ? { names: [], links: [] } : await shownOfMotion(file);
  if (kind === "clouds") for await (const _ of file.clouds(0, Math.min(1, info.frames))) break; // names damage and what cannot be decoded
  const isRead = kind === "motion" && info.frames <= MOST_READ_FRAMES;
  const gaps = isRead ? await gapsOf(file) : [];
  const marks = isRead ? await marksOf(file) : [];
  const targets = ["max_error", "mean_error", "max_rotation", "size", "ratio", "psnr"];
  const promise = Object.fromEntries(targets.flatMap((key) => (typeof info.settings[key] === "number" ? [[key, info.settings[key] as number]] : [])));
  const run = Math.max(1, Math.ceil(info.chunks.length / (2 * BINS)));
  const chunks: [number, number][] = [];
  for (let i = 0; i < info.chunks.length; i += run) {
    const some = info.chunks.slice(i, i + run);
    chunks.push([some[0].start, some.reduce((sum, chunk) => sum + chunk.payloadBytes, 0)]);
  }
  return {
    name,
    kind,
    frames: info.frames,
    points: names.length,
    rate: info.rate,
    up: info.up,
    names,
    links,
    codec: info.codec,
    bytes: info.bytes,
    originalBytes: null,
    ratio: info.kind === "motion" && info.bytes ? (info.frames * names.length * 12) / info.bytes : null,
    promise,
    chunks,
    marks,
    events,
    signals: [],
    gaps,
    errors: null,
    damage: file.damage.map(({ start, frames }) => [start, start + frames]),
    notes: [...notes, ...file.damage.map(({ error }) => error.message)],
    decoded: { type: "mocz", id },
    original: null,
  };
}

async function shownOfMotion(file: MoczFile): Promise<Pick<Facts, "names" | "links">> {
  const { names, skeleton } = file.info;
  const parents = skeleton?.parents;
  const links = parents ? parents.flatMap((p, j) => (p < 0 ? [] : [[Math.min(p, j), Math.max(p, j)] as [number, number]])) : await linksOf(file);
  return { names, links };
}

/** Frames a … b − 1 of point clouds. The page stays responsive: it may draw between two frames. */
export async function cloudsOf(file: MoczFile, a: number, b: number): Promise<{ positions: Float32Array; colours: Uint8Array | null }[]> {
  const clouds = [];
  let last = performance.now();
  for await (const { positions, colours } of file.clouds(a, b)) {
    clouds.push({ positions: new Float32Array(positions), colours: colours ?? null });
    if (performance.now() - last < BUSY_MS) continue;
    await new Promise((resolve) => setTimeout(resolve));
    last = performance.now();
  }
  return clouds;
}

async function linksOf(file: MoczFile): Promise<[number, number][]> {
  const { frames, names } = file.info;
  if (frames < 2 || names.length < 2 || names.length > 600) return [];
  const sample: Float64Array[] = [];
  for (let k = 0; k < SAMPLED_FRAMES; k++) {
    const frame = Math.floor((k * (frames - 1)) / (SAMPLED_FRAMES - 1));
    sample.push(await file.frames(frame, frame + 1));
  }
  return findLinks(sample, names.length);
}

async function marksOf(file: MoczFile): Promise<Facts["marks"]> {
  const kinds = Object.entries(await file.marks()).map(([label, frames]) => ({ label, frames }));
  return kinds.filter(({ frames }) => frames.length <= MOST_MARKS);
}

async function gapsOf(file: MoczFile): Promise<number[]> {
  const { frames, names } = file.info;
  const bins = Math.min(BINS, frames);
  const missing = new Array<number>(bins).fill(0);
  const total = new Array<number>(bins).fill(0);
  for (let start = 0; start < frames; start += 1000) {
    const stop = Math.min(frames, start + 1000);
    const positions = await file.frames(start, stop);
    for (let f = start; f < stop; f++) {
      const bin = Math.floor((f * bins) / frames);
      for (let p = 0; p < names.length; p++) missing[bin] += Number(Number.isNaN(positions[3 * ((f - start) * names.length + p)]));
      total[bin] += names.length;
    }
  }
  return missing.map((count, bin) => count / Math.max(1, total[bin]));
}
