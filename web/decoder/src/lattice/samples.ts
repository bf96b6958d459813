/** Decoded samples of a chunk, point by point, and their activities. */

export class Samples {
  /** (points, frames, 3). */
  readonly values: Float64Array;
  private readonly activities: Int16Array;
  private readonly radial: Int16Array;

  /** apart: (frames, points), 1 in gaps and frozen runs, or null. */
  constructor(
    readonly frames: number,
    readonly points: number,
    private readonly apart: Uint8Array | null,
  ) {
    this.values = new Float64Array(3 * frames * points);
    this.activities = new Int16Array(frames * points);
    this.radial = new Int16Array(frames * points);
  }

  isApart(t: number, point: number): boolean {
    return this.apart !== null && this.apart[t * this.points + point] === 1;
  }

  get(t: number, point: number, c: number): number {
    return this.values[3 * (point * this.frames + t) + c]!;
  }

  set(t: number, point: number, value: Float64Array): void {
    const at = 3 * (point * this.frames + t);
    this.values[at] = value[0]!;
    this.values[at + 1] = value[1]!;
    this.values[at + 2] = value[2]!;
  }

  activity(t: number, point: number): number {
    return this.activities[point * this.frames + t]!;
  }

  radialActivity(t: number, point: number): number {
    return this.radial[point * this.frames + t]!;
  }

  setActivity(t: number, point: number, activity: number, radial: number): void {
    this.activities[point * this.frames + t] = activity;
    this.radial[point * this.frames + t] = radial;
  }

  /** (frames, points, 3). */
  byFrame(): Float64Array {
    return byFrame(this.values, this.frames, this.points, 3);
  }
}

/** Reorders the first three lanes of values (points, frames, lanes) to (frames, points, 3). */
export function byFrame(values: Float64Array, frames: number, points: number, lanes: number): Float64Array {
  const out = new Float64Array(3 * frames * points);
  for (let point = 0, from = 0; point < points; point++) {
    for (let t = 0, to = 3 * point; t < frames; t++, from += lanes, to += 3 * points) {
      out[to] = values[from]!;
      out[to + 1] = values[from + 1]!;
      out[to + 2] = values[from + 2]!;
    }
  }
  return out;
}
