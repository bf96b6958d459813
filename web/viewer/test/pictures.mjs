// Screenshots of a page at its largest error: node pictures.mjs PAGE.html FOLDER.
import { spawnSync } from "node:child_process";
import { mkdtempSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const [page, folder] = process.argv.slice(2).map((path) => resolve(path));
const picture = (name, size, theme) => [
  { do: "open", url: pathToFileURL(page).href, size, theme },
  { do: "wait", for: "mocodecViewer.state().shownFrame >= 0" },
  { do: "press", key: "w" },
  { do: "eval", code: "new Promise((done) => setTimeout(done, 1000))" },
  { do: "wait", for: "mocodecViewer.state().shownFrame === mocodecViewer.state().frame" },
  { do: "eval", code: "new Promise((done) => setTimeout(done, 1000))" },
  { do: "picture", path: join(folder, name) },
];
const commands = join(mkdtempSync(join(tmpdir(), "mocodec-")), "commands.json");
writeFileSync(commands, JSON.stringify([...picture("desktop.png", [1280, 800], "light"), ...picture("phone.png", [390, 844], "dark")]));
const driver = join(dirname(fileURLToPath(import.meta.url)), "browser.mjs");
const made = spawnSync("node", [driver, commands], { encoding: "utf8" });
const { failed, problems } = JSON.parse(made.stdout);
if (failed || problems.length) {
  console.error(failed ?? problems);
  process.exit(1);
}
