/** Pictures of 200 × 136 samples that `mocodec.codecs.bodycast.video.encode` wrote, and checksums of the planes that FFmpeg decodes. */

import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { crc32 } from "../src/bytes.js";
import { MocodecError } from "../src/errors.js";
import { decodePicture } from "../src/video/picture.js";

/** Name (kind of picture, rate factor) and CRC-32 of Y, Cb, Cr. */
const PICTURES: [string, number][] = [
  ["smooth-4", 1089278677],
  ["mixed-28", 3921266567],
  ["mixed-40", 1127680319],
  ["flat-28", 2994072308],
];

function packet(name: string): Uint8Array {
  return new Uint8Array(readFileSync(new URL(`pictures/${name}.h265`, import.meta.url)));
}

describe("pictures", () => {
  test.each(PICTURES)("%s", (name, checksum) => {
    const { width, height, planes } = decodePicture(packet(name));
    expect([width, height]).toEqual([200, 136]);
    expect(crc32(...planes)).toBe(checksum);
  });

  test("damaged ones end in a named error or a picture", () => {
    const bytes = packet("mixed-40");
    for (let i = 0; i < bytes.length; i += 11) {
      const damaged = bytes.slice();
      damaged[i]! ^= 1 << (i % 8);
      try {
        decodePicture(i % 2 ? damaged : damaged.subarray(0, i));
      } catch (error) {
        expect(error).toBeInstanceOf(MocodecError);
      }
    }
  }, 60_000);
});
