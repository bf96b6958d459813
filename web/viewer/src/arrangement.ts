/** Places recordings side by side, and the camera in front of them. */

import type { Vector3 } from "three";
import type { Stage } from "./scene.ts";
import type { Palette } from "./theme.ts";
import type { RecordingView } from "./view.ts";

/** Shares of a figure's extent: distance to the original beside it; vertical motion that the camera does not follow. */
const BESIDE = 0.75;
const STILL = 0.12;

export class Arrangement {
  private views: RecordingView[] = [];
  /** Distance from the first recording to the last, metres. */
  private width = 0;

  constructor(private readonly stage: Stage) {}

  /** Put recordings side by side. */
  place(views: RecordingView[]): void {
    this.views = views;
    this.width = 0;
    if (views.length < 2) return;
    const { x, z } = views[0].turned(views[0].centre.clone());
    views.forEach((view, number) => {
      if (number) this.width += 0.45 * (view.extent + views[number - 1].extent);
      view.putAt(x + this.width, views[0].lowest, z);
    });
  }

  /** Put the camera in front of all recordings. isBeside: whether an original stands beside the decoded figure. */
  frame(view: RecordingView, isBeside: boolean): void {
    const middle = this.middle(view, isBeside);
    if (this.views.length > 1) middle.x += this.views[0].middle().x + this.width / 2 - view.middle().x;
    this.stage.frame(middle, view.extent + this.width + (isBeside ? 0.7 * view.extent : 0));
  }

  /** Move the camera with a figure. */
  follow(view: RecordingView, isBeside: boolean): void {
    const middle = this.middle(view, isBeside);
    const still = STILL * view.extent;
    middle.y = Math.max(middle.y - still, Math.min(middle.y + still, this.stage.controls.target.y));
    this.stage.follow(middle);
  }

  ground(view: RecordingView, palette: Palette): void {
    this.stage.setGround(view.middle(), view.lowest, 2.5 * view.extent, palette);
  }

  private middle(view: RecordingView, isBeside: boolean): Vector3 {
    const middle = view.middle();
    if (isBeside) middle.add(view.turned(view.sideways((BESIDE / 2) * view.extent)));
    return middle;
  }
}
