/** Points of `bodycast` (docs/payloads/bodycast.md): exact, on a lattice, and of frames without bodies. */

import { Bytes } from "../../bytes.js";
import { Unsupported, check } from "../../errors.js";
import { inflateZlib } from "../../inflate.js";
import { type ChunkParts, type PosedBody, readPlacements, readPosedBody, splitChunk } from "../bodies.js";
import type { StoredChunk } from "../codec.js";
import { type Atlas, readAtlas } from "./atlas.js";
import { type Cloud, checkCounts } from "./cloud.js";
import { readExact } from "./exact.js";
import { LEARNED, UNLEARNED, readLattice } from "./lattice.js";
import { type Surface, type Texture, surfaceOf, textureOf } from "./surface.js";

interface Model extends PosedBody {
  atlas: Atlas;
  /** The samples, once they are needed; and rounded with the last shift. */
  texture?: Texture;
  surface?: { shift: number; surface: Surface };
}

/** Decodes the points of the chunks of one file. */
export class PointDecoder {
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

  /** The frames of a chunk, one after the other. Throws Corrupt, and Unsupported for surfaces. */
  *decode(chunk: StoredChunk): Generator<Cloud> {
    const parts = splitChunk(chunk, this.models.length);
    const kind = parts.exactPoints[0];
    if (kind === UNLEARNED || kind === LEARNED) yield* this.lattice(parts, chunk.frames);
    else if (kind !== undefined) yield* readExact(parts.exactPoints, chunk.frames, this.coloured);
    else yield* this.rawFrames(parts, chunk.frames);
  }

  private *lattice(parts: ChunkParts, frames: number): Generator<Cloud> {
    const placed = this.models.map((model, b) => readPlacements(parts.poses[b]!, frames, model));
    const all = [...this.models.keys()];
    yield* readLattice(parts.exactPoints, frames, this.coloured, {
      count: all.length,
      present: (frame) => all.filter((b) => !parts.absent[frame * all.length + b]),
      placements: (body, frame) => placed[body]![frame]!,
      surface: (body, shift) => this.surface(this.models[body]!, shift),
    });
  }

  private surface(model: Model, shift: number): Surface {
    if (model.surface?.shift !== shift) {
      model.texture ??= textureOf(model.body, model.atlas);
      model.surface = { shift, surface: surfaceOf(model.texture, shift) };
    }
    return model.surface.surface;
  }

  /** Frames that no body is in. */
  private *rawFrames({ absent, rawFrames }: ChunkParts, frames: number): Generator<Cloud> {
    const isRaw = Array.from({ length: frames }, (_, t) => this.models.every((_, b) => absent[t * this.models.length + b]));
    if (!isRaw.every(Boolean)) throw new Unsupported("this decoder does not decode surfaces of bodies, only points; see poses()");
    yield* readRawFrames(rawFrames, frames, this.coloured);
  }
}

function readRawFrames(data: Uint8Array, frames: number, coloured: boolean): Cloud[] {
  const part = new Bytes(data, "bodycast: raw frames");
  const counts = Array.from({ length: frames }, () => part.varint());
  checkCounts(counts, data.length);
  const total = counts.reduce((sum, count) => sum + count, 0);
  const size = (coloured ? 15 : 12) * total;
  const content = new Bytes(inflateZlib(part.rest(), size), "bodycast: raw frames");
  check(content.left === size, "bodycast: raw frames have another size");
  return counts.map((count) => {
    const bytes = content.take(12 * count);
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
    const cloud: Cloud = { positions: Float64Array.from({ length: 3 * count }, (_, i) => view.getFloat32(4 * i, true)) };
    if (coloured) cloud.colours = content.take(3 * count).slice();
    return cloud;
  });
}
