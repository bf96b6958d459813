/** Pictures of 200 × 136 samples from `mocodec.codecs.bodycast.video.encode`, and checksums of the planes that FFmpeg decodes. */

import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { crc32 } from "../src/bytes.js";
import { MocodecError } from "../src/errors.js";
import { VideoDecoder } from "../src/video/video.js";

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

/** Name of a video (content, rate factor) and CRC-32 of Y, Cb, Cr of each picture. Four bytes before a packet are its size. */
const VIDEOS: [string, number[]][] = [
  ["moving-34", [1011835157, 413971393, 1222126634, 1872208982, 3571568836, 2344560323, 311872321, 1356851060]],
  ["fading-34", [720915075, 2793717585, 3229485010, 3661202248, 3185493852, 2511361010]],
  ["noisy-34", [929806864, 929806864, 2638077633, 991391773]],
];

function packets(name: string): Uint8Array[] {
  const data = new Uint8Array(readFileSync(new URL(`pictures/${name}.video`, import.meta.url)));
  const found: Uint8Array[] = [];
  for (let at = 0; at < data.length; ) {
    const size = new DataView(data.buffer).getUint32(at);
    found.push(data.subarray(at + 4, at + 4 + size));
    at += 4 + size;
  }
  return found;
}

describe("videos", () => {
  test.each(VIDEOS)("%s", (name, checksums) => {
    const video = new VideoDecoder();
    expect(packets(name).map((packet) => crc32(...video.decode(packet).planes))).toEqual(checksums);
  });

  test("damaged packets end in a named error or in pictures", () => {
    const [key, ...others] = packets(VIDEOS[0]![0]);
    for (let i = 0; i < 60; i++) {
      const video = new VideoDecoder();
      video.decode(key!);
      const damaged = others[i % others.length]!.slice();
      damaged[(i * 37) % damaged.length]! ^= 1 << (i % 8);
      try {
        video.decode(damaged);
        video.decode(others.at(-1)!);
      } catch (error) {
        expect(error).toBeInstanceOf(MocodecError);
      }
    }
  }, 60_000);
});

describe("pictures", () => {
  test.each(PICTURES)("%s", (name, checksum) => {
    const { width, height, planes } = new VideoDecoder().decode(packet(name));
    expect([width, height]).toEqual([200, 136]);
    expect(crc32(...planes)).toBe(checksum);
  });

  test("damaged ones end in a named error or a picture", () => {
    const bytes = packet("mixed-40");
    for (let i = 0; i < bytes.length; i += 11) {
      const damaged = bytes.slice();
      damaged[i]! ^= 1 << (i % 8);
      try {
        new VideoDecoder().decode(i % 2 ? damaged : damaged.subarray(0, i));
      } catch (error) {
        expect(error).toBeInstanceOf(MocodecError);
      }
    }
  }, 60_000);
});
