/**
 * Replay: play and pause the capture, its speed, and any place in it.
 */
import { byId, show, write } from "./dom.js";
import { clock } from "./format.js";

export class Player {
  #state = null;
  /** Until when the slider is the user's: the daemon's answer to a seek takes a moment. */
  #heldUntil = 0;

  /** @param {(request: object) => void} send */
  constructor(send) {
    this.send = (request) => send({ kind: "player", ...request });
    byId("play").addEventListener("click", () => this.toggle());
    const seek = byId("seek");
    seek.addEventListener("input", () => {
      this.#heldUntil = performance.now() + 500;
      write(byId("place"), this.#words(Number(seek.value)));
    });
    seek.addEventListener("change", () => {
      this.#heldUntil = performance.now() + 500;
      this.send({ seek_s: Number(seek.value) });
    });
    byId("speed").addEventListener("change", ({ target }) => {
      this.send({ speed: target.value === "max" ? null : Number(target.value) });
    });
  }

  toggle() {
    if (!this.#state || byId("play").disabled) return;
    if (this.#state.ended && !this.#state.playing) this.send({ seek_s: 0, playing: true });
    else this.send({ playing: !this.#state.playing });
  }

  #words = (position_s) => `${clock(position_s)} / ${clock(this.#state?.duration_s)}`;

  /** @param {object | null} state the last `player` message @param {object | null} hello */
  draw(state, hello) {
    this.#state = state;
    show(byId("player"), hello?.source === "replay");
    if (!state) return;
    const mayWrite = Boolean(hello?.may_write);
    for (const id of ["play", "seek", "speed"]) byId(id).disabled = !mayWrite;
    write(byId("play"), state.playing ? "❚❚ Pause capture" : state.ended ? "↻ Again" : "▶ Play");
    const note = state.ended ? ", at its end" : mayWrite ? "" : ", this page may only look";
    write(byId("capture"), state.file + note);
    if (performance.now() < this.#heldUntil) return;
    const seek = byId("seek");
    seek.max = state.duration_s;
    seek.value = state.position_s;
    seek.setAttribute("aria-valuetext", this.#words(state.position_s));
    write(byId("place"), this.#words(state.position_s));
    this.#showSpeed(state.speed);
  }

  /** The list may lack the speed that the daemon was started with. */
  #showSpeed(speed) {
    const list = byId("speed");
    const value = speed == null ? "max" : String(speed);
    if (![...list.options].some((option) => option.value === value)) list.add(new Option(`${value}×`, value));
    if (document.activeElement !== list) list.value = value;
  }
}
