/** The session: the content of a page, as JSON from `mocodec.viewer.session` (or made by this page from dropped files).
 *
 * Lengths are metres, times seconds. Frames count from 0.
 */

import { readable } from "./text.ts";

export interface Session {
  version: 1;
  title: string;
  recordings: Facts[];
}

/** Facts about one recording, and the source of its frames. */
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
  /** Size of the compressed file. `ratio`: size of its positions as float32 over it. */
  bytes: number | null;
  /** Size of the file to compare with, if it is one file. */
  originalBytes: number | null;
  ratio: number | null;
  promise: Record<string, number>;
  /** First frame and bytes of chunks, or of runs of chunks in a long file. */
  chunks: [number, number][];
  /** Frames at which a clip, segment or key frame of the codec begins, by kind. */
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
  /** Runs of `binFrames` frames: mean and largest error, and the frame of the largest; −1 where no error is known. */
  binFrames: number;
  binMean: number[];
  binMax: number[];
  binWorst: number[];
  /** Mean and largest error of each point. */
  pointMean: number[];
  pointMax: number[];
}

/** The source of frames. */
export type Media =
  /** A server that decodes: GET url?from=a&to=b (docs/howto/view.md). */
  | { type: "frames"; url: string }
  /** A .mocz that this page decodes. */
  | { type: "mocz"; url?: string; base64?: string; id?: number }
  /** All frames within the page: see packed.ts. `step`, `origin`: metres; `relative`: to the decoded frames. */
  | { type: "packed"; base64: string; step: number; origin: [number, number, number]; relative: boolean }
  /** All frames of point clouds within the page. */
  | { type: "packed-clouds"; base64: string; counts: number[]; step: number; origin: [number, number, number] };

/** The session embedded in this page, or at `place`; null without one: files must be dropped. */
export async function load(place = new URLSearchParams(location.search).get("session")): Promise<Session | null> {
  const embedded = document.getElementById("session")?.textContent?.trim();
  if (embedded && embedded !== "null") return checked(JSON.parse(embedded));
  if (place === null) return null;
  const url = new URL(place, location.href);
  if (url.origin !== location.origin) throw new Error("a session must come from the server of this page");
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
