/** Buttons, keys, clicks in the picture and dropped files: each calls a command of the page. */

import { listenKeys } from "./keys.ts";
import type { Facts } from "./session.ts";
import type { OriginalPlace } from "./view.ts";

/** A press that moves at most this far, pixels, chooses a point; otherwise it turns the picture. */
const CLICK_PX = 4;

/** The commands of the page. */
export interface Commands {
  /** Without an argument: pause if it plays, otherwise play. */
  play(on?: boolean): void;
  /** Show a frame; before the first or after the last, the nearest. */
  seek(frame: number): void;
  step(count: number, unit: "frames" | "seconds"): void;
  /** Go to the frame and point of the largest error. */
  worst(): void;
  /** Put the camera where it sees the whole figure. */
  reset(): void;
  /** Press or release a toggle button. */
  toggle(id: "loop" | "follow" | "trails"): void;
  togglePanel(): void;
  switchTheme(): void;
  setPlace(place: OriginalPlace): void;
  nextPlace(): void;
  setUnit(unit: string): void;
  setUp(up: Facts["up"]): void;
  /** Select the point at this place of the picture, pixels. */
  pick(x: number, y: number): void;
  openFiles(files: FileList | null): Promise<void>;
}

const $ = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;

/** Connect the controls of the page with its commands. */
export function listen(page: Commands): void {
  const chooseFiles = () => $("files").click();
  const showHelp = () => $<HTMLDialogElement>("help").showModal();
  const buttons: Record<string, () => void> = {
    play: () => page.play(),
    back: () => page.step(-1, "frames"),
    next: () => page.step(1, "frames"),
    worst: () => page.worst(),
    loop: () => page.toggle("loop"),
    follow: () => page.toggle("follow"),
    trails: () => page.toggle("trails"),
    reset: () => page.reset(),
    "points-button": () => page.togglePanel(),
    "help-button": showHelp,
    open: chooseFiles,
    theme: () => page.switchTheme(),
  };
  for (const [id, act] of Object.entries(buttons)) $(id).addEventListener("click", act);
  listenKeys({
    " ": () => page.play(),
    ArrowLeft: (isShifted) => page.step(-1, isShifted ? "seconds" : "frames"),
    ArrowRight: (isShifted) => page.step(1, isShifted ? "seconds" : "frames"),
    Home: () => page.seek(0),
    End: () => page.seek(Infinity),
    w: () => page.worst(),
    "[": () => changeSpeed(-1),
    "]": () => changeSpeed(1),
    l: () => page.toggle("loop"),
    f: () => page.toggle("follow"),
    t: () => page.toggle("trails"),
    r: () => page.reset(),
    g: () => page.nextPlace(),
    p: () => page.togglePanel(),
    d: () => page.switchTheme(),
    o: chooseFiles,
    "?": showHelp,
  });
  const onChoice = (id: string, act: (value: string) => void) => $(id).addEventListener("change", () => act($<HTMLSelectElement>(id).value));
  onChoice("original", (value) => page.setPlace(value as OriginalPlace));
  onChoice("unit", (value) => page.setUnit(value));
  onChoice("up", (value) => page.setUp(value as Facts["up"]));
  listenFiles(page);
  listenClicks(page);
}

function changeSpeed(change: number): void {
  const select = $<HTMLSelectElement>("speed");
  select.selectedIndex = Math.max(0, Math.min(select.options.length - 1, select.selectedIndex + change));
}

function listenFiles(page: Commands): void {
  $("files").addEventListener("change", () => void page.openFiles($<HTMLInputElement>("files").files));
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    void page.openFiles(event.dataTransfer?.files ?? null);
  });
}

function listenClicks(page: Commands): void {
  const picture = $("picture");
  let down: [number, number] | null = null;
  picture.addEventListener("pointerdown", (event) => (down = [event.clientX, event.clientY]));
  picture.addEventListener("pointerup", (event) => {
    if (!down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > CLICK_PX) return;
    const box = picture.getBoundingClientRect();
    page.pick(event.clientX - box.left, event.clientY - box.top);
  });
}
