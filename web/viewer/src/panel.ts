/** Numbers, tabs, signals and notes: text beside the picture. Names are only ever set as text. */

import type { Facts } from "./session.ts";
import { bytes, length, promise, ratio, time, whole } from "./text.ts";

export function element<K extends keyof HTMLElementTagNameMap>(tag: K, text: string, className = ""): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** The numbers of a recording. */
export function showNumbers(target: HTMLElement, facts: Facts): { mean: HTMLElement; max: HTMLElement } | null {
  const rows: [string, string, boolean?][] = [];
  if (facts.bytes !== null) rows.push(["size", bytes(facts.bytes)]);
  if (facts.codec !== null) rows.push(["codec", facts.codec]);
  if (facts.codec !== null) rows.push(["promise", promise(facts.promise)]);
  if (facts.originalBytes !== null) rows.splice(1, 0, ["original", bytes(facts.originalBytes)]);
  const errors = facts.errors;
  if (errors) {
    const bound = facts.promise.max_error;
    rows.push(["mean error", length(errors.mean)]);
    rows.push(["99 % below", length(errors.p99)]);
    rows.push(["largest", length(errors.max), bound !== undefined && errors.max > bound * 1.0001]);
  }
  rows.push(["", `${time(facts.frames / facts.rate)} · ${whole(facts.frames)} frames · ${facts.points ? `${whole(facts.points)} points · ` : ""}${Number(facts.rate.toPrecision(6))} Hz`]);
  target.replaceChildren();
  const ofFile = facts.signals.length && facts.bytes && facts.originalBytes ? facts.originalBytes / facts.bytes : null;
  if (facts.ratio !== null) {
    const big = element("div", ratio(ofFile ?? facts.ratio), "big");
    big.append(element("small", ofFile ? " to the whole file" : " to float32"));
    target.append(big);
  }
  for (const [name, value, broken] of rows) target.append(element("dt", name), element("dd", value, broken ? "broken" : ""));
  if (!errors && !facts.original) return null;
  const mean = element("dd", "–");
  const max = element("dd", "–");
  target.append(element("dt", "here, mean"), mean, element("dt", "here, largest"), max);
  return { mean, max };
}

/** One tab a recording. */
export function showTabs(target: HTMLElement, names: string[], active: number, choose: (number: number) => void): void {
  target.replaceChildren(
    ...names.map((name, number) => {
      const tab = element("button", name);
      tab.type = "button";
      tab.setAttribute("role", "tab");
      tab.setAttribute("aria-selected", String(number === active));
      tab.addEventListener("click", () => choose(number));
      return tab;
    }),
  );
  target.hidden = names.length < 2;
}

/** A box for each channel, to draw it on the timeline. */
export function showSignals(box: HTMLElement, list: HTMLElement, facts: Facts, chosen: Set<number>, change: () => void): void {
  box.hidden = facts.signals.length === 0;
  list.replaceChildren(
    ...facts.signals.map((signal, number) => {
      const label = document.createElement("label");
      const tick = document.createElement("input");
      tick.type = "checkbox";
      tick.checked = chosen.has(number);
      tick.addEventListener("change", () => {
        if (tick.checked) chosen.add(number);
        else chosen.delete(number);
        change();
      });
      label.append(tick, ` ${signal.label}${signal.unit ? ` (${signal.unit})` : ""}`);
      return label;
    }),
  );
}

/** The scale of colours, and what the grey figure is. */
export function showLegend(target: HTMLElement, scale: number | null, hasOriginal: boolean): void {
  target.replaceChildren();
  if (scale === null) return;
  target.append(element("span", "error 0"), document.createElement("i"), element("span", length(scale, true)));
  if (hasOriginal) target.append(document.createElement("b"), element("span", "original"));
}

/** The button that goes to the largest error: it says where and how large that is. */
export function showWorst(button: HTMLElement, facts: Facts): void {
  const { errors } = facts;
  button.hidden = !errors?.maxAt;
  if (!errors?.maxAt) return;
  const [frame, point] = errors.maxAt;
  const name = facts.names[point];
  const where = name ? element("span", `, ${name}`, "name") : "";
  button.replaceChildren(element("span", "Largest error ", "word"), element("b", length(errors.max)), where, ` at ${time(frame / facts.rate)}`);
}
