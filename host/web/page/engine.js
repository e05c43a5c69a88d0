/**
 * The worker: calls of its functions, and what it says by itself.
 */

class Engine {
  #worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  #calls = new Map();
  #number = 0;

  /** What is called with messages of the page, with bytes for the port, with a notice, and if the worker has failed. */
  onMessages = () => {};
  onPortBytes = () => {};
  onNotice = () => {};
  onProgress = () => {};
  onFailure = () => {};

  constructor() {
    this.ready = this.call("choices");
    this.#worker.onmessage = ({ data }) => this.#take(data);
    this.#worker.onerror = (event) => this.#fail(event.message || "the worker could not be loaded");
  }

  /** The result of a function of the worker. */
  call(name, ...values) {
    const number = ++this.#number;
    return new Promise((resolve, reject) => {
      this.#calls.set(number, { resolve, reject });
      this.#worker.postMessage({ call: number, name, values });
    });
  }

  post(message, transfer = []) {
    this.#worker.postMessage(message, transfer);
  }

  #take({ messages, connection, portBytes, notice, progress, file, failure, call, result, error }) {
    if (messages) this.onMessages(messages, connection);
    if (portBytes) this.onPortBytes(portBytes);
    if (notice) this.onNotice(notice);
    if (progress != null) this.onProgress(progress);
    if (file) download(file);
    if (failure) this.#fail(failure);
    if (!call) return;
    const waiting = this.#calls.get(call);
    this.#calls.delete(call);
    if (error == null) waiting?.resolve(result);
    else waiting?.reject(new Error(error));
  }

  #fail(reason) {
    for (const { reject } of this.#calls.values()) reject(new Error(reason));
    this.#calls.clear();
    this.onNotice(`The worker has failed: ${reason}. Reload the page.`);
    this.onFailure();
  }
}

export const engine = new Engine();

/** Saves a file where the browser saves downloads. */
export function download({ name, blob }) {
  const link = document.createElement("a");
  [link.href, link.download] = [URL.createObjectURL(blob), name];
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
