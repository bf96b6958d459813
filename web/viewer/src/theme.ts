/** Colours of the picture in the light and the dark theme; the colours of the page are in style.css. */

import { Color } from "three";

export interface Palette {
  paper: number;
  ink: number;
  point: number;
  ghost: number;
  grid: number;
  gridStrong: number;
  middle: number;
  accent: number;
}

export const PALETTES: Record<"light" | "dark", Palette> = {
  light: { paper: 0xfbfbf8, ink: 0x1d2430, point: 0x3f6ea8, ghost: 0x8a8f98, grid: 0xe3e3de, gridStrong: 0xcfcfc8, middle: 0xe0a030, accent: 0xc8442e },
  dark: { paper: 0x14171c, ink: 0xe8eaee, point: 0x7fb0ea, ghost: 0x9aa1ad, grid: 0x2a2f38, gridStrong: 0x3a414d, middle: 0xf0b545, accent: 0xff6a4d },
};

/** Colours of errors: from the colour of a point over yellow to the accent at `scale` and above. */
export class ErrorScale {
  private readonly low: Color;
  private readonly middle: Color;
  private readonly high: Color;

  constructor(
    palette: Palette,
    readonly scale: number,
  ) {
    this.low = new Color(palette.point);
    this.middle = new Color(palette.middle);
    this.high = new Color(palette.accent);
  }

  /** Write the colour of an error into `out` at `at`; gaps and missing errors have the colour of zero. */
  write(error: number, out: Float32Array, at: number): void {
    const share = Math.min(1, Math.max(0, error / this.scale || 0));
    const colour = share < 0.5 ? lerp(this.low, this.middle, 2 * share) : lerp(this.middle, this.high, 2 * share - 1);
    out[at] = colour.r;
    out[at + 1] = colour.g;
    out[at + 2] = colour.b;
  }
}

const mixed = new Color();
function lerp(a: Color, b: Color, share: number): Color {
  return mixed.copy(a).lerp(b, share);
}
