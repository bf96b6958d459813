/** Texts that follow the frame: the clock, the errors here, and the name of the chosen point beside it. */

import { Vector3 } from "three";
import { summary } from "./errors.ts";
import type { Stage } from "./scene.ts";
import { length, time, whole } from "./text.ts";
import type { RecordingView } from "./view.ts";

/** Texts change at most this often while playing, milliseconds: faster, nobody could read them. */
const TEXT_MS = 100;

export class Readout {
  /** Where the errors of the frame are shown. */
  here: { mean: HTMLElement; max: HTMLElement } | null = null;
  private lastText = 0;

  constructor(
    private readonly clock: HTMLElement,
    private readonly label: HTMLElement,
  ) {}

  /** Show the time and the errors of a frame, unless it is too early; whether there are errors to show. */
  show(view: RecordingView, frame: number, isPlaying: boolean): boolean {
    if (isPlaying && performance.now() - this.lastText <= TEXT_MS) return false;
    this.lastText = performance.now();
    this.clock.textContent = `${time(frame / view.facts.rate)} · frame ${whole(frame)}`;
    if (!this.here) return false;
    const { mean, max, at } = summary(view.errors);
    this.here.mean.textContent = length(mean);
    this.here.max.textContent = at < 0 ? "–" : `${length(max)} ${view.facts.names[at] ?? ""}`;
    return true;
  }

  /** Show the name and error of a point beside it, or of none (−1). */
  mark(view: RecordingView, point: number, stage: Stage): void {
    const { label } = this;
    const { positions, errors, facts } = view;
    label.hidden = point < 0 || !positions || Number.isNaN(positions[3 * point]);
    if (label.hidden || !positions) return;
    const at = stage.project(view.toScene(new Vector3(...positions.slice(3 * point, 3 * point + 3))));
    label.style.left = `${at.x}px`;
    label.style.top = `${at.y}px`;
    const error = errors[point];
    label.textContent = Number.isNaN(error) ? facts.names[point] : `${facts.names[point]}  ${length(error)}`;
  }
}
