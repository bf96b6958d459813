/** Input and output of codecs (docs/payloads/index.md). */

import type { Skeleton } from "../container/skeleton.js";

/** A chunk as stored in the file. */
export interface StoredChunk {
  frames: number;
  payload: Uint8Array;
}

/** Facts from the header that a codec needs. */
export interface Facts {
  names: string[];
  points: number;
  /** Frames a second. */
  rate: number;
  /** The vertical axis: 0 x, 1 y, 2 z. */
  up: number;
  skeleton: Skeleton | undefined;
  rotations: boolean;
  shared: Uint8Array[];
}

/** A decoded chunk. */
export interface Decoded {
  /** (frames, points, 3), metres; NaN in gaps. */
  positions: Float64Array;
  /** (frames, joints, 4), quaternions, w first; only if the file has rotations. */
  rotations?: Float64Array;
}

/** Decodes the chunks of one file. */
export interface ChunkDecoder {
  /** Decodes chunk `which` of a window, which contains its neighbours within the file's margin. */
  decode(window: StoredChunk[], which: number): Decoded;
  /** Frames of a chunk, counted from its first, at which a clip, segment or key frame begins, by kind. Absent: the codec has none. */
  marks?(chunk: StoredChunk): Record<string, number[]>;
}
