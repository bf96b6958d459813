/** What a codec gets and gives (docs/payloads/index.md). */

import type { Skeleton } from "../container/skeleton.js";

/** A chunk as it stands in the file. */
export interface StoredChunk {
  frames: number;
  payload: Uint8Array;
}

/** What a codec needs of the header. */
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
  /** (frames, joints, 4), quaternions, w first; only where the file has rotations. */
  rotations?: Float64Array;
}

/** Decodes the chunks of one file. */
export interface ChunkDecoder {
  /** Chunk `which` of a window of neighbouring chunks: those within the file's margin around it. */
  decode(window: StoredChunk[], which: number): Decoded;
  /** Frames of a chunk, counted from its first, at which the codec begins something, by what begins there. Absent: nothing ever does. */
  marks?(chunk: StoredChunk): Record<string, number[]>;
}
