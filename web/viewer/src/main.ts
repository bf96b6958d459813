/** The page: loads the session, plays it, and answers buttons, keys, clicks and dropped files. */

import { Arrangement } from "./arrangement.ts";
import { Clips } from "./clips.ts";
import { serve } from "./clouds.ts";
import { type Commands, listen } from "./controls.ts";
import { addressed, dropped } from "./dropped.ts";
import { showKeys } from "./keys.ts";
import { PointList } from "./list.ts";
import { showLegend, showNumbers, showSignals, showTabs, showWorst } from "./panel.ts";
import { Readout } from "./readout.ts";
import { Stage } from "./scene.ts";
import { type Facts, type Session, load, withReadableTexts } from "./session.ts";
import { type Unit, readable, useUnit, whole } from "./text.ts";
import { ErrorScale, PALETTES } from "./theme.ts";
import { Timeline } from "./timeline.ts";
import { type OriginalPlace, RecordingView } from "./view.ts";

const $ = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;

class Page implements Commands {
  private views: RecordingView[] = [];
  private active = 0;
  private seconds = 0;
  private isPlaying = false;
  private lastTick = 0;
  private place: OriginalPlace = "over";
  private keepsNotice = false;
  private theme: "light" | "dark" = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  private scale: ErrorScale | null = null;
  /** Whether the panel is open, for recordings with a list of points and for those without. */
  private readonly isPanelOpen = { points: innerWidth > 720, display: false };
  private readonly strips = new Set<number>();
  private needsFrame = true;
  private readonly stage = new Stage($("picture"), () => (this.needsFrame = true));
  private readonly arrangement = new Arrangement(this.stage);
  private readonly readout = new Readout($("clock"), $("mark"));
  private readonly timeline = new Timeline($("time"), $("tip"), $("head"), $("pointer"), (frame) => this.seek(frame));
  private readonly list = new PointList($("list"), $("filter"), () => (this.needsFrame = true));
  /** Frames drawn late while playing, for tests and `mocodecViewer.late`. */
  late = 0;
  drawn = 0;

  async start(): Promise<void> {
    this.applyTheme();
    listen(this);
    showKeys($("keys"));
    this.showPanel();
    try {
      const query = new URLSearchParams(location.search);
      const measuring = (share: number) => this.notice(`measuring… ${Math.round(100 * share)} %`);
      if (query.has("archive")) {
        await this.openArchive(query.get("archive")!);
        requestAnimationFrame((now) => this.tick(now));
        return;
      }
      const session = query.has("file") ? await addressed(query, measuring) : await load();
      if (session) await this.open(session);
      else $("welcome").hidden = false;
    } catch (error) {
      this.notice(error instanceof Error ? error.message : String(error));
    }
    requestAnimationFrame((now) => this.tick(now));
  }

  /** List the recordings of an archive, and show the first. */
  private async openArchive(place: string): Promise<void> {
    const clips = new Clips(place, $("clips"), (session) => this.open(session), (text) => this.notice(text));
    $("clips").hidden = false;
    const [first] = await clips.search();
    if (first) await clips.choose(first.name);
  }

  async open(session: Session): Promise<void> {
    for (const view of this.views) view.close();
    this.views = [];
    $("welcome").hidden = true;
    this.keepsNotice = false;
    this.notice("loading…");
    const problems: string[] = [];
    for (const facts of session.recordings) {
      try {
        this.views.push(await RecordingView.open(withReadableTexts(facts), this.stage, () => (this.needsFrame = true)));
      } catch (error) {
        problems.push(`${readable(facts.name)}: ${error instanceof Error ? error.message : String(error)}`);
      }
    }
    this.notice(problems.join("\n") || null);
    document.title = `${readable(session.title)} · mocodec`;
    this.seconds = 0;
    if (this.views.length) this.choose(0, true);
  }

  private get view(): RecordingView | undefined {
    return this.views[this.active];
  }

  private get frame(): number {
    return this.view?.frameAt(this.seconds) ?? 0;
  }

  /** Show a recording in timeline, numbers and list. */
  private choose(number: number, first = false): void {
    this.active = number;
    const { facts } = this.views[number];
    $("title").textContent = facts.name;
    $("title").title = facts.name;
    $("title").hidden = this.views.length > 1; // the tabs show the names
    showTabs($("tabs"), this.views.map((view) => view.facts.name), number, (other) => this.choose(other));
    this.readout.here = showNumbers($("numbers"), facts);
    this.list.show(facts);
    this.strips.clear();
    facts.signals.slice(0, 3).forEach((_, signal) => this.strips.add(signal));
    showSignals($("signals"), $("channels"), facts, this.strips, () => this.timeline.show(facts, [...this.strips].sort((a, b) => a - b)));
    this.timeline.show(facts, [...this.strips]);
    $("notes").textContent = facts.notes.join("\n");
    $("notes").hidden = facts.notes.length === 0;
    showWorst($("worst"), facts);
    $<HTMLSelectElement>("up").value = facts.up;
    $("original-label").hidden = !facts.original;
    $("heads").hidden = !facts.original;
    this.showPanel();
    this.rescale();
    if (first) this.arrange();
    this.needsFrame = true;
  }

  /** Put recordings side by side, and the camera in front of them. */
  private arrange(): void {
    this.arrangement.place(this.views);
    this.reset();
  }

  reset(): void {
    const view = this.view;
    if (!view) return;
    view.show(this.frame, this.place, this.list.selected, this.scale, PALETTES[this.theme]);
    this.arrangement.frame(view, this.isBeside);
    this.ground();
    this.needsFrame = true;
  }

  private get isBeside(): boolean {
    return this.place === "beside" && this.view?.original != null;
  }

  private ground(): void {
    if (this.view) this.arrangement.ground(this.view, PALETTES[this.theme]);
  }

  private rescale(): void {
    const facts = this.view?.facts;
    const largest = facts?.promise.max_error ?? facts?.errors?.max ?? 0;
    const shown = facts?.original ? largest || 1e-3 : 0;
    this.scale = shown ? new ErrorScale(PALETTES[this.theme], shown) : null;
    showLegend($("legend"), facts?.kind === "motion" && shown ? shown : null, this.place !== "off");
    this.needsFrame = true;
  }

  seek(frame: number): void {
    const view = this.view;
    if (!view) return;
    this.seconds = Math.max(0, Math.min(view.facts.frames - 1, frame)) / view.facts.rate;
    this.needsFrame = true;
  }

  step(count: number, unit: "frames" | "seconds"): void {
    this.seek(this.frame + count * (unit === "seconds" ? Math.round(this.view?.facts.rate ?? 1) : 1));
  }

  play(on = !this.isPlaying): void {
    const view = this.view;
    if (on && view && this.frame >= view.facts.frames - 1) this.seconds = 0;
    this.isPlaying = on;
    this.needsFrame = true; // draws the text of the frame where it stops
    $("play").dataset.playing = String(on);
    $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  }

  private tick(now: number): void {
    requestAnimationFrame((next) => this.tick(next));
    const passed = Math.min(0.25, (now - this.lastTick) / 1000);
    this.lastTick = now;
    const view = this.view;
    if (!view) return;
    if (this.isPlaying) {
      this.drawn++;
      if (passed > 0.025) this.late += Math.round(passed * 60) - 1;
      this.advance(passed * Number($<HTMLSelectElement>("speed").value));
    }
    this.stage.setMoving(this.isPlaying);
    if (this.needsFrame) this.render();
    this.stage.draw();
  }

  private advance(step: number): void {
    const { frames, rate } = this.view!.facts;
    const before = this.frame;
    if (this.view!.decoded.at(before) === null && this.view!.decoded.failure(before) === null) return;
    this.seconds += step;
    if (this.seconds >= frames / rate) {
      if ($("loop").getAttribute("aria-pressed") === "true") this.seconds = 0;
      else {
        this.seconds = (frames - 1) / rate;
        this.play(false);
      }
    }
    if (this.frame !== before) this.needsFrame = true;
  }

  private render(): void {
    const palette = PALETTES[this.theme];
    const view = this.view!;
    this.needsFrame = false;
    this.views.forEach((one, number) => {
      const selected = number === this.active ? this.list.selected : -1;
      one.show(one.frameAt(this.seconds), this.place, selected, this.scale, palette);
    });
    const frame = this.frame;
    const failure = view.decoded.failure(frame);
    const isDamaged = view.facts.damage.some(([start, stop]) => start <= frame && frame < stop);
    if (failure) this.notice(`Frames around ${whole(frame)} cannot be shown: ${failure}`);
    else if (isDamaged) this.notice("These frames are damaged");
    else if (!this.keepsNotice) this.notice(null);
    if ($("follow").getAttribute("aria-pressed") === "true" && this.views.length === 1) this.arrangement.follow(view, this.isBeside);
    void view.trail($("trails").getAttribute("aria-pressed") === "true" ? this.list.selected : -1, frame, palette.accent);
    this.timeline.setFrame(frame);
    if (this.readout.show(view, frame, this.isPlaying)) this.list.update(view.errors);
    if (!this.isPlaying) this.timeline.announce();
    this.readout.mark(view, this.list.selected, this.stage);
    this.stage.invalidate();
  }

  worst(): void {
    const at = this.view?.facts.errors?.maxAt;
    if (!at) return;
    this.play(false);
    this.seek(at[0]);
    this.list.select(at[1]);
  }

  private notice(text: string | null): void {
    $("notice").textContent = text;
    $("notice").hidden = !text;
  }

  private applyTheme(): void {
    document.documentElement.dataset.theme = this.theme;
    this.stage.setBackground(PALETTES[this.theme].paper);
    this.rescale();
    this.timeline.refresh();
    if (this.view) this.ground();
  }

  /** Open or close the panel: list of points (not for point clouds), signals, display and notes. */
  togglePanel(): void {
    this.isPanelOpen[this.panelKind] = !this.isPanelOpen[this.panelKind];
    this.showPanel();
  }

  private get panelKind(): "points" | "display" {
    return this.view?.facts.names.length === 0 ? "display" : "points";
  }

  private showPanel(): void {
    const kind = this.panelKind;
    const isOpen = this.isPanelOpen[kind];
    const button = $("points-button");
    button.textContent = kind === "points" ? "Points" : "Display";
    button.title = kind === "points" ? "List of points (P)" : "Units, vertical axis, notes (P)";
    button.setAttribute("aria-expanded", String(isOpen));
    $("points").hidden = !isOpen;
    $("points").dataset.kind = kind;
    if (kind === "display") $<HTMLDetailsElement>("display").open = true;
  }

  toggle(id: string): void {
    $(id).setAttribute("aria-pressed", String($(id).getAttribute("aria-pressed") !== "true"));
    this.needsFrame = true;
  }

  setPlace(place: OriginalPlace): void {
    this.place = place;
    $<HTMLSelectElement>("original").value = place;
    this.rescale();
    this.reset();
  }

  /** Move the original on: over the decoded figure, beside it, hidden. */
  nextPlace(): void {
    this.setPlace(this.place === "over" ? "beside" : this.place === "beside" ? "off" : "over");
  }

  setUnit(unit: string): void {
    useUnit(unit ? (unit as Unit) : null);
    const { selected } = this.list;
    if (this.view) this.choose(this.active);
    this.list.select(selected);
  }

  /** Show the recording with another vertical axis than that of its file. */
  setUp(up: Facts["up"]): void {
    this.view?.orient(up);
    this.arrange();
  }

  async openFiles(files: FileList | File[] | null): Promise<void> {
    if (!files?.length) return;
    try {
      this.notice("reading…");
      const session = await dropped([...files], (share) => this.notice(`measuring… ${Math.round(100 * share)} %`));
      await this.open(session);
    } catch (error) {
      const names = [...files].map((file) => file.name).join(", ");
      this.notice(`${names}: ${error instanceof Error ? error.message : String(error)}`);
      this.keepsNotice = true;
    }
  }

  switchTheme(): void {
    this.theme = this.theme === "dark" ? "light" : "dark";
    this.applyTheme();
  }

  /** Select the point of a motion at this place of the picture, pixels. */
  pick(x: number, y: number): void {
    const view = this.view;
    if (view?.facts.kind !== "motion" || !view.positions) return;
    this.list.select(this.stage.pick(x, y, view.positions, (point) => view.toScene(point)));
  }

  /** For tests: the state of the page. */
  state(): Record<string, unknown> {
    const view = this.view;
    return {
      frame: this.frame,
      shownFrame: view?.shownFrame ?? -1,
      block: view?.decoded.blockFrames ?? 0,
      isPlaying: this.isPlaying,
      recordings: this.views.map((one) => one.facts.name),
      positions: view?.positions ? Array.from(view.positions.slice(0, 300)) : null,
      errors: view ? Array.from(view.errors) : null,
      marks: view?.facts.marks ?? [],
      up: view?.facts.up ?? null,
      late: this.late,
      drawn: this.drawn,
    };
  }
}

if (typeof document === "undefined") serve();
else {
  const page = new Page();
  Object.assign(window, { mocodecViewer: page });
  void page.start();
}
