/**
 * The connection to the daemon, or to what stands in its place: opens it, keeps it, acknowledges what came.
 *
 * The daemon sends at least twice a second, so two seconds of silence mean that the network or the daemon hangs, or that
 * the browser slept: the connection is given up and opened anew. Only a page of source "scene" may be silent, while
 * nothing is asked of it, and one without a network.
 */
import { connect, GONE, hasNetwork, onChange } from "./transport.js";

const SILENCE_MS = 2000;
const FIRST_WAIT_MS = 250;
/** At most two seconds in all until a restarted daemon is seen: this, and the time for opening. */
const LONGEST_WAIT_MS = 1500;
/** The daemon wants to hear after this many messages at the latest. */
const ACK_EVERY = 16;

const TOKEN_KEY = "slitpose-token";
const RELOAD_KEY = "slitpose-reloaded-for";

/**
 * @typedef {{state: "connecting" | "open" | "waiting" | "refused", reason: string, attempts: number}} LinkState
 */

export class Link {
  #socket = null;
  #timer = 0;
  #heard = 0;
  #messages = 0;
  #acknowledged = 0;
  #wait = FIRST_WAIT_MS;
  #mayBeSilent = false;

  /** @type {LinkState} */
  state = { state: "connecting", reason: "", attempts: 0 };

  /**
   * @param {(message: object) => void} received
   * @param {(state: LinkState) => void} changed
   */
  constructor(received, changed) {
    this.received = received;
    this.changed = changed;
    this.token = takeToken();
    /** The capture that this page plays, if it was opened for one. */
    this.recording = new URLSearchParams(location.search).get("recording");
    onChange(() => {
      this.token = takeToken();
      this.#open();
    });
    // Timers stand still in a tab that sleeps; both events say that it woke up.
    document.addEventListener("visibilitychange", () => this.#wake());
    addEventListener("online", () => this.#wake());
    setInterval(() => this.#watch(), 250);
    this.#open();
  }

  /** Sends a request; false if there is no connection, which loses it. */
  send(message) {
    if (this.state.state !== "open") return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  /** Acknowledges all messages so far; called once an animation frame. */
  acknowledge() {
    if (this.#messages === this.#acknowledged || this.#socket?.readyState !== WebSocket.OPEN) return;
    this.#acknowledged = this.#messages;
    this.#socket.send(JSON.stringify({ kind: "ack", messages: this.#messages }));
  }

  #open() {
    clearTimeout(this.#timer);
    this.#drop();
    const socket = connect();
    this.#socket = socket;
    this.#heard = performance.now();
    this.#messages = this.#acknowledged = 0;
    this.#mayBeSilent = !hasNetwork;
    socket.onopen = () => {
      this.#heard = performance.now();
      socket.send(JSON.stringify({ kind: "hello", token: this.token, recording: this.recording }));
    };
    socket.onmessage = ({ data }) => this.#take(data);
    socket.onclose = () => this.#lost(GONE);
  }

  #take(data) {
    this.#heard = performance.now();
    this.#messages++;
    const message = JSON.parse(data);
    if (message.kind === "hello") {
      this.#wait = FIRST_WAIT_MS;
      this.#mayBeSilent = !hasNetwork || message.source === "scene";
      reloadIfOther(message.version);
      this.#change("open");
    } else if (message.kind === "ended" || (message.kind === "refused" && this.state.state !== "open")) {
      this.#refused(message.reason);
      return;
    }
    this.received(message);
    if (this.#messages - this.#acknowledged >= ACK_EVERY) this.acknowledge();
  }

  #watch() {
    const silence_ms = performance.now() - this.#heard;
    if (this.#socket && !this.#mayBeSilent && silence_ms > SILENCE_MS) this.#lost("nothing came for 2 s");
  }

  #wake() {
    if (document.hidden || this.state.state === "refused") return;
    if (!this.#socket) this.#open();
    else this.#watch();
  }

  #lost(reason) {
    this.#drop();
    this.#change("waiting", reason);
    this.#timer = setTimeout(() => this.#open(), this.#wait);
    this.#wait = Math.min(this.#wait * 2, LONGEST_WAIT_MS);
  }

  /** A token does not become right by itself: no further attempt until there is another. */
  #refused(reason) {
    this.#drop();
    this.#change("refused", reason);
  }

  /** Forgets the socket at once; a close handshake may take long on a network that hangs. */
  #drop() {
    const socket = this.#socket;
    this.#socket = null;
    if (!socket) return;
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
  }

  #change(state, reason = "") {
    const attempts = state === "waiting" ? this.state.attempts + 1 : 0;
    this.state = { state, reason, attempts };
    this.changed(this.state);
  }
}

/** The token of the address, kept for reloads, and taken from the address bar so that nobody copies it along. */
function takeToken() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  try {
    if (token) {
      sessionStorage.setItem(TOKEN_KEY, token);
      history.replaceState(null, "", location.pathname + location.search);
    }
    return token ?? sessionStorage.getItem(TOKEN_KEY);
  } catch {
    return token;
  }
}

/** Loads the page of a daemon of another version, once: a cache that gives the old page again is not asked for ever. */
function reloadIfOther(version) {
  const own = document.querySelector("meta[name=slitpose-version]").content;
  if (own === version) return;
  try {
    if (sessionStorage.getItem(RELOAD_KEY) === version) return;
    sessionStorage.setItem(RELOAD_KEY, version);
  } catch {
    return;
  }
  location.reload();
}
