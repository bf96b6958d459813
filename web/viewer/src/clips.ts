/** The recordings of an archive: a list with small drawings, a search by name, a condition on the catalogue. */

import { load, type Session } from "./session.ts";
import { bytes, ratio, readable, time, whole } from "./text.ts";

interface Clip {
  name: string;
  frames: number;
  seconds: number;
  points: number;
  ratio: number | null;
}

interface Found {
  total: number;
  seconds: number;
  bytes: number;
  clips: Clip[];
}

interface Pose {
  points: ([number, number] | null)[];
  links: [number, number][];
}

const WAIT_MS = 200;
const DRAWING = 44;

export class Clips {
  private timer = 0;
  private readonly drawn = new WeakSet<Element>();
  private readonly watch = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) void this.draw(entry.target as HTMLElement);
  });

  constructor(
    private readonly place: string,
    private readonly box: HTMLElement,
    private readonly open: (session: Session) => Promise<void>,
    private readonly notice: (text: string | null) => void,
  ) {
    for (const input of box.querySelectorAll("input")) {
      input.addEventListener("input", () => {
        clearTimeout(this.timer);
        this.timer = window.setTimeout(() => void this.search(), WAIT_MS);
      });
    }
  }

  /** Ask the server for the recordings that match, and list them. */
  async search(): Promise<Clip[]> {
    const [text, query] = [...this.box.querySelectorAll("input")].map((input) => encodeURIComponent(input.value));
    const response = await fetch(`${this.place}?text=${text}&query=${query}`);
    const summary = this.box.querySelector("p")!;
    if (!response.ok) {
      summary.textContent = await response.text();
      return [];
    }
    const found = (await response.json()) as Found;
    const more = found.total > found.clips.length ? `, the first ${whole(found.clips.length)} listed` : "";
    summary.textContent = `${whole(found.total)} recordings${more}, ${time(found.seconds)}, ${bytes(found.bytes)}`;
    this.box.querySelector("div")!.replaceChildren(...found.clips.map((clip) => this.row(clip)));
    return found.clips;
  }

  async choose(name: string): Promise<void> {
    for (const row of this.box.querySelectorAll<HTMLElement>("[role=option]")) {
      row.setAttribute("aria-selected", String(row.dataset.name === name));
    }
    try {
      this.notice("loading…");
      const session = await load(`clip/${encodeURIComponent(name)}/session.json`);
      if (session) await this.open(session);
    } catch (error) {
      this.notice(error instanceof Error ? error.message : String(error));
    }
  }

  private row(clip: Clip): HTMLElement {
    const row = document.createElement("div");
    row.setAttribute("role", "option");
    row.setAttribute("aria-selected", "false");
    row.tabIndex = 0;
    row.dataset.name = clip.name;
    const picture = document.createElement("canvas");
    picture.width = picture.height = 2 * DRAWING;
    const name = document.createElement("b");
    name.textContent = readable(clip.name);
    const facts = document.createElement("small");
    facts.textContent = [time(clip.seconds), clip.points ? `${whole(clip.points)} points` : "points", clip.ratio ? ratio(clip.ratio) : ""].filter(Boolean).join(" · ");
    row.append(picture, name, facts);
    row.addEventListener("click", () => void this.choose(clip.name));
    row.addEventListener("keydown", (event) => {
      if (event.key === "Enter") void this.choose(clip.name);
      const next = event.key === "ArrowDown" ? row.nextElementSibling : event.key === "ArrowUp" ? row.previousElementSibling : null;
      if (!next) return;
      event.preventDefault();
      event.stopPropagation();
      (next as HTMLElement).focus();
    });
    this.watch.observe(row);
    return row;
  }

  /** Draw the pose of a row that becomes visible. */
  private async draw(row: HTMLElement): Promise<void> {
    if (this.drawn.has(row)) return;
    this.drawn.add(row);
    this.watch.unobserve(row);
    const response = await fetch(`clip/${encodeURIComponent(row.dataset.name!)}/pose.json`).catch(() => null);
    if (!response?.ok) return;
    const { points, links } = (await response.json()) as Pose;
    const canvas = row.querySelector("canvas")!;
    const pen = canvas.getContext("2d")!;
    const size = canvas.width;
    pen.strokeStyle = pen.fillStyle = getComputedStyle(row).color;
    pen.lineWidth = 3;
    pen.lineCap = "round";
    const at = ([x, y]: [number, number]): [number, number] => [size * (0.06 + 0.88 * x), size * (0.06 + 0.88 * y)];
    for (const [a, b] of links) {
      const [p, q] = [points[a], points[b]];
      if (!p || !q) continue;
      pen.beginPath();
      pen.moveTo(...at(p));
      pen.lineTo(...at(q));
      pen.stroke();
    }
    if (links.length === 0) for (const p of points) if (p) pen.fillRect(at(p)[0] - 2, at(p)[1] - 2, 4, 4);
  }
}
