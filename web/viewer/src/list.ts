/** The list of points, the largest error first. Its number of rows is limited: other points are found by name. */

import { element } from "./panel.ts";
import type { Facts } from "./session.ts";
import { length, whole } from "./text.ts";

const MOST_ROWS = 200;

interface Row {
  row: HTMLElement;
  now: HTMLElement;
}

export class PointList {
  private facts: Facts | null = null;
  private order: number[] = [];
  private rows = new Map<number, Row>();
  selected = -1;

  constructor(
    private readonly list: HTMLElement,
    private readonly filter: HTMLInputElement,
    private readonly onSelect: (point: number) => void,
  ) {
    filter.addEventListener("input", () => this.fill());
    list.addEventListener("keydown", (event) => {
      const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const listed = [...this.rows.keys()];
      const next = listed[Math.max(0, Math.min(listed.length - 1, listed.indexOf(this.selected) + step))];
      if (next !== undefined) this.select(next);
    });
  }

  show(facts: Facts): void {
    const largest = facts.errors?.pointMax ?? [];
    this.facts = facts;
    this.order = facts.names.map((_, point) => point);
    if (largest.length) this.order.sort((a, b) => largest[b] - largest[a]);
    this.selected = -1;
    this.fill();
  }

  /** Make rows for the points whose names contain the filter text, and always for the chosen point. */
  fill(): void {
    const { facts } = this;
    if (!facts) return;
    const wanted = this.filter.value.trim().toLowerCase();
    const found = this.order.filter((point) => facts.names[point].toLowerCase().includes(wanted));
    const listed = found.slice(0, MOST_ROWS);
    if (this.selected >= 0 && !listed.includes(this.selected)) listed.unshift(this.selected);
    this.rows = new Map(listed.map((point) => [point, this.row(facts, point)]));
    this.list.replaceChildren(...[...this.rows.values()].map(({ row }) => row));
    const rest = found.length - MOST_ROWS;
    if (rest > 0) this.list.append(element("p", `and ${whole(rest)} more: find them by name`, "quiet"));
  }

  private row(facts: Facts, point: number): Row {
    const row = document.createElement("div");
    row.setAttribute("role", "option");
    row.setAttribute("aria-selected", String(point === this.selected));
    row.id = `point-${point}`;
    const name = element("span", facts.names[point]);
    name.title = facts.names[point];
    const now = element("span", "", "now");
    row.append(name, now, element("span", facts.errors ? length(facts.errors.pointMax[point]) : "", "most"));
    row.addEventListener("click", () => this.select(point === this.selected ? -1 : point));
    return { row, now };
  }

  /** Show the errors of the current frame. */
  update(errors: Float32Array): void {
    for (const [point, { now }] of this.rows) now.textContent = Number.isNaN(errors[point]) ? "" : length(errors[point]);
  }

  select(point: number): void {
    this.rows.get(this.selected)?.row.setAttribute("aria-selected", "false");
    this.selected = point;
    if (point >= 0 && !this.rows.has(point)) this.fill();
    const row = this.rows.get(point)?.row;
    row?.setAttribute("aria-selected", "true");
    row?.scrollIntoView({ block: "nearest" });
    if (row) this.list.setAttribute("aria-activedescendant", row.id);
    else this.list.removeAttribute("aria-activedescendant");
    this.onSelect(point);
  }
}
