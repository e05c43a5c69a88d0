/**
 * What is shown: a simulated head, a board by Web Serial, a capture, or a scene alone.
 */
import { byId, make, show, write } from "./dom.js";
import { download, engine } from "./engine.js";

/** The USB identity of a slitpose board. */
const USB = { usbVendorId: 0x1209, usbProductId: 0x0001 };
/** Enough for a board at 7 kHz behind a UART; USB ignores it. */
const BAUD = 3_000_000;
/** Bytes that wait while the page is busy: a second of a board at 4 kHz. */
const BUFFER_BYTES = 1 << 19;
const AGAIN_MS = 500;
/** A scene is read when nothing has been typed for this long. */
const TYPED_MS = 300;

const CAPTURE = { description: "Capture (MCAP)", accept: { "application/octet-stream": [".mcap"] } };
const SCENE = { description: "Scene (TOML)", accept: { "application/toml": [".toml"] } };
const TABLE = { description: "Table (CSV)", accept: { "text/csv": [".csv"] } };

const say = (text) => {
  write(byId("source-words"), text);
};
const reason = (error) => error.message.replace(/^./, (letter) => letter.toUpperCase());
const bytesOf = async (file) => ({ name: file.name, text: new Uint8Array(await file.arrayBuffer()) });

/** A board's port: reads, writes, and opens it again after it was unplugged. */
class Port {
  #port;
  #writer = null;
  #reader = null;
  #isWanted = true;

  constructor(port) {
    this.#port = port;
  }

  async run() {
    while (this.#isWanted) {
      try {
        await this.#port.open({ baudRate: BAUD, bufferSize: BUFFER_BYTES });
        await this.#port.setSignals({ dataTerminalReady: true }).catch(() => {});
        this.#writer = this.#port.writable.getWriter();
        await engine.call("port_opened");
        await this.#read();
      } catch (error) {
        if (this.#isWanted) await engine.call("port_closed", error.message);
      }
      await this.#close();
      if (this.#isWanted) await this.#pluggedIn();
    }
  }

  async #read() {
    // A framing error of a UART ends a stream, and not the port.
    while (this.#port.readable && this.#isWanted) {
      this.#reader = this.#port.readable.getReader();
      try {
        for (let chunk; !(chunk = await this.#reader.read()).done; ) {
          const at_ms = performance.timeOrigin + performance.now();
          engine.post({ read: chunk.value, at_ms }, [chunk.value.buffer]);
        }
        break;
      } finally {
        this.#reader.releaseLock();
      }
    }
    throw new Error("its port was closed");
  }

  write(bytes) {
    this.#writer?.write(bytes).catch(() => {});
  }

  /** Until the board may be there again: a port that comes back may be another object. */
  #pluggedIn() {
    const own = this.#port.getInfo();
    const isOwn = (port) => ["usbVendorId", "usbProductId"].every((key) => port.getInfo()[key] === own[key]);
    return new Promise((resolve) => {
      const come = ({ target }) => {
        if (isOwn(target)) this.#port = target;
        done();
      };
      const done = () => {
        navigator.serial.removeEventListener("connect", come);
        resolve();
      };
      navigator.serial.addEventListener("connect", come);
      setTimeout(done, AGAIN_MS);
    });
  }

  async #close() {
    this.#writer?.releaseLock();
    this.#writer = null;
    await this.#port.close().catch(() => {});
  }

  /** Gives the port back, behind what is on its way to the board. */
  async end() {
    this.#isWanted = false;
    await this.#writer?.ready.catch(() => {});
    await this.#reader?.cancel().catch(() => {});
  }
}

class Sources {
  #port = null;
  #scene = { name: "wide" };
  #calibration = null;
  #captures = [];
  #typing = 0;
  /** Line and column where the text of the scene is wrong. */
  #place = null;
  /** Called when another source was chosen. */
  onChosen = () => {};

  constructor() {
    engine.onPortBytes = (bytes) => this.#port?.write(bytes);
    engine.onNotice = say;
    engine.onProgress = (share) => say(share < 1 ? `Writing the table: ${Math.floor(share * 100)} %` : "The table is written.");
    engine.ready.then((choices) => this.#offer(choices)).catch((error) => say(reason(error)));
    const on = (id, act, event = "click") => byId(id).addEventListener(event, (given) => act(given)?.catch?.((error) => say(reason(error))));
    on("simulate", () => this.simulate());
    on("connect", () => this.#connect());
    on("disconnect", () => this.#leave());
    on("blink", () => engine.call("identify", 5));
    on("view-scene", () => this.#choose("scene", `the scene ${this.#scene.name}`, "view", this.#head));
    on("edit-scene", () => this.#edit());
    on("scene-text", () => this.#typed(), "input");
    on("save-scene", () => this.#saveScene());
    on("to-error", () => this.#toError());
    on("scene", () => this.#takeScene(), "change");
    on("scene-file", ({ target }) => this.#ownScene(target.files[0]), "change");
    on("calibration", ({ target }) => this.#calibrate(target.files[0]), "change");
    on("captures", ({ target }) => this.#play([...target.files]), "change");
    on("export", () => this.#export());
    on("fault", ({ target }) => this.#addFault(target), "change");
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => {
      event.preventDefault();
      this.#drop([...event.dataTransfer.files]).catch((error) => say(reason(error)));
    });
    const hasSerial = "serial" in navigator;
    byId("connect").disabled = !hasSerial;
    show(byId("no-serial"), !hasSerial);
  }

  #offer({ scenes, motions, faults }) {
    this.shipped = new Map(scenes.map((scene) => [scene.name, scene]));
    byId("scene").replaceChildren(...scenes.map(({ name }) => new Option(name, name)), new Option("file…", ""));
    byId("motion").replaceChildren(...motions.map((name) => new Option(name, name, name === "hand", name === "hand")));
    byId("fault").append(...faults.map(({ name, example, about }) => {
      const option = new Option(name, example);
      option.title = about;
      return option;
    }));
    this.#about();
    this.simulate().catch((error) => say(reason(error)));
  }

  get #head() {
    return { scene: this.#scene, calibration: this.#calibration };
  }

  #about() {
    write(byId("scene-about"), this.#scene.text ? this.#scene.name : (this.shipped.get(this.#scene.name)?.about ?? ""));
    write(byId("calibration-name"), this.#calibration?.name ?? "");
  }

  #takeScene() {
    const name = byId("scene").value;
    if (!name) return byId("scene-file").click();
    this.#scene = { name };
    this.#calibration = null;
    this.#about();
    this.#writeText();
  }

  /** Opens the text of the scene, or closes it. */
  #edit() {
    const editor = byId("scene-editor");
    show(editor, editor.hidden);
    byId("edit-scene").setAttribute("aria-expanded", String(!editor.hidden));
    this.#writeText();
  }

  #writeText() {
    if (byId("scene-editor").hidden) return;
    const own = this.#scene.text && new TextDecoder().decode(this.#scene.text);
    byId("scene-text").value = own ?? this.shipped.get(this.#scene.name).text;
    this.#say(own == null ? "Change the text, and the head is that of the text." : "");
  }

  /** Says what is wrong with the text, if `place` has a line and a column; else what there is to say. */
  #say(words, place = null) {
    byId("scene-editor").classList.toggle("wrong", Boolean(place));
    this.#place = place;
    write(byId("scene-error"), words);
    show(byId("to-error"), Boolean(place));
  }

  /** The text is the scene, once it is one: until then the last one stays. */
  #typed() {
    clearTimeout(this.#typing);
    this.#typing = setTimeout(async () => {
      const name = this.#scene.name.replace(/(\.toml)?$/, ".toml");
      const scene = { name, text: new TextEncoder().encode(byId("scene-text").value) };
      try {
        await this.#choose("scene", `the scene ${name}`, "view", { scene, calibration: null });
      } catch (error) {
        const [, line, column, words] = error.message.match(/:(\d+):(\d+): (.*)$/s) ?? [null, 1, 1, error.message];
        return this.#say(`Line ${line}: ${words.replace(/[^.?]$/, "$&.")}`, [Number(line), Number(column)]);
      }
      [this.#scene, this.#calibration] = [scene, null];
      byId("scene").value = "";
      this.#about();
      this.#say("As the text says.");
    }, TYPED_MS);
  }

  /** Puts the cursor where the text is wrong. */
  #toError() {
    const [text, [line, column]] = [byId("scene-text"), this.#place];
    const at = text.value.split("\n").slice(0, line - 1).reduce((sum, { length }) => sum + length + 1, column - 1);
    text.focus();
    text.setSelectionRange(at, at);
    text.scrollTop = (line - 3) * (text.scrollHeight / text.value.split("\n").length);
  }

  async #saveScene() {
    const text = byId("scene-text").value;
    const target = await place(this.#scene.name.replace(/(\.toml)?$/, ".toml"), SCENE);
    if (!target) return;
    if (!target.handle) return download({ name: target.name, blob: new Blob([text]) });
    const file = await target.handle.createWritable();
    await file.write(text);
    await file.close();
  }

  async #ownScene(file) {
    if (!file) return;
    this.#scene = await bytesOf(file);
    this.#calibration = null;
    byId("scene").value = "";
    this.#about();
    this.#writeText();
  }

  async #calibrate(file) {
    this.#calibration = file ? await bytesOf(file) : null;
    this.#about();
  }

  #addFault(list) {
    const faults = byId("faults");
    faults.value = [faults.value.trim(), list.value].filter(Boolean).join("\n");
    list.value = "";
  }

  async simulate() {
    const seed = Number(byId("seed").value) >>> 0;
    await this.#choose("sim", `a simulated head, ${this.#scene.name}`, "simulate", this.#head, byId("motion").value, seed, byId("faults").value);
  }

  async #connect() {
    const filters = byId("any-port").checked ? [] : [USB];
    const port = await navigator.serial.requestPort({ filters }).catch((error) => {
      if (error.name === "NotFoundError") return null;
      throw error;
    });
    if (!port) return say("No port was chosen.");
    await this.#choose("board", `a board, ${this.#scene.name}`, "follow", this.#head);
    this.#port = new Port(port);
    this.#port.run();
  }

  async #play(files) {
    if (!files.length) return;
    this.#captures = files;
    await this.#choose("capture", files.map(({ name }) => name).join(", "), "play", files);
  }

  async #drop(files) {
    const [scene] = files.filter(({ name }) => name.endsWith(".toml"));
    if (!scene) return this.#play(files);
    await this.#ownScene(scene);
    await this.#choose("scene", `the scene ${this.#scene.name}`, "view", this.#head);
  }

  /** Shows another source; what was shown before stays if it cannot be shown. */
  async #choose(kind, words, name, ...values) {
    say("");
    await this.#endPort();
    await engine.call(name, ...values);
    document.body.dataset.kind = kind;
    write(byId("source-name"), words);
    for (const id of ["disconnect", "blink"]) byId(id).disabled = kind !== "board";
    byId("export").disabled = kind !== "capture";
    this.onChosen();
  }

  async #leave() {
    await this.#endPort();
    await engine.call("leave");
    write(byId("source-name"), "nothing");
    for (const id of ["disconnect", "blink"]) byId(id).disabled = true;
  }

  async #endPort() {
    const port = this.#port;
    if (!port) return;
    await engine.call("leave");
    this.#port = null;
    await port.end();
  }

  async #export() {
    const name = this.#captures[0].name.replace(/\.mcap$/, "") + ".csv";
    const target = await place(name, TABLE);
    if (target) await engine.call("export", this.#captures, target.name, target.handle);
  }
}

/** Where the user wants a file; without the File System Access API it will be a download. */
async function place(name, type) {
  if (!("showSaveFilePicker" in window)) return { name, handle: null };
  try {
    const handle = await window.showSaveFilePicker({ suggestedName: name, types: [type] });
    return { name: handle.name, handle };
  } catch (error) {
    if (error.name === "AbortError") return null;
    throw error;
  }
}

export async function beginRecording() {
  try {
    const stamp = new Date().toISOString().slice(0, 19).replaceAll(":", "-");
    const target = await place(`slitpose-${stamp}Z.mcap`, CAPTURE);
    if (target) await engine.call("record", target.name, target.handle);
  } catch (error) {
    say(reason(error));
  }
}

export const sources = new Sources();

// Where browsers allow it: at https addresses and on this machine.
navigator.serviceWorker?.register("offline.js").catch(() => {});
