/** Sources: URLs by range requests, Blobs; and the facts of a file. */

import { type Server, createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { afterAll, beforeAll, describe, expect, test } from "vitest";
import { BadInput, FrameOutOfRange, Truncated, open } from "../src/index.js";
import { Bytes, crc32 } from "../src/bytes.js";
import { goldenBytes, goldenTwin, priors } from "./golden.js";

const NAME = "liu2006-markers"; // has several chunks; each needs its neighbours
const bytes = goldenBytes(NAME);
const requests: string[] = [];
let server: Server;
let url: string;
let body: Uint8Array = bytes;

beforeAll(async () => {
  server = createServer((request, response) => {
    const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    requests.push(`${request.url} ${request.headers.range}`);
    if (request.url === "/missing") return void response.writeHead(404).end();
    if (request.url === "/whole" || !range) return void response.writeHead(200).end(body);
    const start = Number(range[1]);
    const end = Math.min(Number(range[2]), body.length - 1);
    if (start >= body.length) return void response.writeHead(416, { "Content-Range": `bytes */${body.length}` }).end();
    const headers = { "Content-Range": `bytes ${start}-${end}/${body.length}`, ETag: request.url === "/changing" ? `"${requests.length}"` : '"1"' };
    const part = body.slice(start, end + 1);
    response.writeHead(206, headers).end(request.url === "/short" && start > 0 ? part.slice(1) : part);
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  url = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
});

afterAll(() => void server.close());

describe("sources", () => {
  test("a URL with and without range requests, a Blob and bytes give the same", async () => {
    const wanted = await (await open(bytes, { priors })).frames(10, 70);
    for (const source of [`${url}/file`, `${url}/whole`, new URL(`${url}/file`), new Blob([bytes.slice()]), bytes.slice().buffer]) {
      const file = await open(source, { priors });
      expect(file.info.bytes).toBe(bytes.length);
      expect(await file.frames(10, 70)).toEqual(wanted);
    }
  });

  test("only the needed chunks of a long file are fetched", async () => {
    body = longFile();
    requests.length = 0;
    const file = await open(`${url}/long`);
    expect(file.info.chunks.length).toBe(2000);
    const opened = requests.length;
    expect(opened).toBeLessThanOrEqual(3);
    const { start, offset, size } = file.info.chunks[1000]!;
    await file.frames(start, start + 1);
    expect(requests.slice(opened)).toEqual([`/long bytes=${offset}-${offset + size - 1}`]);
    await file.frames(start, start + 2);
    expect(requests.length).toBe(opened + 1);
    body = bytes;
  });

  test("errors have names", async () => {
    await expect(open(`${url}/missing`)).rejects.toBeInstanceOf(BadInput);
    await expect(open("http://127.0.0.1:1/")).rejects.toBeInstanceOf(BadInput);
    await expect(open(new TextEncoder().encode("no such file"))).rejects.toMatchObject({ name: "BadInput" });
    await expect(open(new Uint8Array(0))).rejects.toBeInstanceOf(Truncated);
    const file = await open(bytes);
    await expect(file.frames(0, file.info.frames + 1)).rejects.toBeInstanceOf(FrameOutOfRange);
    await expect(file.frames(-1, 2)).rejects.toMatchObject({ name: "FrameOutOfRange" });
    await expect(file.frames(0.5, 2)).rejects.toBeInstanceOf(BadInput);
    await expect(file.rotations()).rejects.toBeInstanceOf(BadInput);
  });

  test("a file that changes on the server, or arrives short, is an error", async () => {
    body = longFile();
    const changing = await open(`${url}/changing`).catch((error: unknown) => error);
    expect(changing).toBeInstanceOf(BadInput);
    await expect(open(`${url}/short`)).rejects.toBeInstanceOf(Truncated);
    body = bytes;
  });
});

describe("slices", () => {
  test.each(["liu2006-markers", "tempo-joints", "rotations-figure", "lossless-markers"])("%s", async (name) => {
    const file = await open(goldenBytes(name), { priors });
    const all = await file.frames();
    const lanes = 3 * file.info.names.length;
    const { frames } = file.info;
    for (const [a, b] of [[0, 0], [0, 1], [frames - 1, frames], [3, frames - 2], [frames, frames]] as const) {
      const other = await open(goldenBytes(name), { priors });
      expect(await other.frames(a, b)).toEqual(all.slice(a * lanes, b * lanes));
    }
  });
});

describe("salvage", () => {
  test("damaged chunks become gaps, a lost index is replaced", async () => {
    const whole = await open(goldenBytes("tempo-repeats"), { priors });
    const wanted = await whole.frames();
    const { chunks, names } = whole.info;
    const damaged = goldenBytes("tempo-repeats");
    damaged[chunks[0]!.offset + 5]! ^= 1;
    const file = await open(damaged, { priors, salvage: true });
    const found = await file.frames();
    const lost = 3 * names.length * chunks[0]!.frames;
    expect(found.slice(0, lost).every(Number.isNaN)).toBe(true);
    expect(found.slice(lost)).toEqual(wanted.slice(lost));
    expect(file.damage).toMatchObject([{ start: 0, frames: chunks[0]!.frames, error: { name: "Corrupt" } }]);
    const cut = await open(goldenBytes("tempo-repeats").slice(0, -3), { priors, salvage: true });
    expect(cut.info.frames).toBe(whole.info.frames);
    expect(await cut.frames()).toEqual(wanted);
  });
});

test("info has the facts of the header", async () => {
  const { info } = await open(goldenBytes("liu2006-markers-bounded"));
  const twin = goldenTwin("liu2006-markers-bounded");
  expect(info).toMatchObject({ kind: "motion", codec: "liu2006", maxError: 0.002, rotations: false, margin: 0, bytes: goldenBytes("liu2006-markers-bounded").length });
  expect(info.duration).toBeCloseTo(twin.positions.length / twin.rate);
  expect(info.chunks.reduce((sum, chunk) => sum + chunk.frames, 0)).toBe(info.frames);
});

function varint(value: number): number[] {
  return value < 128 ? [value] : [(value & 127) | 128, ...varint(value >> 7)];
}

/** A golden file with its first chunk 2,000 times, and a matching index. */
function longFile(): Uint8Array {
  const golden = goldenBytes("lossless-markers");
  const { frames, offset, size, payloadBytes } = chunkOf(golden);
  const count = 2000;
  const index = [0, ...varint(count), ...varint(count), ...varint(frames)];
  for (let i = 0; i < count; i++) index.push(...varint(payloadBytes));
  const checksum = crc32(Uint8Array.from(index));
  for (let i = 0; i < 32; i += 8) index.push((checksum >>> i) & 255);
  const tail = [...index, ...varint(index.length).reverse(), 0x63, 0x7a];
  const out = new Uint8Array(offset + count * size + tail.length);
  out.set(golden.subarray(0, offset));
  for (let i = 0; i < count; i++) out.set(golden.subarray(offset, offset + size), offset + i * size);
  out.set(tail, offset + count * size);
  return out;
}

/** The place of the first chunk, from its head and the header's length. */
function chunkOf(golden: Uint8Array): { frames: number; offset: number; size: number; payloadBytes: number } {
  const part = new Bytes(golden, "a golden file");
  part.take(5);
  part.take(part.varint() + 4);
  const offset = part.at;
  const frames = part.varint();
  const payloadBytes = part.varint();
  return { frames, offset, size: part.at - offset + payloadBytes + 4, payloadBytes };
}
