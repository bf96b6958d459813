/** Frames within a page: base64 of a zlib stream of 16-bit numbers, first all low bytes, then all high bytes.
 *
 * Positions: number = round((coordinate − origin) / step), stored as the difference to the frame before, modulo 2^16.
 * Relative positions: number = 32767 + round((coordinate − decoded coordinate) / step), stored without differences.
 * 65535 in all three coordinates is a gap.
 */

import type { Media } from "./session.ts";

const GAP = 65535;
const MIDDLE = 32767;

/** The bytes of a base64 text. */
export function fromBase64(text: string): Uint8Array {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** The bytes of a zlib stream. */
export async function inflate(bytes: Uint8Array): Promise<Uint8Array> {
  const stream = new Blob([bytes as BlobPart]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The 16-bit numbers of packed media. Each is stored as the difference to the number `width` before it, unless width is 0. */
export async function unpackNumbers(base64: string, width: number): Promise<Uint16Array> {
  const bytes = await inflate(fromBase64(base64));
  const count = bytes.length >> 1;
  const values = new Uint16Array(count);
  for (let i = 0; i < count; i++) {
    const number = bytes[i] | (bytes[count + i] << 8);
    values[i] = width && i >= width ? number + values[i - width] : number;
  }
  return values;
}

/** Positions (frames · points · 3) in metres of packed motion. decoded: the positions that `relative` media refer to. */
export async function unpackMotion(
  media: Extract<Media, { type: "packed" }>,
  points: number,
  decoded: Float32Array | null,
): Promise<Float32Array> {
  if (media.relative && decoded === null) throw new Error("these frames are relative to decoded frames, which are missing");
  const numbers = await unpackNumbers(media.base64, media.relative ? 0 : points * 3);
  const positions = new Float32Array(numbers.length);
  for (let i = 0; i < numbers.length; i += 3) {
    const isGap = numbers[i] === GAP && numbers[i + 1] === GAP && numbers[i + 2] === GAP;
    for (let axis = 0; axis < 3; axis++) {
      const value = media.relative
        ? decoded![i + axis] + media.step * (numbers[i + axis] - MIDDLE)
        : media.origin[axis] + media.step * numbers[i + axis];
      positions[i + axis] = isGap ? NaN : value;
    }
  }
  return positions;
}

/** Frames of packed point clouds: positions in metres and colours 0 to 255. */
export async function unpackClouds(media: Extract<Media, { type: "packed-clouds" }>): Promise<Cloud[]> {
  const bytes = await inflate(fromBase64(media.base64));
  const total = media.counts.reduce((a, b) => a + b, 0);
  const clouds: Cloud[] = [];
  let at = 0;
  for (const count of media.counts) {
    const positions = new Float32Array(count * 3);
    const colours = new Uint8Array(count * 3);
    for (let i = 0; i < count * 3; i++) {
      const number = bytes[at * 3 + i] | (bytes[(total + at) * 3 + i] << 8);
      positions[i] = media.origin[i % 3] + media.step * number;
      colours[i] = bytes[(2 * total + at) * 3 + i];
    }
    clouds.push({ positions, colours });
    at += count;
  }
  return clouds;
}

export interface Cloud {
  positions: Float32Array;
  colours: Uint8Array;
}
