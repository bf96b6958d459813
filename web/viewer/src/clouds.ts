/**
 * Point clouds of .mocz files, decoded in a worker, so that the page can still draw.
 *
 *     page: CloudReader ── { ticket, source | a, b } ─► worker: serve ─► { ticket, frames | error }
 *
 * The worker runs the page's own script (main.ts): the page is one file.
 */

import type { MoczFile, Source } from "../../decoder/src/index.js";
import type { Frame } from "./frames.ts";
import { openFile } from "./opening.ts";

/** Decoding in the page pauses after this time, milliseconds, so that the page can draw. */
const BUSY_MS = 30;

/** The script of the page; empty in a worker. `currentScript` is set only while the script first runs. */
const SCRIPT = typeof document === "undefined" ? "" : (document.currentScript?.textContent ?? "");

interface Request {
  ticket: number;
  /** The file, only in the first request; later ones ask for ranges of its frames. */
  source?: Source;
  a: number;
  b: number;
}

interface Answer {
  ticket: number;
  frames: Frame[];
  damage: Damage[];
  error?: string;
}

/** A run of frames that could not be decoded. */
interface Damage {
  start: number;
  frames: number;
  message: string;
}

/** Damage found in a file so far. */
export function damageOf(file: MoczFile): Damage[] {
  return file.damage.map(({ start, frames, error }) => ({ start, frames, message: error.message }));
}

interface Pending {
  request: Request;
  resolve: (frames: Frame[]) => void;
  reject: (error: Error) => void;
}

/** Decodes frames of one file, in the order of the requests. */
export class CloudReader {
  /** Damage found so far. */
  damage: Damage[] = [];
  private worker: Worker | null = null;
  private readonly pending = new Map<number, Pending>();
  private tickets = 0;
  /** The file, if the page decodes it itself. */
  private file: Promise<MoczFile> | undefined;

  constructor(private readonly source: Source) {
    try {
      const place = URL.createObjectURL(new Blob([SCRIPT], { type: "text/javascript" }));
      this.worker = new Worker(place);
      this.worker.onmessage = ({ data }: MessageEvent<Answer>) => this.settle(data);
      this.worker.onerror = () => this.goOnHere();
    } catch {
      this.worker = null; // the browser forbids workers
    }
    if (this.worker) void this.ask({ source, a: 0, b: 0 });
  }

  /** Frames a … b − 1. */
  read(a: number, b: number): Promise<Frame[]> {
    return this.ask({ a, b });
  }

  close(): void {
    this.worker?.terminate();
  }

  private ask(request: Omit<Request, "ticket">): Promise<Frame[]> {
    const own = { ...request, ticket: this.tickets++ };
    return new Promise((resolve, reject) => {
      this.pending.set(own.ticket, { request: own, resolve, reject });
      if (this.worker) this.worker.postMessage(own);
      else void this.decodeHere(own);
    });
  }

  private settle({ ticket, frames, damage, error }: Answer): void {
    this.damage = damage;
    const waiting = this.pending.get(ticket);
    this.pending.delete(ticket);
    if (error === undefined) waiting?.resolve(frames);
    else waiting?.reject(new Error(error));
  }

  /** Decode without the worker, which could not start. */
  private goOnHere(): void {
    this.worker?.terminate();
    this.worker = null;
    for (const { request } of this.pending.values()) void this.decodeHere(request);
  }

  private async decodeHere({ ticket, a, b }: Request): Promise<void> {
    this.file ??= openFile(this.source);
    this.settle(await answered(ticket, this.file, a, b, true));
  }
}

async function answered(ticket: number, file: Promise<MoczFile>, a: number, b: number, pauses: boolean): Promise<Answer> {
  try {
    const opened = await file;
    return { ticket, frames: await framesOf(opened, a, b, pauses), damage: damageOf(opened) };
  } catch (error) {
    return { ticket, frames: [], damage: [], error: error instanceof Error ? error.message : String(error) };
  }
}

async function framesOf(file: MoczFile, a: number, b: number, pauses: boolean): Promise<Frame[]> {
  const frames: Frame[] = [];
  let last = performance.now();
  for await (const { positions, colours } of file.clouds(a, b)) {
    // a copy of the colours: frames may share them
    frames.push({ positions: new Float32Array(positions), colours: colours?.slice() ?? null });
    if (!pauses || performance.now() - last < BUSY_MS) continue;
    await new Promise((resolve) => setTimeout(resolve));
    last = performance.now();
  }
  return frames;
}

/** The worker: answers one request after the other. */
export function serve(): void {
  let file: Promise<MoczFile> | undefined;
  let queue = Promise.resolve();
  addEventListener("message", ({ data }: MessageEvent<Request>) => {
    queue = queue.then(async () => {
      if (data.source !== undefined) {
        file = openFile(data.source);
        file.catch(() => undefined); // the requests for its frames report the error
      }
      const answer = data.source === undefined ? await answered(data.ticket, file!, data.a, data.b, false) : { ticket: data.ticket, frames: [], damage: [] };
      const buffers = answer.frames.flatMap(({ positions, colours }) => [positions.buffer, ...(colours ? [colours.buffer] : [])]);
      postMessage(answer, { transfer: buffers });
    });
  });
}
