/** Frames of a recording, loaded block by block ahead of the frame that is shown. */

/** One frame: positions (points · 3) in metres, NaN for a gap; colours 0 to 255 of point clouds. */
export interface Frame {
  positions: Float32Array;
  colours: Uint8Array | null;
}

/** Loads frames [a, b). */
export type Loader = (a: number, b: number) => Promise<Frame[]>;

const BLOCK_FRAMES = 240;
const CACHED_BLOCKS = 40;
const CACHED_BYTES = 256 << 20;

export class Frames {
  private blocks = new Map<number, Frame[]>();
  private loading = new Map<number, Promise<void>>();
  private failed = new Map<number, string>();
  readonly blockFrames: number;

  constructor(
    readonly count: number,
    private loader: Loader,
    frameBytes: number,
    /** Number of frames to load in advance. */
    private ahead: number,
    private onLoad: () => void,
  ) {
    this.blockFrames = Math.max(1, Math.min(BLOCK_FRAMES, Math.floor((8 << 20) / Math.max(1, frameBytes))));
    this.capacity = Math.max(3, Math.min(CACHED_BLOCKS, Math.floor(CACHED_BYTES / (frameBytes * this.blockFrames + 1))));
  }

  private readonly capacity: number;

  /** The frame if it is loaded; else null, and loading begins. The blocks after it are loaded too, one by one. */
  at(frame: number): Frame | null {
    const block = Math.floor(frame / this.blockFrames);
    const found = this.blocks.get(block);
    if (found) {
      this.blocks.delete(block);
      this.blocks.set(block, found);
    } else {
      void this.load(block);
    }
    void this.loadAhead(frame);
    return found?.[frame - block * this.blockFrames] ?? null;
  }

  /** Load the missing blocks of the next frames, one at a time. */
  private async loadAhead(frame: number): Promise<void> {
    if (this.loading.size > 0) return;
    const last = Math.floor((frame + Math.max(this.ahead, (2 * this.blockFrames) / 3)) / this.blockFrames);
    const first = Math.floor(frame / this.blockFrames);
    for (let block = first + 1; block <= Math.min(last, first + this.capacity - 2); block++) {
      if (!this.blocks.has(block) && !this.failed.has(block)) return this.load(block);
    }
  }

  /** The frame, as soon as it is loaded; null if it cannot be. */
  async wait(frame: number): Promise<Frame | null> {
    const block = Math.floor(frame / this.blockFrames);
    await this.load(block);
    return this.blocks.get(block)?.[frame - block * this.blockFrames] ?? null;
  }

  /** The error that loading a frame raised; null without one. */
  failure(frame: number): string | null {
    return this.failed.get(Math.floor(frame / this.blockFrames)) ?? null;
  }

  private load(block: number): Promise<void> {
    const start = block * this.blockFrames;
    if (start < 0 || start >= this.count || this.blocks.has(block) || this.failed.has(block)) return Promise.resolve();
    const pending = this.loading.get(block);
    if (pending) return pending;
    const work = this.loader(start, Math.min(this.count, start + this.blockFrames))
      .then((frames) => {
        this.blocks.set(block, frames);
        while (this.blocks.size > this.capacity) this.blocks.delete(this.blocks.keys().next().value!);
      })
      .catch((error: unknown) => {
        this.failed.set(block, error instanceof Error ? error.message : String(error));
      })
      .finally(() => {
        this.loading.delete(block);
        this.onLoad();
      });
    this.loading.set(block, work);
    return work;
  }
}
