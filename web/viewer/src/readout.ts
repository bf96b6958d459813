/** Texts that change with the frame: the clock, the frame's errors, and the name beside the chosen point. */

import { Vector3 } from "three";
import { summary } from "./errors.ts";
import type { Stage } from "./scene.ts";
import { length, time, whole } from "./text.ts";
import type { RecordingView } from "./view.ts";

/** Least time between changes of texts while playing, milliseconds: faster changes are not readable. */
const TEXT_MS = 100;

export class Readout {
  /** Elements that show the errors of the frame. */
  here: { mean: HTMLElement; max: HTMLElement } | null = null;
  private lastText = 0;

  constructor(
    private readonly clock: HTMLElement,
    private readonly label: HTMLElement,
  ) {}

  /** Show time and errors of a frame, at most every TEXT_MS. Returns whether it showed errors. */
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

  /** Show the name and error of a point beside it; −1: of no point. */
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
