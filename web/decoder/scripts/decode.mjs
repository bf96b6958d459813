// Decodes files for comparison with another decoder: node scripts/decode.mjs MODULE PRIORS OUT FILE.mocz …
//
// MODULE is the built decoder, PRIORS the folder of points.npz and directions.npz. For each file, OUT gets NAME.json (the
// file's header, events and signals, or the name and text of the error), NAME.positions, NAME.rotations, NAME.signal-N and
// NAME.poses-N (float64, little-endian). For point clouds, NAME.positions and NAME.colours (bytes) hold frame after frame.

import { readFileSync, writeFileSync } from "node:fs";
import { basename } from "node:path";
import { pathToFileURL } from "node:url";

const [module, priorsFolder, out, ...paths] = process.argv.slice(2);
const { MocodecError, open } = await import(pathToFileURL(module).href);
const names = { b881876c: "points.npz", "1be90053": "directions.npz" };
const priors = async (id) => new Uint8Array(readFileSync(`${priorsFolder}/${names[id]}`));

for (const path of paths) {
  const target = `${out}/${basename(path, ".mocz")}`;
  const said = await decode(path, target).catch((error) => {
    if (!(error instanceof MocodecError)) throw error;
    return { error: error.name, message: error.message };
  });
  writeFileSync(`${target}.json`, JSON.stringify(said, (_, value) => (typeof value === "bigint" ? value.toString() : value)));
}

async function decode(path, target) {
  const file = await open(new Uint8Array(readFileSync(path)), { priors });
  if (file.info.kind === "clouds") {
    const { bodies, poses } = await file.poses();
    for (const [i, values] of poses.entries()) writeFileSync(`${target}.poses-${i}`, values);
    return { info: file.info, bodies, points: await decodeClouds(file, target).catch((error) => error.name) };
  }
  writeFileSync(`${target}.positions`, await file.frames());
  if (file.info.rotations) writeFileSync(`${target}.rotations`, await file.rotations());
  const { events, signals } = await file.extras();
  for (const [i, signal] of signals.entries()) writeFileSync(`${target}.signal-${i}`, await signal.read());
  return { info: file.info, events, signals, marks: await file.marks() };
}

/** Writes the points of all frames; returns the numbers of points. */
async function decodeClouds(file, target) {
  const clouds = [];
  for await (const cloud of file.clouds()) clouds.push(cloud);
  writeFileSync(`${target}.positions`, Buffer.concat(clouds.map(({ positions }) => new Uint8Array(positions.buffer))));
  writeFileSync(`${target}.colours`, Buffer.concat(clouds.map(({ colours }) => colours ?? new Uint8Array(0))));
  return clouds.map(({ positions }) => positions.length / 3);
}
