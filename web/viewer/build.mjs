// Builds the page into one file: index.html with its style and script inside.
import { readFileSync, writeFileSync, mkdirSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build, transform } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "../../src/mocodec/viewer/static/viewer.html");

const script = await build({
  entryPoints: [join(here, "src/main.ts")],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  legalComments: "eof",
  define: { "import.meta.url": "document.baseURI" },
  external: ["node:fs/promises"],
  write: false,
});
const style = await transform(readFileSync(join(here, "src/style.css"), "utf8"), { loader: "css", minify: true });
const code = script.outputFiles[0].text.replaceAll("</script", "<\\/script");
const page = readFileSync(join(here, "index.html"), "utf8")
  .replace("/*STYLE*/", () => style.code.trim())
  .replace("/*SCRIPT*/", () => code.trim());
mkdirSync(dirname(out), { recursive: true });
writeFileSync(out, page);
console.log(`${relative(process.cwd(), out)}: ${page.length} bytes, ${gzipSync(page, { level: 9 }).length} compressed`);
