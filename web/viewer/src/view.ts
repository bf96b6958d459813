/** One recording in the picture: its frames, its figures, its place beside other recordings. */

import { Color, Group, Vector3 } from "three";
import { distances } from "./errors.ts";
import { type Frame, Frames } from "./frames.ts";
import { loaders } from "./loaders.ts";
import { CloudFigure, Figure, type Stage, trailFrames } from "./scene.ts";
import type { Facts } from "./session.ts";
import { ErrorScale, type Palette } from "./theme.ts";

/** Frames are loaded this long before they are shown. */
const AHEAD_SECONDS = 1.5;

export type OriginalPlace = "over" | "beside" | "off";

export class RecordingView {
  readonly decoded: Frames;
  readonly original: Frames | null;
  readonly errors: Float32Array;
  /** Turns the recording's vertical axis up, and places the recording in the scene. */
  private readonly root = new Group();
  /** Centre and size of the first frame that has points, in the recording's axes, metres. */
  centre = new Vector3();
  extent = 1;
  lowest = 0;
  /** Smallest coordinates of the same frame. */
  private readonly corner = new Vector3();
  private figure: Figure | CloudFigure | null = null;
  private ghost: Figure | CloudFigure | null = null;
  private readonly colours: Float32Array;
  private readonly ghostColours: Float32Array;
  private shown: Frame | null = null;
  /** Number of the frame in the picture; −1 before the first. */
  shownFrame = -1;

  private constructor(
    readonly facts: Facts,
    private readonly stage: Stage,
    decoded: Frames,
    original: Frames | null,
  ) {
    this.decoded = decoded;
    this.original = original;
    const points = facts.names.length;
    this.errors = new Float32Array(points).fill(NaN);
    this.colours = new Float32Array(3 * points);
    this.ghostColours = new Float32Array(3 * points);
  }

  static async open(facts: Facts, stage: Stage, onLoad: () => void): Promise<RecordingView> {
    const { decoded, original } = await loaders(facts);
    const frameBytes = facts.kind === "motion" ? facts.points * 12 : 15 * Math.max(1000, facts.points);
    const frames = (loader: typeof decoded) => new Frames(facts.frames, loader, frameBytes, AHEAD_SECONDS * facts.rate, onLoad);
    const view = new RecordingView(facts, stage, frames(decoded), original && frames(original));
    await view.build();
    return view;
  }

  /** Make the figures from the first frames that can be decoded and have points. */
  private async build(): Promise<void> {
    let sample: Frame | null = null;
    const tries = 12;
    for (let k = 0; k < tries && !sample; k++) {
      const frame = await this.decoded.wait(Math.floor((k / tries) * this.facts.frames));
      if (frame?.positions.some((value) => !Number.isNaN(value))) sample = frame;
    }
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    sample?.positions.forEach((value, i) => {
      if (Number.isNaN(value)) return;
      low[i % 3] = Math.min(low[i % 3], value);
      high[i % 3] = Math.max(high[i % 3], value);
    });
    if (sample && Number.isFinite(low[0])) {
      this.centre.set(...(low.map((v, i) => (v + high[i]) / 2) as [number, number, number]));
      this.extent = Math.max(1e-3, Math.hypot(...high.map((v, i) => v - low[i])));
      this.corner.set(...(low as [number, number, number]));
    }
    const make = (isGhost: boolean) =>
      this.facts.kind === "clouds"
        ? new CloudFigure(0.006 * this.extent)
        : new Figure(this.facts.links, pointSize(this.facts.points, this.extent) * (isGhost ? 1.1 : 1), isGhost);
    this.figure = make(false);
    this.orient(this.facts.up);
    this.stage.scene.add(this.root);
    this.root.add(this.figure.group);
    if (this.original) {
      this.ghost = make(true);
      this.root.add(this.ghost.group);
    }
  }

  /** Make an axis of the recording the vertical one. */
  orient(up: Facts["up"]): void {
    this.facts.up = up;
    this.lowest = this.corner.getComponent("xyz".indexOf(up));
    this.root.rotation.set(up === "z" ? -Math.PI / 2 : 0, 0, up === "x" ? Math.PI / 2 : 0);
  }

  /** Frame number at a time. */
  frameAt(seconds: number): number {
    return Math.max(0, Math.min(this.facts.frames - 1, Math.floor(seconds * this.facts.rate + 1e-6)));
  }

  /** Draw a frame; returns false while it is being loaded. */
  show(frame: number, place: OriginalPlace, selected: number, scale: ErrorScale | null, palette: Palette): boolean {
    if (!this.figure) return false;
    const now = this.decoded.at(frame);
    const before = this.original?.at(frame) ?? null;
    if (!now) return false;
    this.shown = now;
    if (this.figure instanceof CloudFigure) {
      this.figure.show(now, new Color(palette.point));
    } else {
      if (before) distances(now, before, this.errors);
      else this.errors.fill(NaN);
      const one = new Color(palette.point);
      for (let i = 0; i < this.facts.points; i++) {
        if (before && scale) scale.write(this.errors[i], this.colours, 3 * i);
        else one.toArray(this.colours, 3 * i);
      }
      this.figure.show(now, this.colours, selected);
    }
    if (this.ghost) {
      this.ghost.group.visible = place !== "off" && before !== null;
      this.ghost.group.position.copy(place === "beside" ? this.sideways(0.75 * this.extent) : new Vector3());
      const grey = new Color(palette.ghost);
      if (before && this.ghost instanceof CloudFigure) this.ghost.show(before, grey);
      else if (before && this.ghost instanceof Figure) {
        for (let i = 0; i < this.facts.points; i++) grey.toArray(this.ghostColours, 3 * i);
        this.ghost.show(before, this.ghostColours, -1);
      }
    }
    const isWhole = before !== null || this.original === null || this.original.failure(frame) !== null;
    if (isWhole) this.shownFrame = frame;
    return isWhole;
  }

  /** Show the path of one point; −1: of none. */
  async trail(point: number, frame: number, colour: number): Promise<void> {
    if (!(this.figure instanceof Figure)) return;
    const segments: number[] = [];
    const reach = point < 0 ? 0 : trailFrames(this.facts.rate);
    let last: Float32Array | null = null;
    for (let f = Math.max(0, frame - reach); f <= Math.min(this.facts.frames - 1, frame + reach) && reach; f++) {
      const positions = this.decoded.at(f)?.positions;
      const here = positions?.slice(3 * point, 3 * point + 3) ?? null;
      if (here && last && !Number.isNaN(here[0]) && !Number.isNaN(last[0])) segments.push(...last, ...here);
      last = here;
    }
    this.figure.showTrail(new Float32Array(segments), colour);
  }

  /** Positions of the shown frame. */
  get positions(): Float32Array | null {
    return this.shown?.positions ?? null;
  }

  /** Maps a point from the recording's axes to the scene's. */
  toScene(position: Vector3): Vector3 {
    return position.applyQuaternion(this.root.quaternion).add(this.root.position);
  }

  /** Maps a direction from the recording's axes to the scene's. */
  turned(direction: Vector3): Vector3 {
    return direction.applyQuaternion(this.root.quaternion);
  }

  /** Put the centre of the recording's first frame over this place of the ground, metres. */
  putAt(x: number, height: number, z: number): void {
    const centre = this.turned(this.centre.clone());
    this.root.position.set(x - centre.x, height - this.lowest, z - centre.z);
  }

  /** Middle of the shown points in the scene. */
  middle(): Vector3 {
    const positions = this.shown?.positions;
    const sum = new Vector3();
    let count = 0;
    const stride = positions && positions.length > 9000 ? 9 * 3 : 3;
    for (let i = 0; positions && i < positions.length; i += stride) {
      if (Number.isNaN(positions[i])) continue;
      sum.x += positions[i];
      sum.y += positions[i + 1];
      sum.z += positions[i + 2];
      count++;
    }
    const middle = count ? sum.divideScalar(count) : this.centre.clone();
    return this.toScene(middle);
  }

  /** A vector of this length along the first horizontal axis. */
  sideways(metres: number): Vector3 {
    return this.facts.up === "x" ? new Vector3(0, metres, 0) : new Vector3(metres, 0, 0);
  }

  close(): void {
    this.stage.scene.remove(this.root);
    this.figure?.dispose();
    this.ghost?.dispose();
  }
}

/** Radius of a point: smaller for many points, which would hide one another. */
function pointSize(points: number, extent: number): number {
  return 0.0075 * extent * Math.min(1, Math.cbrt(400 / Math.max(1, points)));
}
