// Drives a page in Debian's Chromium: node browser.mjs COMMANDS.json prints one JSON value for each command.
// A command is {"do": "open", "url", "size": [w, h], "theme"} | {"do": "wait", "for"} | {"do": "eval", "code"} |
// {"do": "processor"} (milliseconds of processor time of the browser so far) | {"do": "press", "key"} | {"do": "click", "selector"} | {"do": "picture", "path"} | {"do": "drop", "files": [path]} |
// {"do": "choose", "selector", "value"}.
import { readFileSync, readdirSync } from "node:fs";
import { chromium } from "playwright-core";

const commands = JSON.parse(readFileSync(process.argv[2], "utf8"));
const server = await chromium.launchServer({
  executablePath: process.env.MOCODEC_CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const browser = await chromium.connect(server.wsEndpoint());

/** Processor time of the browser's processes, milliseconds; Linux only. */
function processorTime() {
  const processes = new Map();
  for (const id of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      const text = readFileSync(`/proc/${id}/stat`, "utf8");
      const fields = text.slice(text.lastIndexOf(")") + 2).split(" ");
      processes.set(Number(id), { parent: Number(fields[1]), ticks: Number(fields[11]) + Number(fields[12]) });
    } catch {
      continue; // the process has ended
    }
  }
  let ticks = 0;
  for (const id of processes.keys()) {
    let above = id;
    while (above && above !== server.process().pid) above = processes.get(above)?.parent ?? 0;
    if (above) ticks += processes.get(id).ticks;
  }
  return 10 * ticks;
}

/** Waits for an expression to be true; the page's policy forbids waitForFunction. */
async function until(page, expression, seconds) {
  for (const end = Date.now() + 1000 * seconds; Date.now() < end; ) {
    if (await page.evaluate(expression)) return;
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  throw new Error(`${expression} was not true within ${seconds} s`);
}

const problems = [];
let page = null;
const answers = [];
try {
  for (const command of commands) {
    let answer = null;
    if (command.do === "open") {
      await page?.context().close();
      const [width, height] = command.size ?? [1280, 800];
      const context = await browser.newContext({ viewport: { width, height }, colorScheme: command.theme ?? "light" });
      page = await context.newPage();
      page.on("console", (message) => message.type() === "error" && problems.push(message.text()));
      page.on("pageerror", (error) => problems.push(String(error)));
      await page.goto(command.url);
    } else if (command.do === "wait") await until(page, command.for, command.seconds ?? 60);
    else if (command.do === "eval") answer = await page.evaluate(command.code);
    else if (command.do === "processor") answer = processorTime();
    else if (command.do === "press") await page.keyboard.press(command.key);
    else if (command.do === "click") await page.click(command.selector);
    else if (command.do === "choose") await page.selectOption(command.selector, command.value);
    else if (command.do === "drop") await page.setInputFiles("#files", command.files);
    else if (command.do === "picture") await page.screenshot({ path: command.path });
    else throw new Error(`unknown command ${command.do}`);
    answers.push(answer);
  }
  console.log(JSON.stringify({ answers, problems }));
} catch (error) {
  console.log(JSON.stringify({ answers, problems, failed: String(error) }));
} finally {
  await browser.close();
  await server.close();
}
