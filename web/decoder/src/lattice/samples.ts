/** Decoded samples of a chunk, point after point, and their activities. */

export class Samples {
  private readonly values: Float64Array;
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

  /** Z(s) − 2 Z(s − half) + Z(s − 2 half). */
  secondDifference(point: number, s: number, half: number, c: number): number {
    return this.get(s, point, c) - 2 * this.get(s - half, point, c) + this.get(s - 2 * half, point, c);
  }

  /** Z(s) − (Z(s − half) + Z(s + half)) / 2; 0 beside the ends. */
  bend(point: number, s: number, half: number, c: number): number {
    if (s < half || s + half >= this.frames) return 0;
    return this.get(s, point, c) - (this.get(s - half, point, c) + this.get(s + half, point, c)) / 2;
  }

  /** (frames, points, 3). */
  byFrame(): Float64Array {
    const out = new Float64Array(this.values.length);
    for (let point = 0; point < this.points; point++) {
      for (let t = 0; t < this.frames; t++) {
        for (let c = 0; c < 3; c++) out[3 * (t * this.points + point) + c] = this.get(t, point, c);
      }
    }
    return out;
  }
}
