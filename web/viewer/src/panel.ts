/** Numbers, list of points, tabs, signals and notes: text beside the picture. Names are only ever set as text. */

import type { Facts } from "./session.ts";
import { bytes, length, promise, ratio, time, whole } from "./text.ts";

function element<K extends keyof HTMLElementTagNameMap>(tag: K, text: string, className = ""): HTMLElementTagNameMap[K] {
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

/** The list of points, in order of their largest error. */
export class PointList {
  private rows: HTMLElement[] = [];
  private now: HTMLElement[] = [];
  private order: number[] = [];
  selected = -1;

  constructor(
    private readonly list: HTMLElement,
    private readonly filter: HTMLInputElement,
    private readonly onSelect: (point: number) => void,
  ) {
    filter.addEventListener("input", () => this.applyFilter());
    list.addEventListener("keydown", (event) => {
      const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const visible = this.order.filter((point) => !this.rows[point].hidden);
      const at = visible.indexOf(this.selected);
      const next = visible[Math.max(0, Math.min(visible.length - 1, at + step))];
      if (next !== undefined) this.select(next);
    });
  }

  show(facts: Facts): void {
    const largest = facts.errors?.pointMax ?? [];
    this.order = facts.names.map((_, point) => point);
    if (largest.length) this.order.sort((a, b) => largest[b] - largest[a]);
    this.rows = [];
    this.now = [];
    for (const point of this.order) {
      const row = document.createElement("div");
      row.setAttribute("role", "option");
      row.setAttribute("aria-selected", "false");
      row.id = `point-${point}`;
      const name = element("span", facts.names[point]);
      name.title = facts.names[point];
      const now = element("span", "", "now");
      row.append(name, now, element("span", largest.length ? length(largest[point]) : "", "most"));
      row.addEventListener("click", () => this.select(point === this.selected ? -1 : point));
      this.rows[point] = row;
      this.now[point] = now;
    }
    this.list.replaceChildren(...this.order.map((point) => this.rows[point]));
    this.selected = -1;
    this.applyFilter();
  }

  /** Errors of the shown frame. */
  update(errors: Float32Array): void {
    this.now.forEach((cell, point) => {
      cell.textContent = Number.isNaN(errors[point]) ? "" : length(errors[point]);
    });
  }

  select(point: number): void {
    this.rows[this.selected]?.setAttribute("aria-selected", "false");
    this.selected = point;
    const row = this.rows[point];
    row?.setAttribute("aria-selected", "true");
    row?.scrollIntoView({ block: "nearest" });
    if (row) this.list.setAttribute("aria-activedescendant", row.id);
    else this.list.removeAttribute("aria-activedescendant");
    this.onSelect(point);
  }

  private applyFilter(): void {
    const wanted = this.filter.value.trim().toLowerCase();
    for (const row of this.rows) row.hidden = !(row.firstElementChild?.textContent ?? "").toLowerCase().includes(wanted);
  }
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

/** The table of keys in the help. */
export function showKeys(table: HTMLTableElement, keys: readonly (readonly [string, string])[]): void {
  table.replaceChildren(
    ...keys.map(([key, meaning]) => {
      const row = document.createElement("tr");
      const left = document.createElement("td");
      for (const one of key.split(" ")) left.append(element("kbd", one), " ");
      row.append(left, element("td", meaning));
      return row;
    }),
  );
}
