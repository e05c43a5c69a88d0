/**
 * The last minute: pauses the page, not the daemon, and shows any moment of it.
 *
 * Pausing keeps a copy of every board's history, so that the moment shown stays while new frames come.
 */
import { byId, write } from "./dom.js";
import { fixed } from "./format.js";

export class Timeline {
  /** Copies of histories and traces by board while paused, else null. */
  #frozen = null;
  #index = 0;

  /**
   * @param {() => {histories: import("./history.js").History[], traces: import("./trace.js").Trace[]}} kept
   * @param {() => number} board @param {(isLive: boolean) => void} changed
   */
  constructor(kept, board, changed) {
    [this.kept, this.board, this.changed] = [kept, board, changed];
    const scrub = byId("scrub");
    scrub.addEventListener("input", () => {
      this.pause();
      this.#show(this.#current.indexAt(this.#end_s + Number(scrub.value)));
    });
    byId("pause").addEventListener("click", () => this.toggle());
    byId("live").addEventListener("click", () => this.live());
  }

  get isPaused() {
    return this.#frozen !== null;
  }

  /** The history shown, and the index in it of the frame shown. */
  get shown() {
    const history = this.#current;
    return { history, index: this.isPaused ? Math.min(this.#index, history.length - 1) : history.length - 1 };
  }

  get #current() {
    return (this.#frozen ?? this.kept()).histories[this.board()];
  }

  /** What plots show. */
  get trace() {
    return (this.#frozen ?? this.kept()).traces[this.board()];
  }

  get #end_s() {
    return this.#current.last?.time_s ?? 0;
  }

  pause() {
    if (this.isPaused || !this.#current?.last) return;
    const { histories, traces } = this.kept();
    const copy = (kept) => kept.frozen();
    this.#frozen = { histories: histories.map(copy), traces: traces.map(copy) };
    this.#show(this.#current.length - 1);
  }

  live() {
    this.#frozen = null;
    this.changed(true);
  }

  /** Pauses at a moment, if its frame is kept. */
  pick(time_s) {
    if (!(this.#current.at(0)?.time_s <= time_s)) return;
    this.pause();
    if (this.isPaused) this.#show(this.#current.indexAt(time_s));
  }

  toggle() {
    if (this.isPaused) this.live();
    else this.pause();
  }

  step(frames) {
    this.pause();
    if (this.isPaused) this.#show(this.#index + frames);
  }

  /** After a change of the board: the same moment before the end. */
  boardChanged() {
    if (this.isPaused) this.#show(this.#current.indexAt(this.#end_s + Number(byId("scrub").value)));
  }

  #show(index) {
    this.#index = Math.min(Math.max(index, 0), this.#current.length - 1);
    this.changed(false);
  }

  /** @param {boolean} isHeld whether the plots show another stretch than the newest */
  draw(isHeld) {
    const { history, index } = this.shown;
    const first = history?.at(0);
    const scrub = byId("scrub");
    const ago_s = history?.last ? history.at(index).time_s - history.last.time_s : 0;
    scrub.disabled = !first;
    if (document.activeElement !== scrub || !this.isPaused) scrub.value = ago_s;
    const words = this.isPaused ? `${fixed(ago_s, 2)} s` : "live";
    write(byId("moment"), words);
    scrub.setAttribute("aria-valuetext", words);
    write(byId("pause"), this.isPaused ? "▶ Go on" : "❚❚ Pause");
    byId("live").disabled = !this.isPaused && !isHeld;
  }
}
