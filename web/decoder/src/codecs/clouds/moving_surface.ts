/** The surface of a body in the frames of a chunk (docs/payloads/bodycast.md, "Surface of a frame"). */

import { check } from "../../errors.js";
import { clip8, halfToEven } from "../../numbers.js";
import { VideoDecoder } from "../../video/video.js";
import type { Body, Placement } from "../bodies.js";
import { type Atlas, type Planes, nextPlanes } from "./atlas.js";
import type { Cloud } from "./cloud.js";
import { type Sample, sampleSurface } from "./sampling.js";
import { Skin } from "./skin.js";

export class MovingSurface {
  /** State of the video decoder after the key picture. */
  private readonly video = new VideoDecoder();
  private readonly samples: Sample[];
  private readonly skin: Skin;
  private readonly key: Cloud;

  /** Decodes the key picture. Throws Corrupt, Unsupported. */
  constructor(
    body: Body,
    private readonly atlas: Atlas,
  ) {
    const planes = nextPlanes(atlas, this.video, atlas.keyPicture);
    this.samples = sampleSurface(body, atlas, planes[0], atlas.points);
    this.skin = new Skin(body, this.samples);
    this.key = this.canonical(planes);
  }

  /** Yields frame after frame, null where isShown is false. placements: poses of the links in each frame; pictures: packets of
   * the changing surface. */
  *frames(placements: Placement[][], pictures: Uint8Array[], isShown: (frame: number) => boolean): Generator<Cloud | null> {
    const { interval } = this.atlas;
    const frames = placements.length;
    check(pictures.length === 0 || pictures.length === 1 + Math.ceil(frames / interval), "bodycast: a wrong number of pictures");
    let video = this.video.copy();
    if (pictures[0]?.length) {
      video = new VideoDecoder();
      nextPlanes(this.atlas, video, pictures[0]);
    }
    let surface = this.key;
    for (let t = 0; t < frames; t++) {
      if (pictures.length && t % interval === 0) surface = this.canonical(nextPlanes(this.atlas, video, pictures[1 + t / interval]!));
      if (!isShown(t)) {
        yield null;
        continue;
      }
      const cloud: Cloud = { positions: this.skin.posed(surface.positions, placements[t]!) };
      if (surface.colours) cloud.colours = surface.colours;
      yield cloud;
    }
  }

  /** The surface of a picture, in the canonical pose. */
  private canonical([luma, cb, cr]: Planes): Cloud {
    const { samples } = this;
    const below = this.atlas.height * this.atlas.width;
    const positions = new Float64Array(3 * samples.length);
    const colours = new Uint8Array(3 * samples.length);
    samples.forEach(({ cells, weights, foot, out, reach }, i) => {
      let [level, y, blueness, redness] = [0, 0, 0, 0];
      for (let k = 0; k < 4; k++) {
        const [cell, weight] = [cells[k]!, weights[k]!];
        level += weight * luma[below + cell]!;
        y += weight * luma[cell]!;
        blueness += weight * cb[cell]!;
        redness += weight * cr[cell]!;
      }
      const distance = level * (reach / 255);
      for (let c = 0; c < 3; c++) positions[3 * i + c] = foot[c]! + distance * out[c]!;
      const red = y + 1.5748 * (redness - 128);
      const blue = y + 1.8556 * (blueness - 128);
      const green = (y - 0.2126 * red - 0.0722 * blue) / 0.7152;
      for (const [c, value] of [red, green, blue].entries()) colours[3 * i + c] = clip8(halfToEven(value));
    });
    return { positions, colours };
  }
}
