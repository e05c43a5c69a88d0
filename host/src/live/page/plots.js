/**
 * Six plots of pose or velocity over one stretch of time, as curves, as spectra, or as Allan deviations; what is measured in
 * them by crosshair and markers; and the mouse, fingers and keys that move them.
 */
import { allan, spectrum } from "./analysis.js";
import { byId, make, remember, remembered, show, write } from "./dom.js";
import { COORDINATES, count, fixed, UNITS } from "./format.js";
import { ago, GUTTER, Lane } from "./lane.js";

/** First quantity of a bin, units of its numbers in metres or radians, shortest axis in what is shown, decimals. */
const QUANTITIES = {
  pose: { first: 0, unit: 1e-9, units: ["mm", "mm", "mm", "°", "°", "°"], least: 0.02, decimals: 4 },
  twist: { first: 6, unit: 1e-6, units: ["mm/s", "mm/s", "mm/s", "°/s", "°/s", "°/s"], least: 2, decimals: 2 },
};
const ANALYSES = { spectrum: { of: spectrum, per: "/√Hz", x: "Hz" }, allan: { of: allan, per: "", x: "s" } };
const SPANS_S = [0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600];
const [MIN_SPAN_S, MAX_SPAN_S] = [0.2, 600];
/** A marker can be dragged from so near; a pointer that has moved less has clicked. Pixels. */
const [NEAR_PX, CLICK_PX] = [9, 4];
/** Spectra of a stretch that goes on are renewed so seldom. */
const ANALYSE_EVERY_MS = 1000;

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export class Plots {
  #lanes;
  #drawn = "";
  #bar = "";
  #changes = 0;
  #analysed = { key: "", at_ms: 0, lanes: [] };
  #trace = null;
  #isPaused = false;
  /** Place of the crosshair, as a share of the width; null without one. */
  #cursor = null;
  /** When the stretch shown was moved away from the newest poses: the time from which its axis counts. */
  #held_s = null;
  view = { quantity: "pose", mode: "time", span_s: 10, end_s: null, marks: null, daemon: null, ...remembered("plots") };

  /** @param {() => void} changed @param {(time_s: number) => void} pick a moment was clicked */
  constructor(changed, pick) {
    [this.changed, this.pick] = [() => this.#change(changed), pick];
    this.#lanes = COORDINATES.map((name, i) => new Lane(name, i, this.changed));
    byId("plots").append(...this.#lanes.map((lane) => lane.element));
    for (const name of ["quantity", "mode", "span"]) {
      byId(name).addEventListener("change", ({ target }) => {
        if (name === "span") this.#show(Number(target.value), this.#end_s);
        else this.#set({ [name]: target.value });
      });
    }
    byId("span").append(...SPANS_S.map((span_s) => new Option(duration(span_s), span_s)));
    byId("mark").addEventListener("click", () => this.toggleMarks());
    byId("follow").addEventListener("click", () => this.follow());
    this.#takePointers(byId("plots"));
    byId("plots").addEventListener("keydown", (event) => this.#takeKey(event));
  }

  /** Whether another stretch than the newest is shown. */
  get isHeld() {
    return this.view.end_s !== null;
  }

  /** Shows the newest poses, and goes on with them. */
  follow() {
    this.#set({ end_s: null });
  }

  /** Shows the newest poses without markers: times of another board or daemon say nothing here. */
  reset(daemon = this.view.daemon) {
    this.#set({ end_s: null, marks: null, daemon });
  }

  /** @param {number} daemon what tells it from others: the time of its start */
  follows(daemon) {
    if (this.view.daemon !== daemon) this.reset(daemon);
  }

  /** Sets two markers, and holds the plots for them; or takes them away. */
  toggleMarks() {
    const { span_s, marks } = this.view;
    const [a, b] = [0.7, 0.3].map((share) => this.#end_s - share * span_s);
    this.#set(marks ? { marks: null } : { marks: [a, b], end_s: this.#end_s });
  }

  /** Draws all again at the next frame. */
  #change(changed) {
    this.#changes++;
    changed();
  }

  #set(view) {
    Object.assign(this.view, view);
    if (!this.isHeld) this.#held_s = null;
    else this.#held_s ??= this.#trace?.last_s ?? this.view.end_s;
    remember("plots", this.view);
    this.changed();
  }

  get #end_s() {
    return this.view.end_s ?? this.#trace?.last_s ?? 0;
  }

  get #from_s() {
    return this.#end_s - this.view.span_s;
  }

  #timeAt = (share) => this.#from_s + share * this.view.span_s;

  /** Shows this stretch; one that reaches the newest poses goes on with them. */
  #show(span_s, end_s) {
    span_s = clamp(span_s, MIN_SPAN_S, MAX_SPAN_S);
    const last_s = this.#trace?.last_s ?? 0;
    const oldest_s = last_s - this.#trace.span_s + span_s;
    this.#set({ span_s, end_s: end_s >= last_s ? null : Math.max(end_s, Math.min(oldest_s, last_s)) });
  }

  /** Zooms about a place, a share of the width; while the newest poses come in, about them. */
  #zoom(factor, share) {
    const span_s = clamp(this.view.span_s / factor, MIN_SPAN_S, MAX_SPAN_S);
    const isStill = this.isHeld || this.#isPaused;
    this.#show(span_s, isStill ? this.#timeAt(share) + (1 - share) * span_s : this.#end_s);
  }

  // Pointers and keys.

  #takePointers(container) {
    const shareOf = ({ clientX, target }) => {
      const { left, width } = target.getBoundingClientRect();
      return (clientX - left - GUTTER) / Math.max(width - GUTTER, 1);
    };
    /** Pointers that are down: share of the width, by id. */
    const down = new Map();
    let [task, moved, width] = ["", 0, 1];
    container.addEventListener("pointerdown", (event) => {
      if (event.target.tagName !== "CANVAS" || event.button !== 0) return;
      event.target.setPointerCapture(event.pointerId);
      width = Math.max(event.target.clientWidth - GUTTER, 1);
      const share = shareOf(event);
      down.set(event.pointerId, share);
      moved = 0;
      const { mode, marks, span_s } = this.view;
      const near = marks?.findIndex((mark_s) => Math.abs(mark_s - this.#timeAt(share)) * width < NEAR_PX * span_s);
      task = near >= 0 ? `mark${near}` : event.shiftKey ? "span" : "pan";
      if (down.size > 1) task = "pinch";
      if (mode !== "time") task = "";
      if (task === "span") this.#set({ marks: [this.#timeAt(share), this.#timeAt(share)], end_s: this.#end_s });
    });
    container.addEventListener("pointermove", (event) => {
      if (event.target.tagName !== "CANVAS") return;
      const share = shareOf(event);
      this.#cursor = share >= 0 && share <= 1 ? share : null;
      const before = down.get(event.pointerId);
      if (before !== undefined && task) {
        moved += Math.abs(share - before) * width;
        const others = [...down].filter(([id]) => id !== event.pointerId).map(([, other]) => other);
        if (task === "pinch" && others.length === 1) {
          const about = this.#timeAt(others[0]);
          const factor = Math.abs(share - others[0]) / Math.max(Math.abs(before - others[0]), 0.02);
          const span_s = clamp(this.view.span_s / factor, MIN_SPAN_S, MAX_SPAN_S);
          this.#show(span_s, about + (1 - others[0]) * span_s);
        } else if (task === "pan" && moved > CLICK_PX) {
          this.#show(this.view.span_s, this.#end_s - (share - before) * this.view.span_s);
        } else if (task === "span") this.#set({ marks: [this.view.marks[0], this.#timeAt(share)] });
        else if (task.startsWith("mark")) {
          this.#set({ marks: this.view.marks.with(Number(task.slice(4)), this.#timeAt(share)) });
        }
        if (task !== "pan" || moved > CLICK_PX) down.set(event.pointerId, share);
      }
      this.changed();
    });
    const lift = (event) => {
      if (!down.delete(event.pointerId)) return;
      if (task === "pan" && moved <= CLICK_PX && event.type === "pointerup") this.pick(this.#timeAt(shareOf(event)));
      // The finger that stays after a pinch must not move the plot.
      task = "";
    };
    for (const kind of ["pointerup", "pointercancel"]) container.addEventListener(kind, lift);
    container.addEventListener("pointerleave", () => {
      this.#cursor = null;
      this.changed();
    });
    container.addEventListener(
      "wheel",
      (event) => {
        if (event.target.tagName !== "CANVAS" || this.view.mode !== "time") return;
        event.preventDefault();
        const [across, along] = event.shiftKey ? [event.deltaY, 0] : [event.deltaX, event.deltaY];
        if (Math.abs(across) > Math.abs(along)) {
          this.#show(this.view.span_s, this.#end_s + (clamp(across, -120, 120) / 1200) * this.view.span_s);
        } else this.#zoom(Math.exp(clamp(along, -120, 120) * -0.002), shareOf(event));
      },
      { passive: false },
    );
  }

  #takeKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const cursor = this.#cursor ?? 0.5;
    const step = event.shiftKey ? 0.05 : 0.004;
    const { span_s, marks } = this.view;
    const act = {
      ArrowLeft: () => (this.#cursor = Math.max(cursor - step, 0)),
      ArrowRight: () => (this.#cursor = Math.min(cursor + step, 1)),
      PageUp: () => this.#show(span_s, this.#end_s - span_s / 2),
      PageDown: () => this.#show(span_s, this.#end_s + span_s / 2),
      "+": () => this.#zoom(1.5, cursor),
      "-": () => this.#zoom(1 / 1.5, cursor),
      Home: () => this.#show(span_s, -Infinity),
      End: () => this.follow(),
      "[": () => this.#set({ marks: [this.#timeAt(cursor), marks?.[1] ?? this.#end_s] }),
      "]": () => this.#set({ marks: [marks?.[0] ?? this.#from_s, this.#timeAt(cursor)] }),
      Enter: () => this.pick(this.#timeAt(cursor)),
      Escape: () => [(this.#cursor = null), this.#set({ marks: null })],
    }[event.key === "=" ? "+" : event.key];
    if (!act) return;
    act();
    event.preventDefault();
    event.stopPropagation();
    this.changed();
  }

  // Drawing.

  /** @param {import("./trace.js").Trace} trace @param {number | null} moment_s the moment that the page shows, if it is paused */
  draw(trace, moment_s) {
    [this.#trace, this.#isPaused] = [trace, moment_s !== null];
    const { quantity, mode, span_s, end_s, marks } = this.view;
    const width = Math.max(this.#lanes[0].surface.width - GUTTER, 1);
    // A column is drawn when it is complete, so a wide span costs little.
    const edge = Math.floor(((end_s ?? trace.last_s ?? 0) / span_s) * width);
    const key = [this.#changes, edge, moment_s, trace.last_s === null, this.isHeld && trace.changes].join();
    if (key === this.#drawn) return;
    this.#drawn = key;
    this.#writeBar();
    const what = { ...QUANTITIES[quantity], span_s, from_s: this.#from_s, to_s: this.#end_s, marks, moment_s };
    what.now_s = this.#held_s ?? trace.last_s ?? 0;
    what.cursor = this.#cursor;
    const pointed_s = this.#timeAt(this.#cursor);
    const isPointed = this.#cursor !== null && mode === "time";
    write(byId("instant"), isPointed ? `${ago(pointed_s - what.now_s, 1e-3)} (board ${fixed(pointed_s, 3)} s)` : "");
    if (mode === "time") {
      const columns = trace.columns(what.first, what.from_s, what.to_s, Math.floor(width));
      for (const lane of this.#lanes) lane.drawTime(columns, what);
    } else {
      const analyses = this.#analyse(trace, what);
      this.#lanes.forEach((lane, i) => lane.drawAnalysis(analyses[i], { ...what, ...ANALYSES[mode], mode }));
    }
    this.#writeFigures(trace, what);
  }

  #writeBar() {
    const { quantity, mode, span_s, marks } = this.view;
    const shown = [quantity, mode, span_s, Boolean(marks), this.isHeld].join();
    if (shown === this.#bar) return;
    this.#bar = shown;
    for (const [id, value] of Object.entries({ quantity, mode })) byId(id).value = value;
    const list = byId("span");
    const value = String(Number(span_s.toPrecision(3)));
    list.querySelector("[data-other]")?.remove();
    if (![...list.options].some((option) => option.value === value)) {
      const other = new Option(duration(Number(value)), value);
      other.dataset.other = "";
      list.add(other);
    }
    list.value = value;
    show(byId("follow"), this.isHeld);
    byId("mark").setAttribute("aria-pressed", Boolean(marks));
  }

  /** Spectra or deviations of the marked stretch, or else of that shown. */
  #analyse(trace, { first, marks, from_s, to_s }) {
    const [start_s, end_s] = marks ? marks.toSorted((a, b) => a - b) : [from_s, to_s];
    const { mode } = this.view;
    const isFixed = marks || this.isHeld;
    const key = [mode, first, end_s - start_s, isFixed && start_s, isFixed && trace.changes].join();
    const isOld = performance.now() - this.#analysed.at_ms > ANALYSE_EVERY_MS;
    if (this.#analysed.key !== key || isOld) {
      const lanes = COORDINATES.map((_, i) => {
        const series = trace.series(first, i, start_s, end_s);
        return { result: series && ANALYSES[mode].of(series), hasGaps: !series };
      });
      this.#analysed = { key, at_ms: performance.now(), lanes };
    }
    return this.#analysed.lanes;
  }

  /** What the markers measure. */
  #writeFigures(trace, { first, unit, units, decimals, now_s, marks }) {
    show(byId("figures"), Boolean(marks));
    if (!marks) return;
    const [a_s, b_s] = marks.toSorted((a, b) => a - b);
    const all = trace.statistics(first, a_s, b_s);
    const step_s = b_s - a_s;
    const ends = marks.map((mark_s) => trace.statistics(first, mark_s - 1e-3, mark_s + 0.05));
    const places = ["A", "B"].map((name, i) => `${name} ${ago(marks[i] - now_s, 1e-3)}`);
    const apart = `B − A ${fixed(marks[1] - marks[0], 4)} s (${fixed(1 / step_s, 3)} Hz)`;
    const scans = all ? [`${count(all.count)} of ${count(all.scans)} scans with a value`] : [];
    write(byId("figures-words"), [...places, apart, ...scans].join(", "));
    const rows = COORDINATES.map((name, i) => {
      const one = all?.quantities[i];
      const [a, b] = ends.map((end) => end?.quantities[i].mean);
      const numbers = [a, b, b - a, one?.mean, one?.rms, one && one.high - one.low];
      const cells = numbers.map((value, k) => {
        return make("td", k < 2 ? "number optional" : "number", fixed((value * unit) / UNITS[i], decimals, { plus: k < 4 }));
      });
      return make("tr", "", make("th", "", name, make("span", "unit", ` ${units[i]}`)), ...cells);
    });
    byId("figures").tBodies[0].replaceChildren(...rows);
  }
}

const duration = (seconds) => (seconds >= 60 && seconds % 60 === 0 ? `${seconds / 60} min` : `${seconds} s`);
