/** Channels of signals in .mocz files: ranges of their values in equal parts of the recording, as in mocodec.viewer.facts. */

import type { Signal } from "../../decoder/src/index.js";
import type { SignalFacts } from "./session.ts";

const BINS = 1024;
const MOST_SAMPLES = 8_000_000;
const MOST_CHANNELS = 64;

/** Ranges of the numeric channels, forces first. */
export async function channelsOf(signals: Signal[]): Promise<SignalFacts[]> {
  const found: SignalFacts[] = [];
  const seen = new Map<string, number>();
  let left = MOST_SAMPLES;
  for (const signal of signals) {
    const [samples, channels] = [signal.shape[0] ?? 0, signal.shape.slice(1).reduce((product, size) => product * size, 1)];
    if (samples * channels > left || found.length + channels > MOST_CHANNELS) break;
    left -= samples * channels;
    if (samples === 0 || /c|U/.test(signal.dtype)) continue; // complex numbers and texts
    const values = await signal.read(0, samples);
    for (let channel = 0; channel < channels; channel++) {
      const name = signal.labels[channel] || (channels > 1 ? `${signal.path} ${channel + 1}` : signal.path);
      const count = (seen.get(name) ?? 0) + 1;
      seen.set(name, count);
      found.push({ label: count > 1 ? `${name} (${count})` : name, unit: signal.units[channel] ?? "", ...envelope(values, channel, channels, samples) });
    }
  }
  return found.sort((a, b) => rank(a.label) - rank(b.label));
}

function rank(label: string): number {
  if (/^(fz|force\.fz|fy|fx)/i.test(label)) return 0;
  return /residual/i.test(label) ? 2 : 1;
}

/** The smallest and largest value of a channel in up to BINS parts; values that are not finite count as 0. */
function envelope(values: ArrayLike<number>, channel: number, channels: number, samples: number): { low: number[]; high: number[] } {
  const bins = Math.min(BINS, samples);
  const [low, high] = [new Array<number>(bins).fill(Infinity), new Array<number>(bins).fill(-Infinity)];
  for (let sample = 0; sample < samples; sample++) {
    const raw = values[sample * channels + channel];
    const value = Number.isFinite(raw) ? raw : 0;
    const bin = Math.floor((sample * bins) / samples);
    if (value < low[bin]) low[bin] = value;
    if (value > high[bin]) high[bin] = value;
  }
  return { low, high };
}
