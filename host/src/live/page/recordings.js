/**
 * The recordings of the daemon: list, replay, download, new names; and notes, in the capture being recorded or played.
 */
import { button, byId, make, show, write } from "./dom.js";
import { bytes, clock } from "./format.js";

const when = (seconds) => (seconds == null ? "" : new Date(seconds * 1e3).toLocaleString());

export class Recordings {
  /** What the list was last asked for: the state of the recorder then. */
  #askedFor = "";
  #listed = "";

  /** @param {(request: object) => void} send @param {() => string | null} token */
  constructor(send, token) {
    [this.send, this.token] = [send, token];
    byId("show-recordings").addEventListener("click", () => {
      byId("recordings").showModal();
      this.#ask();
    });
    byId("list-again").addEventListener("click", () => this.#ask());
  }

  #ask() {
    this.send({ kind: "recordings" });
  }

  /** A `recordings` message. */
  take({ folder, files }) {
    write(byId("recordings-folder"), files.length ? `In ${folder}, the newest first.` : `No captures in ${folder} yet.`);
    show(byId("recordings-table"), files.length > 0);
    const listed = JSON.stringify(files);
    // A name that is being typed stays.
    if (listed === this.#listed) return;
    this.#listed = listed;
    byId("recordings-rows").replaceChildren(...files.map((file) => this.#row(file)));
  }

  /** A `download` message. */
  download({ file, address }) {
    const link = make("a", "");
    [link.href, link.download] = [address, file];
    link.click();
  }

  #row({ name, bytes: size, modified_s, length_s, boards, notes, is_recorded }) {
    const state = is_recorded ? "being recorded" : length_s == null ? "not ended" : clock(length_s);
    const play = make("a", "button", "▶ Replay");
    const token = this.token();
    play.href = `/?recording=${encodeURIComponent(name)}${token ? `#token=${token}` : ""}`;
    [play.target, play.rel] = ["_blank", "noopener"];
    const download = button("⤓ Download", () => this.send({ kind: "download", file: name }));
    const rename = button("✎ Rename", () => this.#rename(label, name));
    for (const [element, verb] of [[play, "Replay"], [download, "Download"], [rename, "Rename"]]) {
      element.setAttribute("aria-label", `${verb} ${name}`);
    }
    rename.disabled = is_recorded;
    const label = make("th", "", name);
    label.scope = "row";
    const of = make("td", "optional", boards.map((board) => `…${board.slice(-6)}`).join(", "));
    of.title = boards.join(", ");
    const cells = [when(modified_s), state, bytes(size)].map((text) => make("td", "number", text));
    cells[0].classList.add("optional");
    return make("tr", "", label, ...cells, of, make("td", "number optional", notes ? String(notes) : ""),
      make("td", "actions", play, download, rename));
  }

  #rename(label, name) {
    const input = make("input", "");
    [input.type, input.value, input.maxLength] = ["text", name, 200];
    input.setAttribute("aria-label", `New name of ${name}`);
    label.replaceChildren(input);
    input.focus();
    input.setSelectionRange(0, name.lastIndexOf("."));
    input.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== "Escape") return;
      event.preventDefault();
      if (event.key === "Enter" && input.value !== name) this.send({ kind: "rename", file: name, to: input.value });
      label.replaceChildren(name);
    });
  }

  /** @param {object | null} recorder of the report @param {object | null} hello */
  draw(recorder, hello) {
    show(byId("show-recordings"), Boolean(hello?.source === "run" && hello.may_write && hello.has_folder));
    const state = `${recorder?.state} ${recorder?.file}`;
    if (state !== this.#askedFor && byId("recordings").open) this.#ask();
    this.#askedFor = state;
  }
}

/** Notes of instants: taken while a capture is recorded, shown while it is played. */
export class Notes {
  #shown = "";

  /** @param {(request: object) => boolean} send @param {() => number} ago_s time since the instant shown, seconds */
  constructor(send, ago_s) {
    this.send = send;
    byId("note").addEventListener("submit", (event) => {
      event.preventDefault();
      const text = byId("note-text");
      if (text.value.trim() && send({ kind: "note", text: text.value.trim(), ago_s: ago_s() })) text.value = "";
    });
  }

  /** The daemon has taken a note. */
  noted(text) {
    write(byId("noted"), `noted “${text}”`);
  }

  /** @param {object | null} recorder @param {object | null} player @param {object | null} hello @param {boolean} isPaused */
  draw(recorder, player, hello, isPaused) {
    show(byId("note"), Boolean(recorder?.state === "recording" && hello?.source === "run" && hello.may_write));
    byId("note-text").placeholder = isPaused ? "note of the instant shown" : "note of this instant";
    const notes = player?.notes ?? [];
    const shown = JSON.stringify([notes, hello?.may_write]);
    if (shown === this.#shown) return;
    this.#shown = shown;
    show(byId("notes"), notes.length > 0);
    byId("notes").replaceChildren(...notes.map(({ at_s, text }) => {
      const go = button(clock(at_s), () => this.send({ kind: "player", seek_s: Math.max(at_s, 0) }));
      // A note may be of an instant before the capture.
      go.disabled = !hello?.may_write || at_s < 0;
      return make("li", "", go, ` ${text}`);
    }));
    byId("note-ticks").replaceChildren(...notes.map(({ at_s }) => new Option("", at_s)));
  }
}
