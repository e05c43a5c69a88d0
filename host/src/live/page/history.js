/**
 * The frames of one board over the last minute, in order of their numbers, and what plots need of them.
 *
 * Bounded by the board's clock and by count. Frames may come late (the daemon's history follows live frames), twice
 * (after a reconnection), or with a clock that starts again (the board restarted): older frames are put in place, doubles
 * left out, and a clock that jumps back drops what was before.
 */
import { coordinates } from "./vectors.js";

/** Tells apart all contents that any history has had. */
let epochs = 0;

export class History {
  #frames = [];
  /** Index of the first frame kept; those before it are cut off now and then, not every time. */
  #first = 0;

  constructor(span_s = 60, hz = 60) {
    this.span_s = span_s;
    this.most = Math.ceil(span_s * hz * 1.25);
    /** Another number after every change but that of a frame put at the end. */
    this.epoch = ++epochs;
  }

  get length() {
    return this.#frames.length - this.#first;
  }

  at(index) {
    return index < 0 ? undefined : this.#frames[this.#first + index];
  }

  get last() {
    return this.length > 0 ? this.#frames[this.#frames.length - 1] : undefined;
  }

  clear() {
    this.#frames = [];
    this.#first = 0;
    this.epoch = ++epochs;
  }

  /** Takes a live frame; one older than the last is put in its place. */
  push(frame) {
    const last = this.last;
    if (last && frame.n <= last.n) return this.merge([frame]);
    if (last && frame.time_s < last.time_s) this.clear();
    this.#frames.push(frame);
    this.#trim();
  }

  /** Takes older frames. */
  merge(frames) {
    const all = new Map();
    for (const frame of frames) all.set(frame.n, frame);
    for (let i = this.#first; i < this.#frames.length; i++) all.set(this.#frames[i].n, this.#frames[i]);
    const sorted = [...all.values()].sort((a, b) => a.n - b.n);
    let start = sorted.length - 1;
    while (start > 0 && sorted[start - 1].time_s <= sorted[start].time_s) start--;
    this.#frames = sorted.slice(Math.max(start, 0));
    this.#first = 0;
    this.epoch = ++epochs;
    this.#trim();
  }

  #trim() {
    const oldest_s = this.last ? this.last.time_s - this.span_s : 0;
    while (this.length > this.most || this.at(0)?.time_s < oldest_s) this.#frames[this.#first++] = undefined;
    if (this.#first > 1024) {
      this.#frames = this.#frames.slice(this.#first);
      this.#first = 0;
    }
  }

  /** The index of the last frame at or before `time_s`; that of the first if there is none. */
  indexAt(time_s) {
    let [low, high] = [0, this.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle).time_s <= time_s) low = middle + 1;
      else high = middle;
    }
    return Math.max(low - 1, 0);
  }

  /** A copy that later frames do not change. */
  frozen() {
    const copy = new History(this.span_s, this.most / this.span_s / 1.25);
    copy.#frames = this.#frames.slice(this.#first);
    return copy;
  }
}

/** The six coordinates of a frame with their envelope, or null without a pose. */
export function poseValues(frame) {
  if (!frame.t_m || !frame.q_xyzw) return null;
  const value = coordinates(frame);
  return { value, low: frame.low ?? value, high: frame.high ?? value };
}

/** The six velocities of a frame. They have no envelope. */
export function twistValues(frame) {
  return frame.twist && { value: frame.twist, low: frame.twist, high: frame.twist };
}

/**
 * Gathers frames into the columns of a plot, one a pixel; each frame is read once.
 *
 * Column k covers the times [k, k + 1)·step_s. A column holds the values of its last frame, the least and greatest
 * of all, and whether poses were missing.
 */
export class Columns {
  #columns = new Map();
  #epoch = -1;
  #next = 0;

  /** @param {number} step_s @param {(frame: object) => {value, low, high} | null} read */
  constructor(step_s, read) {
    this.step_s = step_s;
    this.read = read;
  }

  /** Reads the frames of `history` that are new; keeps the columns from `oldest` on. */
  update(history, oldest) {
    if (history.epoch !== this.#epoch) {
      this.#columns.clear();
      this.#epoch = history.epoch;
      this.#next = -Infinity;
    }
    let index = history.length;
    while (index > 0 && history.at(index - 1).n >= this.#next) index--;
    for (; index < history.length; index++) this.#add(history.at(index));
    if (history.last) this.#next = history.last.n + 1;
    for (const k of this.#columns.keys()) {
      if (k >= oldest) break;
      this.#columns.delete(k);
    }
  }

  #add(frame) {
    const k = Math.floor(frame.time_s / this.step_s);
    const values = this.read(frame);
    const column = this.#columns.get(k);
    if (!column) {
      this.#columns.set(k, {
        value: values?.value ?? null,
        low: values && [...values.low],
        high: values && [...values.high],
        hasGap: !values,
      });
      return;
    }
    if (!values) {
      column.hasGap = true;
      return;
    }
    column.value = values.value;
    column.low = column.low ? column.low.map((v, i) => Math.min(v, values.low[i])) : [...values.low];
    column.high = column.high ? column.high.map((v, i) => Math.max(v, values.high[i])) : [...values.high];
  }

  at(k) {
    return this.#columns.get(k);
  }

  /** The least and greatest value of coordinate `i` from column `from` to `to`; null if there is none. */
  range(i, from, to) {
    let [low, high] = [Infinity, -Infinity];
    for (const [k, column] of this.#columns) {
      if (k < from || k > to || !column.low) continue;
      low = Math.min(low, column.low[i]);
      high = Math.max(high, column.high[i]);
    }
    return low <= high ? [low, high] : null;
  }
}
