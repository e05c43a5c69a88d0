/**
 * How the page reaches the daemon that serves it: a WebSocket. Pages without a daemon have another module of this name.
 */

/** Whether what is at the other end can be lost without a word. */
export const hasNetwork = true;

/** Why a connection has ended by itself. */
export const GONE = "the daemon is gone";

/** A new connection, with the interface of a WebSocket. */
export function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  return new WebSocket(`${scheme}//${location.host}/live`);
}

/** Calls `reopen` when another connection is wanted: another token was given. */
export function onChange(reopen) {
  addEventListener("hashchange", reopen);
}
