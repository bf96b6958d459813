/** Points of `bodycast` (docs/payloads/bodycast.md): body surfaces with outliers, exact points, points on a lattice, frames without bodies. */

import { Bytes } from "../../bytes.js";
import { type ChunkParts, type PosedBody, readPlacements, readPosedBody, splitChunk } from "../bodies.js";
import type { StoredChunk } from "../codec.js";
import { type Atlas, readAtlas } from "./atlas.js";
import { type Cloud, type PointDecoder, joined } from "./cloud.js";
import { readExact } from "./exact.js";
import { readOutliers } from "./outliers.js";
import { EXACT, readExactLattice } from "./exact_lattice.js";
import { type Bodies, KINDS, readLattice } from "./lattice.js";
import { MovingSurface } from "./moving_surface.js";
import { readRawFrames } from "./raw_frames.js";
import { type Surface, type Texture, surfaceOf, textureOf } from "./surface.js";

interface Model extends PosedBody {
  atlas: Atlas;
  /** Samples of the surface, made when first needed; and rounded with the last shift. */
  texture?: Texture;
  surface?: { shift: number; surface: Surface };
  moving?: MovingSurface;
}

/** Decodes the points of the chunks of one file. */
export class BodycastPoints implements PointDecoder {
  private readonly models: Model[];

  constructor(
    shared: Uint8Array[],
    private readonly coloured: boolean,
  ) {
    this.models = shared.map((blob) => {
      const part = new Bytes(blob, "bodycast");
      const own = readPosedBody(part);
      return { ...own, atlas: readAtlas(part, own.body.parents.length) };
    });
  }

  /** The frames of a chunk, one after the other. Throws Corrupt, and Unsupported for pictures of other encoders. */
  *decode(chunk: StoredChunk): Generator<Cloud> {
    const parts = splitChunk(chunk, this.models.length);
    const kind = parts.exactPoints[0];
    if (kind !== undefined && KINDS.includes(kind)) yield* readLattice(parts.exactPoints, chunk.frames, this.coloured, this.bodies(parts, chunk.frames));
    else if (kind === EXACT) yield* readExactLattice(parts.exactPoints, chunk.frames, this.coloured, this.bodies(parts, chunk.frames));
    else if (kind !== undefined) yield* readExact(parts.exactPoints, chunk.frames, this.coloured);
    else yield* this.surfaces(parts, chunk.frames);
  }

  private bodies(parts: ChunkParts, frames: number): Bodies {
    const placed = this.models.map((model, b) => readPlacements(parts.poses[b]!, frames, model));
    const all = [...this.models.keys()];
    return {
      count: all.length,
      present: (frame) => all.filter((b) => !parts.absent[frame * all.length + b]),
      placements: (body, frame) => placed[body]![frame]!,
      surface: (body, shift) => this.surface(this.models[body]!, shift),
    };
  }

  private surface(model: Model, shift: number): Surface {
    if (model.surface?.shift !== shift) {
      model.texture ??= textureOf(model.body, model.atlas);
      model.surface = { shift, surface: surfaceOf(model.texture, shift) };
    }
    return model.surface.surface;
  }

  /** Body surfaces and outliers of each frame; or the raw points of a frame without bodies. */
  private *surfaces({ absent, rawFrames, outliers, poses, pictures }: ChunkParts, frames: number): Generator<Cloud> {
    const { models, coloured } = this;
    const bodies = [...models.keys()];
    const isRaw = Array.from({ length: frames }, (_, t) => bodies.every((b) => absent[t * models.length + b]));
    const raw = readRawFrames(rawFrames, isRaw.filter(Boolean).length, coloured);
    const others = readOutliers(outliers, frames, coloured);
    const surfaces = models.map((model, b) => {
      model.moving ??= new MovingSurface(model.body, model.atlas);
      return model.moving.frames(readPlacements(poses[b]!, frames, model), pictures[b]!, (t) => !absent[t * models.length + b]);
    });
    let next = 0;
    for (let t = 0; t < frames; t++) {
      const shown = surfaces.map((surface): Cloud | null => surface.next().value);
      if (isRaw[t]) yield raw[next++]!;
      else yield joined([...shown.filter((cloud) => cloud !== null), others[t]!], coloured);
    }
  }
}
