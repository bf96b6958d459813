/** Loads the frames of a recording: from the page itself, a .mocz file or the server. */

import type { Frame, Loader } from "./frames.ts";
import { fileOf, readerOf } from "./mocz.ts";
import { type Cloud, unpackClouds, unpackMotion } from "./packed.ts";
import type { Facts, Media } from "./session.ts";

/** Loaders of the decoded and the original frames of a recording. */
export async function loaders(facts: Facts): Promise<{ decoded: Loader; original: Loader | null }> {
  if (facts.kind === "clouds") {
    return { decoded: await cloudLoader(facts.decoded), original: facts.original && (await cloudLoader(facts.original)) };
  }
  let inside: Float32Array | null = null;
  const make = async (media: Media): Promise<Loader> => {
    if (media.type === "packed") {
      const positions = await unpackMotion(media, facts.points, inside);
      inside ??= positions;
      return inMemory(positions, facts.points);
    }
    if (media.type === "mocz") return moczLoader(media, facts.points);
    if (media.type === "frames") return serverLoader(media.url, facts.points);
    throw new Error("motion cannot come as packed clouds");
  };
  const decoded = await make(facts.decoded);
  return { decoded, original: facts.original && (await make(facts.original)) };
}

/** A loader of frames from an array (frames · points · 3). */
export function inMemory(positions: Float32Array, points: number): Loader {
  return async (a, b) => split(positions.subarray(a * points * 3, b * points * 3), points);
}

function split(positions: Float32Array, points: number): Frame[] {
  const width = points * 3;
  const count = width ? positions.length / width : 0;
  return Array.from({ length: count }, (_, i) => ({
    positions: positions.subarray(i * width, (i + 1) * width),
    colours: null,
  }));
}

async function moczLoader(media: Extract<Media, { type: "mocz" }>, points: number): Promise<Loader> {
  const file = await fileOf(media);
  return async (a, b) => split(new Float32Array(await file.frames(a, b)), points);
}

async function fetchRange(url: string, a: number, b: number): Promise<ArrayBuffer> {
  const response = await fetch(`${url}?from=${a}&to=${b}`);
  if (!response.ok) throw new Error((await response.text()) || `the server answers ${response.status}`);
  return response.arrayBuffer();
}

function serverLoader(url: string, points: number): Loader {
  return async (a, b) => split(new Float32Array(await fetchRange(url, a, b)), points);
}

async function cloudLoader(media: Media): Promise<Loader> {
  if (media.type === "packed-clouds") {
    const clouds = await unpackClouds(media);
    return async (a, b) => clouds.slice(a, b);
  }
  if (media.type === "mocz") {
    const reader = readerOf(media);
    return (a, b) => reader.read(a, b);
  }
  if (media.type !== "frames") throw new Error("point clouds come from a server or within the page");
  return async (a, b) => splitClouds(await fetchRange(media.url, a, b));
}

/** Frames one after the other: count (uint32), positions (count · 3 float32), colours (count · 3 bytes), padded to 4 bytes. */
function splitClouds(buffer: ArrayBuffer): Cloud[] {
  const view = new DataView(buffer);
  const clouds: Cloud[] = [];
  for (let at = 0; at + 4 <= buffer.byteLength; ) {
    const count = view.getUint32(at, true);
    const positions = new Float32Array(buffer, at + 4, count * 3);
    const colours = new Uint8Array(buffer, at + 4 + count * 12, count * 3);
    clouds.push({ positions, colours });
    at += 4 + count * 12 + ((count * 3 + 3) & ~3);
  }
  return clouds;
}
