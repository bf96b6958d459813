/** Opens a .mocz with the decoder in web/decoder. */

import { fromBase64 } from "./packed.ts";
import type { Media } from "./session.ts";

export interface MoczFile {
  positions(a: number, b: number): Promise<Float32Array>;
}

export async function openMocz(media: Extract<Media, { type: "mocz" }>): Promise<MoczFile> {
  void (media.base64 && fromBase64(media.base64));
  throw new Error("not yet");
}
