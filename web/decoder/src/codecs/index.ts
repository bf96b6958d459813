/** Chooses the decoder of a codec. Modules of rarer codecs are loaded when a file needs them. */

import { Corrupt, UnknownCodec, Unsupported, check } from "../errors.js";
import type { ChunkDecoder, Decoded, Facts, StoredChunk } from "./codec.js";
import type { PriorLoader } from "./tempo/prior.js";
import { openTempo } from "./tempo/tempo.js";

/** The decoder of a file's chunks. Throws UnknownCodec, Unsupported, Corrupt. */
export async function chunkDecoder(codec: string, facts: Facts, priors: PriorLoader): Promise<ChunkDecoder> {
  if (facts.shared.length === 0) return new GapsOnly(facts.points);
  if (codec === "tempo") return openTempo(facts, priors);
  if (codec === "hou2014") {
    const { openHou2014 } = await import("./hou2014.js");
    return openHou2014({ points: facts.points, parents: facts.skeleton?.parents, shared: facts.shared });
  }
  if (codec === "lossless") {
    const { Lossless } = await import("./lossless.js");
    return new Lossless(facts);
  }
  if (codec === "liu2006") {
    const { openLiu2006 } = await import("./liu2006.js");
    return openLiu2006(facts);
  }
  throw codec === "lien2006" || codec === "bodycast"
    ? new Unsupported(`${codec} codes point clouds, which have no frames of points`)
    : new UnknownCodec(`this decoder has no codec ${codec}`);
}

const MOST_FRAMES_WITHOUT_SAMPLES = 65_536;

/** Motions without samples: no points, or every point missing in every frame. */
class GapsOnly implements ChunkDecoder {
  constructor(private readonly points: number) {}

  decode(window: StoredChunk[], which: number): Decoded {
    const { frames, payload } = window[which]!;
    check(payload.length === 0 && frames <= MOST_FRAMES_WITHOUT_SAMPLES, "a chunk without samples has a payload, or too many frames");
    if (frames * this.points * 3 > 2 ** 27) throw new Corrupt("a chunk has too many samples");
    return { positions: new Float64Array(3 * frames * this.points).fill(NaN) };
  }
}
