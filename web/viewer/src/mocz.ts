/** Opens .mocz files with the decoder in web/decoder, and collects the facts that the page shows. */

import type { MoczFile, Source } from "../../decoder/src/index.js";
import { channelsOf } from "./channels.ts";
import { CloudReader, damageOf } from "./clouds.ts";
import { findLinks } from "./links.ts";
import { openFile } from "./opening.ts";
import { fromBase64 } from "./packed.ts";
import type { Facts, Media } from "./session.ts";

const opened = new Map<number, MoczFile>();
const readers = new Map<number, CloudReader>();
const BINS = 1024;
const SAMPLED_FRAMES = 24;
/** Only in recordings up to this length does opening read all chunks for gaps, marks and signals. */
const MOST_READ_FRAMES = 20_000;
/** Marks of a kind: more would fill the whole timeline. */
const MOST_MARKS = 5_000;

type Mocz = Extract<Media, { type: "mocz" }>;

/** The file behind a media. */
export async function fileOf(media: Mocz): Promise<MoczFile> {
  return media.id === undefined ? openFile(sourceOf(media)) : opened.get(media.id)!;
}

function sourceOf({ url, base64 }: Mocz): Source {
  return url === undefined ? fromBase64(base64 ?? "") : new URL(url, location.href).href;
}

/** Opens a file and collects its facts. Reads the first frame of point clouds; of a motion a few frames for links and, if it is
 * short, all for gaps and marks. */
export async function factsOf(source: Source, name: string): Promise<Facts> {
  const file = await openFile(source);
  const { info } = file;
  const id = opened.size;
  opened.set(id, file);
  const notes: string[] = [];
  let events: Facts["events"] = [];
  let signals: Facts["signals"] = [];
  try {
    const extras = await file.extras();
    events = extras.events.map((event) => ({ label: event.label, seconds: event.time }));
    if (info.frames <= MOST_READ_FRAMES) signals = await channelsOf(extras.signals);
  } catch (error) {
    notes.push(error instanceof Error ? error.message : String(error));
  }
  const { kind } = info;
  const reader = kind === "clouds" ? readerOfFile(id, source) : null;
  const { names, links } = kind === "clouds" ? { names: [], links: [] } : await shownOfMotion(file);
  // reading a frame reports damage
  const [first] = reader ? await reader.read(0, Math.min(1, info.frames)) : [];
  const points = first ? first.positions.length / 3 : names.length;
  const isRead = kind === "motion" && info.frames <= MOST_READ_FRAMES;
  const gaps = isRead ? await gapsOf(file) : [];
  const marks = isRead ? await marksOf(file) : [];
  const damage = reader?.damage ?? damageOf(file);
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
    points,
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
    signals,
    gaps,
    errors: null,
    damage: damage.map(({ start, frames }) => [start, start + frames]),
    notes: [...notes, ...damage.map(({ message }) => message)],
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

function readerOfFile(id: number, source: Source): CloudReader {
  const reader = new CloudReader(source);
  readers.set(id, reader);
  return reader;
}

/** Stop the decoders of all files except the last `count`. */
export function closeBefore(count: number): void {
  for (const [id, reader] of readers) {
    if (id >= opened.size - count) continue;
    reader.close();
    readers.delete(id);
  }
}

/** The decoder of the point clouds behind a media. */
export function readerOf(media: Mocz): CloudReader {
  return readers.get(media.id ?? -1) ?? new CloudReader(sourceOf(media));
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
