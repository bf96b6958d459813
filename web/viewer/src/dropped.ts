/** .mocz files dropped on the page or named in its address. The page decodes them, and compares two of equal shape. */

import { measure } from "./errors.ts";
import { inMemory } from "./loaders.ts";
import { closeBefore, factsOf, fileOf } from "./mocz.ts";
import type { Facts, Media, Session } from "./session.ts";

/** A session of files. progress: called with the measured share. */
export async function dropped(files: File[], progress: (share: number) => void): Promise<Session> {
  const others = files.filter((file) => !file.name.toLowerCase().endsWith(".mocz"));
  if (others.length) {
    throw new Error(`${others[0].name}: this page opens .mocz files. "mocodec view ${others[0].name}" shows other formats.`);
  }
  return sessionOf(files.map((file) => [file.name, file] as const), progress);
}

/** A session of the files that the address names: ?file=a.mocz&against=b.mocz, both from the same server. */
export async function addressed(query: URLSearchParams, progress: (share: number) => void): Promise<Session> {
  const names = [...query.getAll("against").slice(0, 1), ...query.getAll("file")];
  return sessionOf(names.map((name) => [name.split("/").at(-1)!, new URL(name, location.href).href] as const), progress);
}

async function sessionOf(sources: (readonly [string, File | string])[], progress: (share: number) => void): Promise<Session> {
  const recordings: Facts[] = [];
  for (const [name, source] of sources) recordings.push(await factsOf(source, name));
  closeBefore(recordings.length);
  if (recordings.length === 2 && sameShape(recordings[0], recordings[1])) {
    const [original, decoded] = ordered(recordings[0], recordings[1]);
    decoded.errors = await compared(decoded, original, progress);
    decoded.original = original.decoded;
    decoded.originalBytes = original.bytes;
    return { version: 1, title: decoded.name, recordings: [decoded] };
  }
  return { version: 1, title: recordings[0]?.name ?? "mocodec", recordings };
}

function sameShape(a: Facts, b: Facts): boolean {
  const isMotion = (facts: Facts) => facts.kind === "motion";
  return isMotion(a) && isMotion(b) && a.frames === b.frames && a.points === b.points && a.names.every((name, i) => name === b.names[i]);
}

/** Two recordings, the original first: the lossless one, or the larger file. */
function ordered(a: Facts, b: Facts): [Facts, Facts] {
  const fine = (facts: Facts) => (facts.codec === "lossless" ? Infinity : (facts.bytes ?? 0));
  return fine(b) > fine(a) ? [b, a] : [a, b];
}

async function compared(decoded: Facts, original: Facts, progress: (share: number) => void) {
  const files = await Promise.all([decoded.decoded, original.decoded].map((media) => fileOf(media as Extract<Media, { type: "mocz" }>)));
  return measure(
    decoded.frames,
    decoded.points,
    async (a, b) => {
      const parts = await Promise.all(files.map(async (file) => inMemory(new Float32Array(await file.frames(a, b)), decoded.points)(0, b - a)));
      return [parts[0], parts[1]];
    },
    progress,
  );
}
