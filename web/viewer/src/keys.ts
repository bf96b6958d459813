/** Keys of the page: their actions, and their table in the help. */

import { element } from "./panel.ts";

const KEYS = [
  ["space", "play, pause"],
  ["← →", "one frame; with shift one second"],
  ["home end", "first and last frame"],
  ["W", "frame and point of the largest error"],
  ["[ ]", "slower, faster"],
  ["L", "play in a loop"],
  ["F", "the camera follows"],
  ["R", "whole figure"],
  ["T", "trail of the chosen point"],
  ["G", "original over, beside, hidden"],
  ["P", "list of points; display of point clouds"],
  ["D", "dark or light"],
  ["O", "open files"],
  ["?", "these keys"],
] as const;

/** Call the action of a pressed key, by its name or lower-case letter, unless a field or a button takes the key. */
export function listenKeys(actions: Record<string, (isShifted: boolean) => void>): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || target.matches("input[type=search], input[type=text], select")) return;
    const act = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || (event.key === " " && target.matches("button, summary"))) return;
    event.preventDefault();
    act(event.shiftKey);
  });
}

/** The table of keys in the help. */
export function showKeys(table: HTMLElement): void {
  table.replaceChildren(
    ...KEYS.map(([key, meaning]) => {
      const row = document.createElement("tr");
      const left = document.createElement("td");
      for (const one of key.split(" ")) left.append(element("kbd", one), " ");
      row.append(left, element("td", meaning));
      return row;
    }),
  );
}
