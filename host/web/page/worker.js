/**
 * Everything but the page: model, solver, simulator and captures, compiled to WebAssembly.
 *
 * The page calls functions by name and sends its own requests; this answers, and a hundred times a second passes on what
 * there is. What is recorded goes to a file that the user has chosen, or is kept for a download.
 */
import init, { choices, HeadFiles, Station } from "./slitpose_web.js";

/** Time between two ticks: browsers allow no less. */
const TICK_MS = 4;
const IDLE_MS = 100;
/** Bytes on their way to a file beyond which an export waits. */
const MAX_PENDING = 8 << 20;

let host = null;
/** Whether something is shown that goes on by itself. */
let isBusy = false;
/** Where recorded bytes go. */
let file = null;
let isExporting = false;
/** The connection of the page that said hello last. */
let connection = 0;

/** A file that is written while it grows; without a handle it is kept for a download. */
class Target {
  #parts = [];
  #written = Promise.resolve();
  #stream = null;
  pending = 0;

  static async open(name, handle) {
    const target = new Target();
    target.name = name;
    if (handle) target.#stream = await handle.createWritable();
    return target;
  }

  write(bytes) {
    if (!this.#stream) {
      this.#parts.push(bytes);
      // The browser may move a blob out of memory, but no array.
      if (this.#parts.length > 256) this.#parts = [new Blob(this.#parts)];
      return;
    }
    this.pending += bytes.length;
    this.#written = this.#written
      .then(() => this.#stream.write(bytes))
      .then(() => (this.pending -= bytes.length))
      .catch((error) => this.fail(error));
  }

  fail(error) {
    if (file !== this) return;
    file = null;
    isExporting = false;
    host.request(JSON.stringify({ kind: "record", on: false }));
    host.take_recorded();
    postMessage({ notice: `Writing ${this.name} failed: ${error.message}. Choose a file on a disk with room.` });
  }

  async close() {
    if (!this.#stream) return postMessage({ file: { name: this.name, blob: new Blob(this.#parts) } });
    await this.#written;
    await this.#stream.close();
  }
}

/** The captures that were chosen last, by their names; read a piece at a time. */
const captures = new Map();
const reader = new FileReaderSync();
globalThis.readFile = (name, at, count) => new Uint8Array(reader.readAsArrayBuffer(captures.get(name).slice(at, at + count)));
globalThis.lengthOfFile = (name) => captures.get(name)?.size ?? 0;
globalThis.clocks = () => [performance.timeOrigin + performance.now(), Date.now()];

/** The names of files, which are read from now on, too. */
function namesOf(files) {
  for (const file of files) captures.set(file.name, file);
  return files.map(({ name }) => name);
}

/** The head of a scene and a calibration: each `{ name, text }`, without text a shipped one. */
function headOf({ scene, calibration }) {
  const head = new HeadFiles(scene.name, scene.text ?? new Uint8Array());
  if (calibration) head.calibrate(calibration.name, calibration.text);
  return head;
}

const functions = {
  choices: () => JSON.parse(choices()),
  simulate(head, motion, seed, faults) {
    host.simulate(headOf(head), motion, seed, faults);
    isBusy = true;
  },
  follow(head) {
    host.follow(headOf(head));
    isBusy = true;
  },
  view(head) {
    host.view(headOf(head));
    isBusy = false;
  },
  play(files) {
    host.play(namesOf(files));
    isBusy = true;
  },
  leave() {
    host.stop_board();
    pass();
    host.leave();
    isBusy = false;
  },
  async record(name, handle) {
    if (file) throw new Error("another file is being written; end that first");
    const target = await Target.open(name, handle);
    host.record(name);
    file = target;
  },
  async export(files, name, handle) {
    if (file) throw new Error("another file is being written; end that first");
    host.export(namesOf(files));
    file = await Target.open(name, handle);
    isExporting = true;
  },
  port_opened: () => host.port_opened(),
  port_closed: (reason) => host.port_closed(reason),
  identify: (seconds) => host.identify(seconds),
};

async function answer({ call, name, values }) {
  try {
    await ready;
    const result = await functions[name](...values);
    postMessage({ call, result });
  } catch (error) {
    postMessage({ call, error: error.message ?? String(error) });
  }
  pass();
}

onmessage = ({ data }) => {
  if (data.call) answer(data);
  else if (!host) return;
  else if (data.request) {
    connection = data.connection;
    host.request(data.request);
  } else if (data.read) host.port_received(data.read, data.at_ms);
  if (data.request || data.read) guarded(pass);
};

/** Passes on what there is for page, port and file. */
function pass() {
  const messages = [];
  for (let message; (message = host.take_message()) !== undefined; ) messages.push(message);
  if (messages.length) postMessage({ messages, connection });
  const portBytes = host.take_outgoing();
  if (portBytes.length) postMessage({ portBytes }, [portBytes.buffer]);
  if (!file) return;
  const recorded = host.take_recorded();
  if (recorded.length) file.write(recorded);
  if (isExporting || host.is_recording()) return;
  const done = file;
  file = null;
  done.close().catch((error) => postMessage({ notice: `Writing ${done.name} failed: ${error.message}.` }));
}

function exportOn() {
  if (!isExporting || file?.pending > MAX_PENDING) return;
  try {
    const share = host.step_export();
    isExporting = share < 1;
    postMessage({ progress: share });
  } catch (error) {
    isExporting = false;
    postMessage({ progress: 1, notice: `The table is incomplete: ${error.message}` });
  }
}

function tick() {
  host.tick();
  exportOn();
  pass();
}

/** After a panic nothing can be relied on. */
function guarded(act) {
  try {
    act();
  } catch (error) {
    postMessage({ failure: error.message ?? String(error) });
    close();
  }
}

function loop() {
  guarded(tick);
  setTimeout(loop, isBusy || isExporting ? TICK_MS : IDLE_MS);
}

const ready = init().then(() => {
  host = new Station();
  loop();
});
ready.catch((error) => postMessage({ failure: error.message }));
