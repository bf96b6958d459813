/** Numbers, tabs, signals and notes: text beside the picture. Names are set as text, never as HTML. */

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
  const { errors } = facts;
  target.replaceChildren();
  // without the size of the original file, the ratio of signals is unknown
  const ofFile = facts.signals.length > 0;
  const large = ofFile ? facts.bytes && facts.originalBytes && facts.originalBytes / facts.bytes : facts.ratio;
  if (large) {
    const big = element("div", ratio(large), "big");
    big.append(element("small", ofFile ? " to the whole file" : " to float32"));
    target.append(big);
  }
  const add = (name: string, value: string, className = "") => target.append(element("dt", name, className), element("dd", value, className));
  if (facts.bytes !== null) add("size", bytes(facts.bytes), "minor");
  if (facts.originalBytes !== null) add("original", bytes(facts.originalBytes), "minor");
  if (facts.codec !== null) add("codec", facts.codec, "minor");
  if (facts.codec !== null) add("promise", promise(facts.promise));
  if (errors) {
    const bound = facts.promise.max_error;
    add("mean error", length(errors.mean));
    add("99 % below", length(errors.p99), "minor");
    add("largest", length(errors.max), bound !== undefined && errors.max > bound * 1.0001 ? "broken" : "");
  }
  const about = `${time(facts.frames / facts.rate)} · ${whole(facts.frames)} frames · ${facts.points ? `${whole(facts.points)} points · ` : ""}${Number(facts.rate.toPrecision(6))} Hz`;
  if (facts.kind === "clouds" || (!errors && !facts.original)) { // clouds have no error of each point
    target.append(element("p", about));
    return null;
  }
  const mean = element("dd", "–");
  const max = element("dd", "–");
  target.append(element("dt", "this frame, mean"), mean, element("dt", "this frame, largest"), max, element("p", about));
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

/** The scale of colours, and the meaning of the grey figure. */
export function showLegend(target: HTMLElement, scale: number | null, hasOriginal: boolean): void {
  target.replaceChildren();
  if (scale === null) return;
  target.append(element("span", "error 0"), document.createElement("i"), element("span", length(scale, true)));
  if (hasOriginal) target.append(document.createElement("b"), element("span", "original"));
}

/** The button that goes to the largest error shows its size, point and time. */
export function showWorst(button: HTMLElement, facts: Facts): void {
  const { errors } = facts;
  button.hidden = !errors?.maxAt;
  if (!errors?.maxAt) return;
  const [frame, point] = errors.maxAt;
  const name = facts.names[point];
  const where = name ? element("span", `, ${name}`, "name") : "";
  button.replaceChildren(element("span", "Largest error ", "word"), element("b", length(errors.max)), where, ` at ${time(frame / facts.rate)}`);
}
