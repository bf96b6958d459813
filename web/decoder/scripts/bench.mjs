// Speed of decoding: node scripts/bench.mjs FILE.mocz … (after npm run build). Prints frames a second of processor time,
// best of several runs that open and decode the whole file, and the time to open it and decode one frame in the middle.

import { readFileSync } from "node:fs";
import { open } from "../dist/mocodec.js";

const RUNS = 7;

/** Milliseconds of processor time; the garbage collector's threads count too. */
async function processorMs(work) {
  const before = process.cpuUsage();
  await work();
  const { user, system } = process.cpuUsage(before);
  return (user + system) / 1000;
}

for (const path of process.argv.slice(2)) {
  const bytes = new Uint8Array(readFileSync(path));
  const { info } = await open(bytes);
  const middle = Math.floor(info.frames / 2);
  let best = Infinity;
  let seek = Infinity;
  for (let run = 0; run < RUNS; run++) {
    best = Math.min(best, await processorMs(async () => (await open(bytes)).frames()));
    seek = Math.min(seek, await processorMs(async () => (await open(bytes)).frames(middle, middle + 1)));
  }
  const speed = Math.round((info.frames / best) * 1000);
  console.log(`${path}: ${info.codec}, ${info.names.length} points, ${info.frames} frames, ${speed} frames/s, one frame ${seek.toFixed(1)} ms`);
}
