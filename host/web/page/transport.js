/**
 * How the page reaches what stands in place of a daemon: a worker. It has the interface that the page's module of this name
 * has for a daemon.
 */
import { engine } from "./engine.js";
import { beginRecording, sources } from "./sources.js";

export const hasNetwork = false;
export const GONE = "the worker has stopped; reload the page";

/** The newest connection, by its number; messages of earlier ones are void. */
let current = null;
let number = 0;

class Connection {
  readyState = WebSocket.CONNECTING;
  onopen = null;
  onmessage = null;
  onclose = null;

  constructor() {
    current = this;
    this.number = ++number;
    engine.ready.then(() => {
      if (current !== this) return;
      this.readyState = WebSocket.OPEN;
      this.onopen?.();
    });
  }

  send(text) {
    // Only a click may ask where a file is to be.
    if (text.startsWith('{"kind":"record"') && JSON.parse(text).on) beginRecording();
    else engine.post({ request: text, connection: this.number });
  }

  close() {
    this.readyState = WebSocket.CLOSED;
    if (current === this) current = null;
  }
}

engine.onMessages = (messages, connection) => {
  // A message may close the connection.
  for (const data of messages) if (current?.number === connection) current.onmessage?.({ data });
};
engine.onFailure = () => {
  const lost = current;
  lost?.close();
  lost?.onclose?.();
};

export const connect = () => new Connection();

/** Calls `reopen` when another source is chosen. */
export function onChange(reopen) {
  sources.onChosen = reopen;
}
