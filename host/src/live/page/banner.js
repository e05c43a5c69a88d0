/**
 * What must not be overlooked: no connection, old data, missed frames, simulated or replayed poses.
 */
import { byId, make, show, write } from "./dom.js";
import { count } from "./format.js";

const NOTICE_MS = 8000;

export class Banner {
  #notices = new Map();

  constructor(changed) {
    this.changed = changed;
  }

  /** Shows words for a while: a refusal, missed frames. `kind` replaces an earlier one of that kind. */
  notice(kind, words) {
    const last = this.#notices.get(kind);
    clearTimeout(last?.timer);
    const timer = setTimeout(() => {
      this.#notices.delete(kind);
      this.changed();
    }, NOTICE_MS);
    this.#notices.set(kind, { words, timer });
    this.changed();
  }

  /** What was shown is about something else. */
  forget(kind) {
    clearTimeout(this.#notices.get(kind)?.timer);
    if (this.#notices.delete(kind)) this.changed();
  }

  /** Frames that the daemon left out; those of one burst are added up. */
  #missed = 0;
  missed(frames) {
    this.#missed = this.#notices.has("missed") ? this.#missed + frames : frames;
    this.notice("missed", `${count(this.#missed)} frames missed: this page or its network was too slow`);
  }

  draw({ link, hello, board, frame, isPaused }) {
    const words = [];
    if (link.state === "waiting" || (link.state === "connecting" && link.reason)) {
      words.push(`Disconnected: ${link.reason}. Connecting again, attempt ${link.attempts}. What is shown is old.`);
    } else if (link.state === "refused") {
      words.push(`Refused: ${link.reason}.`);
    }
    if (board && board.link.state !== "running" && board.link.state !== "ended") {
      words.push(`Board ${board.name}: ${board.link.state}${board.link.reason ? `, ${board.link.reason}` : ""}.`);
    }
    for (const notice of this.#notices.values()) words.push(notice.words);
    show(byId("banner"), words.length > 0);
    write(byId("banner"), words.join(" "));
    byId("banner").dataset.grade = link.state === "open" ? "warn" : "bad";
    document.body.classList.toggle("old", link.state !== "open" && Boolean(hello));
    document.body.classList.toggle("paused", isPaused);
    const state = { open: "● connected", waiting: "○ disconnected", connecting: "◌ connecting", refused: "✕ refused" };
    write(byId("link-state"), state[link.state]);
    byId("link-state").dataset.grade = { open: "good", connecting: "warn" }[link.state] ?? "bad";
    const badges = [
      hello?.source === "replay" && "replayed",
      hello?.source === "scene" && "scene",
      frame?.simulated && hello?.source !== "scene" && "simulated",
      isPaused && "paused",
    ].filter(Boolean);
    if (byId("badges").dataset.shown === badges.join()) return;
    byId("badges").dataset.shown = badges.join();
    byId("badges").replaceChildren(...badges.map((badge) => make("span", "badge", badge)));
  }
}
