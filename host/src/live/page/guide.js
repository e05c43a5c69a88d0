/**
 * Leads through a calibration without an instrument: what to do, how much of the workspace has been seen, and what the
 * recordings so far leave open. Each part is a recording of its own; steps and stops are marked by notes in it.
 */
import { button, byId, make, remember, remembered, show, write } from "./dom.js";
import { COORDINATES, fixed } from "./format.js";
import { coordinates } from "./vectors.js";

/** What a coordinate is of, for people. */
const NAMES = COORDINATES.map((name, axis) => (axis < 3 ? `along ${name}` : `about ${COORDINATES[axis - 3]}`));

/** Share of the workspace, along an axis, from which on more tells little; and the shortest free motion. */
const ENOUGH_SHARE = 0.6;
const ENOUGH_S = 20;
/** Poses farther out, in half extents of the workspace, do not count as seen. */
const FARTHEST = 1.3;
const ENOUGH_MARKS = { stage: 6, rest: 4 };

const PARTS = [
  {
    key: "free", title: "Free motion", axes: [0, 1, 2, 3, 4, 5],
    words: "Move the tool by hand through its whole workspace, and turn it as far as it goes, for 20 s or more. This alone " +
      "determines nearly everything but the scale and where the frames lie.",
  },
  {
    key: "pivot", title: "Tip in a cone", axes: [3, 4, 5],
    words: "Rest the tip of the tool in a cone, such as a punch mark, begin, and turn the tool about it. End before you lift it.",
  },
  {
    key: "stage", title: "Known steps", axes: [], mark: "Here",
    words: "Move the tool along a line by known steps without turning it: on a stage, or along gauge blocks. Press the " +
      "button at each step once the tool has rested there for half a second. This fixes the scale.",
  },
  {
    key: "rest", title: "Returns to a stop", axes: [], mark: "At the stop",
    words: "Put the tool against a stop that holds it, such as a kinematic nest, again and again. Press the button each " +
      "time once it has rested there for half a second.",
  },
];

export class Guide {
  #isOpen = false;
  #part = 0;
  /** Recordings by part; kept over a reload. */
  #files = remembered("guide") ?? {};
  /** Of the part being recorded: its recording, when it began, least and greatest coordinates, marks. */
  #running = null;
  /** Whether a recording is under way that is no part of the session. */
  #isBusy = false;
  #workspace = null;
  #bars;
  #calibration = null;

  /** @param {(request: object) => boolean} send */
  constructor(send) {
    this.send = send;
    this.#bars = NAMES.map((name, axis) => {
      const [bar, value] = [make("meter", ""), make("span", "number", "–")];
      [bar.min, bar.max, bar.low, bar.high, bar.optimum, bar.value] = [0, 1, ENOUGH_SHARE, 1, 1, 0];
      bar.setAttribute("aria-label", `share of the workspace seen: ${name}`);
      const row = make("li", "", make("span", "", name), bar, value);
      byId("guide-bars").append(row);
      return { row, bar, value };
    });
    byId("open-guide").addEventListener("click", () => {
      this.#isOpen = !this.#isOpen;
      show(byId("guide-panel"), this.#isOpen);
      if (this.#isOpen) byId("guide-panel").scrollIntoView({ block: "nearest" });
      this.#write();
    });
    byId("guide-begin").addEventListener("click", () => this.#beginOrEnd());
    byId("guide-step").addEventListener("input", () => this.#write());
    byId("guide-mark").addEventListener("click", () => this.#mark());
    byId("guide-adjust").addEventListener("click", () => {
      const of = (key) => (this.#files[key] ? [this.#files[key]] : []);
      this.send({ kind: "calibrate", free: of("free"), pivot: of("pivot"), stage: of("stage"), rest: of("rest") });
    });
    byId("guide-parts").append(...PARTS.map(({ title }, part) => {
      return button(`${part + 1}. ${title}`, () => {
        if (!this.#running) this.#part = part;
        this.#write();
      });
    }));
  }

  setHead(head) {
    this.#workspace = head?.workspace ? [...head.workspace.half_extent_m, ...head.workspace.half_extent_rad] : null;
  }

  /** A frame of the board. */
  frame(frame) {
    if (!this.#running?.file || !frame.t_m || !frame.q_xyzw) return;
    const [{ least, most }, values] = [this.#running, coordinates(frame)];
    // A head that is not calibrated has wrong poses now and then.
    if (values.some((value, axis) => Math.abs(value) > FARTHEST * (this.#workspace?.[axis] ?? Infinity))) return;
    values.forEach((value, axis) => {
      least[axis] = Math.min(least[axis], value);
      most[axis] = Math.max(most[axis], value);
    });
  }

  /** The daemon has refused a request: a recording that was asked for does not begin. */
  refused() {
    if (this.#running?.file === "") this.#running = null;
  }

  /** A `calibration` message. */
  take(message) {
    this.#calibration = message;
    this.#write();
  }

  #beginOrEnd() {
    if (this.#running) {
      this.send({ kind: "record", on: false });
      return;
    }
    const limits = COORDINATES.map(() => Infinity);
    const running = { file: "", at_ms: 0, least: limits, most: limits.map((limit) => -limit), marks: [] };
    if (this.send({ kind: "record", on: true })) this.#running = running;
  }

  #mark() {
    const step = this.#step();
    const text = PARTS[this.#part].key === "stage" ? `step ${step} mm` : "stop";
    if (this.send({ kind: "note", text, ago_s: 0 })) this.#running.marks.push(text);
    this.#write();
  }

  /** Millimetres of the next mark, without the noise of sums. */
  #step() {
    return Number((byId("guide-step").valueAsNumber * (this.#running?.marks.length ?? 0)).toFixed(6));
  }

  /** @param {object | null} recorder of the report @param {object | null} hello */
  draw(recorder, hello) {
    const isOffered = hello?.has_folder && hello.may_write && hello.boards.length === 1;
    show(byId("open-guide"), Boolean(isOffered));
    show(byId("guide-panel"), Boolean(isOffered && this.#isOpen));
    const running = this.#running;
    this.#isBusy = !running && recorder?.state === "recording";
    if (running && !running.file && recorder?.state === "recording" && recorder.file) {
      [running.file, running.at_ms] = [recorder.file.split("/").at(-1), performance.now()];
    } else if (running?.file && recorder && recorder.state !== "recording") {
      if (recorder.state !== "failed") this.#files[PARTS[this.#part].key] = running.file;
      remember("guide", this.#files);
      this.#running = null;
      this.#part = Math.min(this.#part + 1, PARTS.length - 1);
    }
    if (isOffered && this.#isOpen) this.#write();
  }

  #shares() {
    const { least, most } = this.#running ?? {};
    return COORDINATES.map((_, axis) => {
      const half = this.#workspace?.[axis];
      if (!half) return 1;
      const within = (value) => Math.min(Math.max(value, -half), half);
      return least && least[axis] <= most[axis] ? (within(most[axis]) - within(least[axis])) / (2 * half) : 0;
    });
  }

  #write() {
    const [part, running] = [PARTS[this.#part], this.#running];
    [...byId("guide-parts").children].forEach((choice, number) => {
      const isDone = Boolean(this.#files[PARTS[number].key]);
      write(choice, `${isDone ? "✓" : number + 1 + "."} ${PARTS[number].title}`);
      choice.setAttribute("aria-pressed", number === this.#part);
      choice.disabled = Boolean(running) && number !== this.#part;
    });
    write(byId("guide-words"), part.words);
    const shares = this.#shares();
    show(byId("guide-bars"), part.axes.length > 0);
    this.#bars.forEach(({ row, bar, value }, axis) => {
      show(row, part.axes.includes(axis));
      bar.value = shares[axis];
      write(value, running ? `${fixed(shares[axis] * 100, 0)} %` : "–");
    });
    write(byId("guide-begin"), running ? "■ End this part" : this.#files[part.key] ? "● Do it again" : "● Begin");
    const hasStep = part.key !== "stage" || Boolean(byId("guide-step").valueAsNumber);
    byId("guide-begin").disabled = running ? !running.file : this.#isBusy || !hasStep;
    show(byId("guide-mark"), Boolean(part.mark && running?.file));
    write(byId("guide-mark"), part.key === "stage" ? `${part.mark}: ${this.#step()} mm` : part.mark ?? "");
    show(byId("guide-step-choice"), part.key === "stage");
    byId("guide-step").disabled = Boolean(running);
    const obstacle = this.#isBusy ? "Another recording is under way: stop it first." : hasStep ? "" : "Give the length of a step.";
    write(byId("guide-advice"), running?.file ? this.#advice(part, shares) : obstacle);
    byId("guide-adjust").disabled = Boolean(running) || !this.#files.free || this.#calibration?.state === "running";
    this.#writeResult();
  }

  /** What is missing of the part being recorded, or that it is enough. */
  #advice({ key, axes }, shares) {
    const seconds = (performance.now() - this.#running.at_ms) / 1e3;
    if (axes.length === 0) {
      const missing = ENOUGH_MARKS[key] - this.#running.marks.length;
      const noted = this.#running.marks.length ? `${this.#running.marks.length} marked. ` : "";
      return noted + (missing > 0 ? `${missing} more at least.` : "That is enough; more make it better.");
    }
    const worst = axes.reduce((a, b) => (shares[b] < shares[a] ? b : a));
    if (shares[worst] < ENOUGH_SHARE) {
      return `${fixed(seconds, 0)} s. Go on: ${worst < 3 ? "move" : "turn"} it ${NAMES[worst]}.`;
    }
    if (seconds < ENOUGH_S) return `${fixed(seconds, 0)} s. Go on for ${fixed(ENOUGH_S - seconds, 0)} s.`;
    return "That is enough; more makes it better.";
  }

  #writeResult() {
    const { state, done, file, said } = this.#calibration ?? {};
    show(byId("guide-progress"), state === "running");
    byId("guide-progress").value = done ?? 0;
    const lines = state === "failed" ? said.map((line) => `Failed: ${line}`) : said ?? [];
    const result = byId("guide-result");
    if (result.dataset.shown === JSON.stringify(this.#calibration)) return;
    result.dataset.shown = JSON.stringify(this.#calibration);
    result.replaceChildren(...lines.map((line) => make("li", "", line)));
    if (state !== "done") return;
    result.append(make("li", "", "wrote ", make("code", "", file), "; go on with ", make("code", "", `slitpose run --calibration ${file}`)));
  }
}
