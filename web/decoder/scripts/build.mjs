// Builds the package: dist/mocodec.js, an ES module that loads the modules of rarer codecs when a file needs them;
// dist/mocodec.single.js, the same in one file; types; and priors/, copied from the Python package.
// Prints the sizes that a page pays for.

import { execFileSync } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const root = fileURLToPath(new URL("..", import.meta.url));
const priors = fileURLToPath(new URL("../../../src/mocodec/priors/", import.meta.url));

rmSync(`${root}/dist`, { recursive: true, force: true });
const common = { bundle: true, format: "esm", target: "es2022", minify: true, external: ["node:*"] };
await build({ ...common, entryPoints: { mocodec: `${root}/src/index.ts` }, outdir: `${root}/dist`, splitting: true, chunkNames: "part-[name]-[hash]" });
await build({ ...common, entryPoints: [`${root}/src/index.ts`], outfile: `${root}/dist/mocodec.single.js` });
execFileSync(process.execPath, [`${root}/node_modules/typescript/bin/tsc`, "-p", `${root}/tsconfig.types.json`], { stdio: "inherit" });
mkdirSync(`${root}/priors`, { recursive: true });
for (const name of ["points.npz", "directions.npz"]) copyFileSync(`${priors}/${name}`, `${root}/priors/${name}`);

const scripts = readdirSync(`${root}/dist`).filter((name) => name.endsWith(".js"));
for (const name of [...scripts.map((name) => `dist/${name}`), "priors/points.npz", "priors/directions.npz"]) {
  const bytes = readFileSync(`${root}/${name}`);
  console.log(`${name}: ${bytes.length} bytes, ${gzipSync(bytes, { level: 9 }).length} gzipped`);
}
