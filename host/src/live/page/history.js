/**
 * The frames of one board over the last minute, in order of their numbers.
 *
 * Bounded by the board's clock and by count. Frames may come late (the daemon's history follows live frames), twice
 * (after a reconnection), or with a clock that starts again (the board restarted): older frames are put in place, doubles
 * left out, and a clock that jumps back drops what was before.
 */
export class History {
  #frames = [];
  /** Index of the first frame kept; those before it are cut off now and then, not every time. */
  #first = 0;

  constructor(span_s = 60, hz = 60) {
    this.span_s = span_s;
    this.most = Math.ceil(span_s * hz * 1.25);
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
