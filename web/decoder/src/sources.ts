/** Sources of a file's bytes: memory, a Blob or File, or HTTP range requests. */

import { BadInput, Corrupt, Truncated } from "./errors.js";

export interface ByteSource {
  readonly size: number;
  /** Reads exactly `count` bytes from `start` on; the range lies within the file. */
  read(start: number, count: number): Promise<Uint8Array>;
}

export type Source = string | URL | Blob | ArrayBuffer | Uint8Array;

const FRONT_BYTES = 32_768;
const TAIL_BYTES = 16_384;
const MOST_DOWNLOAD_BYTES = 2 ** 30;
const TIMEOUT_MS = 300_000;

/** The source of a URL, Blob, File or bytes. Throws BadInput. */
export async function byteSource(source: Source, request: RequestInit = {}): Promise<ByteSource> {
  if (source instanceof Uint8Array) return new Memory(source);
  if (source instanceof ArrayBuffer) return new Memory(new Uint8Array(source));
  if (typeof Blob !== "undefined" && source instanceof Blob) return new FromBlob(source);
  if (typeof source === "string" || source instanceof URL) return Http.open(String(source), request);
  throw new BadInput("a source is a URL, a Blob or File, or bytes");
}

class Memory implements ByteSource {
  constructor(private readonly bytes: Uint8Array) {}

  get size(): number {
    return this.bytes.length;
  }

  async read(start: number, count: number): Promise<Uint8Array> {
    if (start < 0 || start + count > this.size) throw new Truncated("the file ends too early");
    return this.bytes.subarray(start, start + count);
  }
}

class FromBlob implements ByteSource {
  constructor(private readonly blob: Blob) {}

  get size(): number {
    return this.blob.size;
  }

  async read(start: number, count: number): Promise<Uint8Array> {
    if (start < 0 || start + count > this.size) throw new Truncated("the file ends too early");
    return new Uint8Array(await this.blob.slice(start, start + count).arrayBuffer());
  }
}

/** Parts of a file by HTTP range requests; caches front and end, since opening a file reads both in pieces. */
class Http implements ByteSource {
  private tail: { start: number; bytes: Uint8Array } | undefined;

  private constructor(
    private readonly url: string,
    private readonly request: RequestInit,
    private readonly front: Uint8Array,
    readonly size: number,
    private readonly tag: string | null,
  ) {}

  static async open(url: string, request: RequestInit): Promise<ByteSource> {
    const answer = await get(url, request, 0, FRONT_BYTES);
    const total = answer.status === 206 ? totalOf(answer) : undefined;
    const bytes = await body(answer, url);
    if (answer.status === 200 || answer.status === 416) return new Memory(answer.status === 416 ? new Uint8Array(0) : bytes);
    if (answer.status !== 206 || total === undefined) throw new BadInput(`${url}: the server answers ${answer.status} ${answer.statusText}`);
    return new Http(url, request, bytes, total, answer.headers.get("etag"));
  }

  async read(start: number, count: number): Promise<Uint8Array> {
    if (start < 0 || start + count > this.size) throw new Truncated("the file ends too early");
    if (start + count <= this.front.length) return this.front.subarray(start, start + count);
    if (start >= this.size - TAIL_BYTES) {
      const from = Math.max(0, this.size - TAIL_BYTES);
      this.tail ??= { start: from, bytes: await this.fetch(from, this.size - from) };
      return this.tail.bytes.subarray(start - this.tail.start, start - this.tail.start + count);
    }
    return this.fetch(start, count);
  }

  private async fetch(start: number, count: number): Promise<Uint8Array> {
    if (count === 0) return new Uint8Array(0);
    const answer = await get(this.url, this.request, start, count);
    if (answer.status !== 206) {
      await answer.body?.cancel();
      throw new BadInput(`${this.url}: the server answers ${answer.status} ${answer.statusText} to a request for a part`);
    }
    if (answer.headers.get("etag") !== this.tag || totalOf(answer) !== this.size) {
      await answer.body?.cancel();
      throw new BadInput(`${this.url}: the file has changed on the server`);
    }
    const bytes = await body(answer, this.url);
    if (bytes.length !== count) throw new Truncated(`${this.url}: ${count} bytes were requested, ${bytes.length} arrived`);
    return bytes;
  }
}

async function get(url: string, request: RequestInit, start: number, count: number): Promise<Response> {
  const headers = new Headers(request.headers);
  headers.set("Range", `bytes=${start}-${start + count - 1}`);
  try {
    return await fetch(url, { signal: AbortSignal.timeout(TIMEOUT_MS), ...request, headers });
  } catch (error) {
    throw new BadInput(`${url}: ${error instanceof Error ? error.message : "no answer"}`);
  }
}

/** The size of the whole file, from a partial response. */
function totalOf(answer: Response): number | undefined {
  const match = /^bytes \d+-\d+\/(\d{1,15})$/.exec(answer.headers.get("content-range") ?? "");
  return match ? Number(match[1]) : undefined;
}

/** The body of an answer, of at most 2^30 bytes. */
async function body(answer: Response, url: string): Promise<Uint8Array> {
  const reader = answer.body?.getReader();
  const parts: Uint8Array[] = [];
  let size = 0;
  for (;;) {
    const next = await readPart(reader, url);
    if (!next) break;
    size += next.length;
    if (size > MOST_DOWNLOAD_BYTES) {
      await reader!.cancel();
      throw new Corrupt(`${url}: more than ${MOST_DOWNLOAD_BYTES} bytes`);
    }
    parts.push(next);
  }
  const bytes = new Uint8Array(size);
  let at = 0;
  for (const part of parts) {
    bytes.set(part, at);
    at += part.length;
  }
  return bytes;
}

async function readPart(reader: ReadableStreamDefaultReader<Uint8Array> | undefined, url: string): Promise<Uint8Array | undefined> {
  try {
    return (await reader?.read())?.value;
  } catch (error) {
    throw new BadInput(`${url}: ${error instanceof Error ? error.message : "the connection broke"}`);
  }
}
