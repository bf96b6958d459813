// Builds the package: dist/mocodec.js, an ES module that loads the modules of rarer codecs when a file needs them;
// dist/mocodec.single.js, all modules in one file; types; and priors/, copied from the Python package.
// Prints the sizes that a page loads. With a path, it writes only the single file there.

import { execFileSync } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, rmSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const root = fileURLToPath(new URL("..", import.meta.url)).replace(/\/$/, "");
process.chdir(root);
const priors = fileURLToPath(new URL("../../../src/mocodec/priors/", import.meta.url));

const common = { bundle: true, format: "esm", target: "es2022", minify: true, external: ["node:*"] };
const single = (outfile) => build({ ...common, entryPoints: [`${root}/src/index.ts`], outfile });
if (process.argv[2]) {
  await single(process.argv[2]);
  process.exit();
}
rmSync(`${root}/dist`, { recursive: true, force: true });
const { metafile } = await build({
  ...common,
  entryPoints: { mocodec: `${root}/src/index.ts` },
  outdir: `${root}/dist`,
  splitting: true,
  chunkNames: "part-[name]-[hash]",
  metafile: true,
});
await single(`${root}/dist/mocodec.single.js`);
execFileSync(process.execPath, [`${root}/node_modules/typescript/bin/tsc`, "-p", `${root}/tsconfig.types.json`], { stdio: "inherit" });
mkdirSync(`${root}/priors`, { recursive: true });
for (const name of ["points.npz", "directions.npz"]) copyFileSync(`${priors}/${name}`, `${root}/priors/${name}`);

const gzipped = (path) => gzipSync(readFileSync(path), { level: 9 }).length;

/** A script and its static imports, direct and indirect. */
function closure(path, found = new Set()) {
  if (found.has(path)) return found;
  found.add(path);
  for (const { path: next, kind } of metafile.outputs[path].imports) if (kind === "import-statement" && next in metafile.outputs) closure(next, found);
  return found;
}

const outputs = Object.entries(metafile.outputs);
const entry = outputs.find(([, output]) => output.entryPoint === "src/index.ts")[0];
const core = closure(entry);
const total = (paths) => [...paths].reduce((sum, path) => sum + gzipped(path), 0);
console.log(`open(): ${total(core)} bytes gzipped`);
for (const [path, { entryPoint }] of outputs) {
  if (!entryPoint || path === entry) continue;
  const more = [...closure(path)].filter((part) => !core.has(part));
  console.log(`  ${entryPoint.replace("src/", "")}: ${total(more)} more`);
}
for (const name of ["dist/mocodec.single.js", "priors/points.npz", "priors/directions.npz"]) console.log(`${name}: ${gzipped(`${root}/${name}`)} gzipped`);
