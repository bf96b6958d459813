import { Unsupported } from "./errors.js";

export function inflateLzma2(_data: Uint8Array, _limit: number): Uint8Array {
  throw new Unsupported("LZMA2");
}
