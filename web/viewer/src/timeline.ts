/** The timeline: error over time, bytes, gaps, damage, events and signals, drawn on one canvas; clicks and drags seek. */

import type { Facts } from "./session.ts";
import { length, time } from "./text.ts";

const ERROR_HEIGHT = 56;
const RIBBON = 8;
const SIGNAL_HEIGHT = 26;
const GUTTER = 4;
const LABELS = 16;
const MOST_SIGNALS = 8;

export class Timeline {
  /** Shown signals: numbers in `facts.signals`. */
  private strips: number[] = [];
  private facts: Facts | null = null;
  private frame = 0;
  /** Width of the canvas in CSS pixels. Cached, since reading it makes the browser lay out the page. */
  private width = 1;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly tip: HTMLElement,
    private readonly head: HTMLElement,
    private readonly pointer: HTMLElement,
    seek: (frame: number) => void,
  ) {
    let dragging = false;
    const move = (event: PointerEvent) => {
      if (!this.facts) return;
      const box = canvas.getBoundingClientRect();
      const frame = this.frameAt(event.clientX - box.left);
      if (dragging) seek(frame);
      this.pointer.hidden = false;
      this.pointer.style.transform = `translateX(${Math.round(event.clientX - box.left)}px)`;
      this.showTip(frame, event.clientX - box.left);
    };
    canvas.addEventListener("pointerdown", (event) => {
      dragging = true;
      canvas.setPointerCapture(event.pointerId);
      const box = canvas.getBoundingClientRect();
      seek(this.nearestPeak(event.clientX - box.left, event.clientY - box.top));
    });
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerup", () => (dragging = false));
    canvas.addEventListener("pointercancel", () => (dragging = false));
    canvas.addEventListener("pointerleave", () => {
      pointer.hidden = true;
      tip.hidden = true;
    });
    new ResizeObserver(() => this.refresh()).observe(canvas.parentElement!);
  }

  show(facts: Facts, strips: number[]): void {
    this.facts = facts;
    this.strips = strips.slice(0, MOST_SIGNALS);
    this.canvas.setAttribute("aria-valuemax", String(facts.frames - 1));
    this.refresh();
  }

  /** Move the head, which is a separate element: drawing the canvas again in each frame takes longer. */
  setFrame(frame: number): void {
    this.frame = frame;
    const x = Math.max(1, Math.min(this.width - 1, this.x(frame)));
    this.head.style.transform = `translateX(${x.toFixed(1)}px)`;
  }

  /** Announce the frame to screen readers. Not called while playing, since it changes too fast. */
  announce(): void {
    this.canvas.setAttribute("aria-valuenow", String(this.frame));
    if (this.facts) this.canvas.setAttribute("aria-valuetext", `frame ${this.frame}, ${time(this.frame / this.facts.rate)}`);
  }

  /** Draw everything again, after a change of size, theme or data. */
  refresh(): void {
    const hasErrors = this.facts?.errors != null;
    const height = LABELS + (hasErrors ? ERROR_HEIGHT + GUTTER : 0) + (RIBBON + GUTTER) * (1 + Number(this.hasGaps) + (this.facts?.marks.length ?? 0)) + this.strips.length * (SIGNAL_HEIGHT + 2) + 2;
    this.canvas.style.height = `${height}px`;
    const scale = Math.min(2, devicePixelRatio);
    this.width = Math.max(1, this.canvas.clientWidth);
    this.canvas.width = this.width * scale;
    this.canvas.height = height * scale;
    this.draw();
    this.setFrame(this.frame);
  }

  private frameAt(x: number): number {
    const count = this.facts!.frames;
    return Math.max(0, Math.min(count - 1, Math.round((x / this.width) * (count - 1))));
  }

  /** The frame under the pointer; in the error curve, the frame of the largest error within three pixels. */
  private nearestPeak(x: number, y: number): number {
    const errors = this.facts?.errors;
    if (!errors || y > LABELS + ERROR_HEIGHT) return this.frameAt(x);
    const first = Math.floor(this.frameAt(x - 3) / errors.binFrames);
    const last = Math.floor(this.frameAt(x + 3) / errors.binFrames);
    let best = first;
    for (let bin = first; bin <= last; bin++) if (errors.binMax[bin] > errors.binMax[best]) best = bin;
    return errors.binWorst[best];
  }

  private showTip(frame: number, x: number): void {
    const facts = this.facts!;
    const parts = [`${time(frame / facts.rate)} · frame ${frame.toLocaleString("en")}`];
    if (facts.errors) {
      const bin = Math.floor(frame / facts.errors.binFrames);
      parts.push(`max ${length(facts.errors.binMax[bin])} · mean ${length(facts.errors.binMean[bin])}`);
    }
    parts.push(...this.marksAt(frame));
    const near = facts.events.filter((event) => Math.abs(this.x(event.seconds * facts.rate) - x) < 5);
    parts.push(...near.slice(0, 3).map((event) => event.label));
    this.tip.textContent = parts.join("\n");
    this.tip.hidden = false;
    const width = this.tip.offsetWidth;
    this.tip.style.left = `${Math.max(4, Math.min(this.width - width - 4, x - width / 2))}px`;
  }

  private get hasGaps(): boolean {
    return this.facts !== null && (this.facts.damage.length > 0 || this.facts.gaps.some((share) => share > 0));
  }

  private x(frame: number): number {
    return (frame / Math.max(1, (this.facts?.frames ?? 1) - 1)) * this.width;
  }

  private draw(): void {
    if (!this.facts) return;
    const { facts, width } = this;
    const pen = this.canvas.getContext("2d")!;
    const scale = this.canvas.width / width;
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.font = "11px system-ui, sans-serif";
    this.drawTimes(pen, width);
    let top = LABELS;
    if (facts.errors) {
      this.drawErrors(pen, top, width);
      top += ERROR_HEIGHT + GUTTER;
    }
    this.drawBytes(pen, top, width);
    top += RIBBON + GUTTER;
    for (const { frames } of facts.marks) {
      this.drawMarks(pen, top, frames);
      top += RIBBON + GUTTER;
    }
    if (this.hasGaps) {
      this.drawGaps(pen, top, width);
      top += RIBBON + GUTTER;
    }
    for (const strip of this.strips) {
      this.drawSignal(pen, top, width, strip);
      top += SIGNAL_HEIGHT + 2;
    }
    pen.fillStyle = css("--accent-2");
    for (const event of facts.events) {
      const x = this.x(event.seconds * facts.rate);
      pen.fillRect(Math.round(x), LABELS - 5, 1.5, top - LABELS + 3);
    }
  }

  private drawTimes(pen: CanvasRenderingContext2D, width: number): void {
    const facts = this.facts!;
    const seconds = facts.frames / facts.rate;
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600].find((s) => (width * s) / seconds > 70) ?? 7200 * Math.ceil((70 * seconds) / (7200 * Math.max(1, width)));
    if (!(seconds > 0 && Number.isFinite(step))) return;
    pen.fillStyle = css("--muted");
    pen.textBaseline = "top";
    for (let second = 0; second < seconds; second += step) {
      const x = this.x(second * facts.rate);
      if (x > width - 30) break;
      pen.fillRect(Math.round(x), LABELS - 4, 1, 4);
      const text = step < 1 ? `${second.toFixed(1)} s` : second < 60 ? `${second} s` : time(second).replace(/\.00$/, "");
      pen.fillText(text, x + 3, 0);
    }
  }

  private drawErrors(pen: CanvasRenderingContext2D, top: number, width: number): void {
    const { errors, promise } = this.facts!;
    if (!errors) return;
    const bound = promise.max_error ?? promise.mean_error ?? 0;
    const scale = Math.max(errors.max, promise.max_error ?? 0) * 1.08 || 1;
    const y = (error: number) => top + ERROR_HEIGHT * (1 - error / scale);
    pen.fillStyle = css("--raised");
    pen.fillRect(0, top, width, ERROR_HEIGHT);
    const column = (values: number[], pick: "max" | "mean") => {
      const columns = new Float64Array(width);
      for (let x = 0; x < width; x++) {
        const first = Math.floor((x / width) * values.length);
        const last = Math.max(first + 1, Math.ceil(((x + 1) / width) * values.length));
        let sum = 0;
        let count = 0;
        let largest = 0;
        for (let i = first; i < last; i++) {
          if (values[i] < 0) continue; // no error is known here
          sum += values[i];
          count++;
          largest = Math.max(largest, values[i]);
        }
        columns[x] = pick === "max" ? largest : count ? sum / count : NaN;
      }
      return columns;
    };
    pen.fillStyle = css("--error-max");
    column(errors.binMax, "max").forEach((error, x) => pen.fillRect(x, y(error), 1, top + ERROR_HEIGHT - y(error)));
    pen.strokeStyle = css("--accent");
    pen.lineWidth = 1.5;
    pen.beginPath();
    column(errors.binMean, "mean").forEach((error, x) => {
      if (Number.isNaN(error)) pen.moveTo(x + 1, y(0));
      else pen.lineTo(x, y(error));
    });
    pen.stroke();
    if (bound > 0 && bound <= scale) {
      pen.strokeStyle = css("--ink");
      pen.lineWidth = 1;
      pen.setLineDash([4, 4]);
      pen.beginPath();
      pen.moveTo(0, y(bound));
      pen.lineTo(width, y(bound));
      pen.stroke();
      pen.setLineDash([]);
    }
    const label = bound > 0 ? `promise ${promise.max_error ? "" : "mean "}${length(bound, true)}` : `max ${length(errors.max)}`;
    pen.textBaseline = "top";
    const box = pen.measureText(label).width;
    pen.fillStyle = css("--raised");
    pen.fillRect(width - box - 10, top + 10, box + 8, 15);
    pen.fillStyle = css("--ink");
    pen.fillText(label, width - box - 6, top + 12);
  }

  private drawBytes(pen: CanvasRenderingContext2D, top: number, width: number): void {
    const { chunks, frames, rate } = this.facts!;
    if (!chunks.length) return;
    const counts = chunks.map(([start], i) => Math.max(1, (chunks[i + 1]?.[0] ?? frames) - start));
    const densities = chunks.map(([, bytes], i) => bytes / counts[i]);
    const usual = densities.filter((_, i) => counts[i] >= rate / 4); // a chunk of one or two frames would dwarf all others
    const largest = Math.max(...(usual.length ? usual : densities), 1e-9);
    chunks.forEach(([start], i) => {
      const stop = chunks[i + 1]?.[0] ?? frames;
      pen.globalAlpha = 0.12 + 0.78 * Math.min(1, densities[i] / largest);
      pen.fillStyle = css("--blue");
      const left = this.x(start);
      const span = Math.max(1, this.x(Math.min(stop, frames - 1)) - left - (width / chunks.length > 6 ? 1 : 0));
      pen.fillRect(left, top, span, RIBBON);
    });
    pen.globalAlpha = 1;
  }

  private drawMarks(pen: CanvasRenderingContext2D, top: number, frames: number[]): void {
    pen.fillStyle = css("--raised");
    pen.fillRect(0, top, this.width, RIBBON);
    pen.fillStyle = css("--muted");
    for (const frame of frames) pen.fillRect(Math.round(this.x(frame)), top, 1, RIBBON);
  }

  /** Numbers of the clip, segment and key frame at a frame, as text. */
  private marksAt(frame: number): string[] {
    return this.facts!.marks.flatMap(({ label, frames }) => {
      let before = 0;
      for (let high = frames.length; before < high; ) {
        const middle = (before + high) >> 1;
        if (frames[middle] <= frame) before = middle + 1;
        else high = middle;
      }
      return before ? [`${label} ${before} of ${frames.length}`] : [];
    });
  }

  private drawGaps(pen: CanvasRenderingContext2D, top: number, width: number): void {
    const { gaps, damage } = this.facts!;
    pen.fillStyle = css("--raised");
    pen.fillRect(0, top, width, RIBBON);
    gaps.forEach((share, i) => {
      if (!share) return;
      pen.globalAlpha = 0.35 + 0.65 * share;
      pen.fillStyle = css("--yellow");
      pen.fillRect((i / gaps.length) * width, top, Math.max(1, width / gaps.length), RIBBON);
    });
    pen.globalAlpha = 1;
    pen.fillStyle = css("--accent");
    for (const [start, stop] of damage) {
      pen.fillRect(this.x(start), top, Math.max(2, this.x(Math.min(stop, this.facts!.frames - 1)) - this.x(start)), RIBBON);
    }
  }

  private drawSignal(pen: CanvasRenderingContext2D, top: number, width: number, number: number): void {
    const { label, unit, low, high } = this.facts!.signals[number];
    pen.fillStyle = css("--raised");
    pen.fillRect(0, top, width, SIGNAL_HEIGHT);
    const smallest = Math.min(...low);
    const range = Math.max(...high) - smallest || 1;
    const y = (value: number) => top + (SIGNAL_HEIGHT - 2) * (1 - (value - smallest) / range) + 1;
    // one line through all ranges: boxes would leave holes in steep signals
    pen.strokeStyle = css("--green");
    pen.lineWidth = 1.25;
    pen.lineJoin = "round";
    pen.beginPath();
    low.forEach((value, i) => {
      const x = ((i + 0.5) / low.length) * width;
      const isRising = i === 0 || high[i] + value >= high[i - 1] + low[i - 1];
      pen.lineTo(x, y(isRising ? value : high[i]));
      if (high[i] !== value) pen.lineTo(x, y(isRising ? high[i] : value));
    });
    pen.stroke();
    const text = unit ? `${label} (${unit})` : label;
    pen.textBaseline = "top";
    const box = pen.measureText(text).width;
    pen.globalAlpha = 0.8;
    pen.fillStyle = css("--raised");
    pen.fillRect(2, top + 2, box + 6, 14);
    pen.globalAlpha = 1;
    pen.fillStyle = css("--muted");
    pen.fillText(text, 5, top + 3);
  }
}

/** A colour of the theme. */
function css(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
