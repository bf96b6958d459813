/** The session: what a page shows, as JSON that `mocodec.viewer.session` writes (or that this page makes of dropped files).
 *
 * Lengths are metres, times seconds. Frames count from 0.
 */

import { readable } from "./text.ts";

export interface Session {
  version: 1;
  title: string;
  recordings: Facts[];
}

/** Facts about one recording, and where its frames come from. */
export interface Facts {
  name: string;
  kind: "motion" | "clouds";
  frames: number;
  points: number;
  rate: number;
  up: "x" | "y" | "z";
  names: string[];
  /** Pairs of points to connect by a line. */
  links: [number, number][];
  codec: string | null;
  /** Size of the compressed file, and size as float32 positions over it. */
  bytes: number | null;
  /** Size of the file that it is compared with, if that is one file. */
  originalBytes: number | null;
  ratio: number | null;
  promise: Record<string, number>;
  /** First frame and bytes of chunks, or of runs of chunks in a long file. */
  chunks: [number, number][];
  /** Kinds of frames at which the codec begins something (clip, segment, key frame), each with its frames. */
  marks: { label: string; frames: number[] }[];
  events: { label: string; seconds: number }[];
  signals: SignalFacts[];
  /** Share of points missing in equal parts of the recording. */
  gaps: number[];
  errors: ErrorFacts | null;
  /** Runs of frames (start, stop) that cannot be decoded. */
  damage: [number, number][];
  notes: string[];
  decoded: Media;
  original: Media | null;
}

/** One channel: its smallest and largest value in equal parts of the recording. */
export interface SignalFacts {
  label: string;
  unit: string;
  low: number[];
  high: number[];
}

/** Errors against the original over all frames. */
export interface ErrorFacts {
  mean: number;
  p99: number;
  max: number;
  /** Frame and point of the largest error. */
  maxAt: [number, number] | null;
  /** Runs of `binFrames` frames each: mean and largest error, and the frame of the largest; −1 where nothing is known. */
  binFrames: number;
  binMean: number[];
  binMax: number[];
  binWorst: number[];
  /** Of each point. */
  pointMean: number[];
  pointMax: number[];
}

/** Where frames come from. */
export type Media =
  /** A server that decodes: GET url?from=a&to=b (docs/howto/view.md). */
  | { type: "frames"; url: string }
  /** A .mocz that this page decodes. */
  | { type: "mocz"; url?: string; base64?: string; id?: number }
  /** All frames within the page: see packed.ts. `step` metres, `origin` metres; relative to the decoded frames or not. */
  | { type: "packed"; base64: string; step: number; origin: [number, number, number]; relative: boolean }
  /** All frames of point clouds within the page. */
  | { type: "packed-clouds"; base64: string; counts: number[]; step: number; origin: [number, number, number] };

/** The session at a place, or the one embedded in this page; null if there is none and files must be dropped. */
export async function load(place = new URLSearchParams(location.search).get("session")): Promise<Session | null> {
  const embedded = document.getElementById("session")?.textContent?.trim();
  if (embedded && embedded !== "null") return checked(JSON.parse(embedded));
  if (place === null) return null;
  const url = new URL(place, location.href);
  if (url.origin !== location.origin) throw new Error("a session must come from the place of this page");
  const response = await fetch(url);
  if (!response.ok) throw new Error((await response.text()) || `the server answers ${response.status} for ${place}`);
  return checked(await response.json());
}

/** Facts whose texts can be shown: see `readable`. */
export function withReadableTexts(facts: Facts): Facts {
  return {
    ...facts,
    name: readable(facts.name),
    names: facts.names.map(readable),
    events: facts.events.map((event) => ({ ...event, label: readable(event.label) })),
    signals: facts.signals.map((signal) => ({ ...signal, label: readable(signal.label), unit: readable(signal.unit) })),
    notes: facts.notes.map(readable),
  };
}

function checked(value: unknown): Session {
  const session = value as Session;
  if (session?.version !== 1) throw new Error("this page is older than its data: it needs session version 1");
  for (const { rate, frames } of session.recordings) {
    if (!(rate > 0 && Number.isFinite(rate) && Number.isInteger(frames) && frames >= 0)) throw new Error("a recording without a rate");
  }
  return session;
}
