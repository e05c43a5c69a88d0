/**
 * What plots show of one board: bins of time with counts, means, extremes, spread and σ of all its scans. Pure.
 *
 * The daemon sends fine bins of the newest time and coarse ones of the last ten minutes; each is put in the place that its
 * number gives it, so it does not matter in which order they come, and whether twice. Lengths are whole nanometres and
 * micrometres per second, angles alike.
 */

/** Quantities of a bin: six coordinates of the pose, six of the velocity. */
const QUANTITIES = 12;
/** Numbers of a bin: scans, poses, velocities, and five of each quantity. */
const [MEAN, BELOW, ABOVE, RMS, SIGMA] = [0, 1, 2, 3, 4].map((column) => 3 + column * QUANTITIES);
const STRIDE = 3 + 5 * QUANTITIES;
/** Fine bins are kept for longer than the daemon does: three minutes. */
const FINE_S = 180;

/** Bins of one width, the newest in the place of the oldest. */
class Ring {
  constructor(hz, span_s) {
    this.hz = hz;
    this.size = Math.ceil(hz * span_s);
    this.indices = new Float64Array(this.size).fill(-Infinity);
    this.numbers = new Int32Array(this.size * STRIDE);
    this.newest = -Infinity;
  }

  put([index, ...numbers]) {
    const place = this.place(index);
    if (this.indices[place] > index) return;
    this.indices[place] = index;
    this.numbers.set(numbers, place * STRIDE);
    this.newest = Math.max(this.newest, index);
  }

  place(index) {
    return ((index % this.size) + this.size) % this.size;
  }

  /** Where the numbers of a bin begin; -1 without one. */
  find(index) {
    const place = this.place(index);
    return this.indices[place] === index ? place * STRIDE : -1;
  }

  frozen() {
    const copy = Object.assign(Object.create(Ring.prototype), this);
    [copy.indices, copy.numbers] = [this.indices.slice(), this.numbers.slice()];
    return copy;
  }
}

export class Trace {
  /** Fine bins between two that have scans: more than one where scans come more slowly than bins. */
  #spacing = 1;
  changes = 0;

  /** @param {{fine_hz: number, coarse_hz: number, coarse_s: number}} hello */
  constructor({ fine_hz, coarse_hz, coarse_s } = { fine_hz: 240, coarse_hz: 20, coarse_s: 1 }) {
    this.rings = [new Ring(fine_hz, FINE_S), new Ring(coarse_hz, coarse_s)];
    this.span_s = coarse_s;
  }

  /** @param {{fine?: number[][], coarse?: number[][]}} message a frame, or bins of the past */
  put({ fine = [], coarse = [] }) {
    for (const bin of fine) {
      const apart = bin[0] - this.rings[0].newest;
      if (apart > 0 && apart < 1e3) this.#spacing += (apart - this.#spacing) / 100;
      this.rings[0].put(bin);
    }
    for (const bin of coarse) this.rings[1].put(bin);
    this.changes++;
  }

  clear() {
    for (const ring of this.rings) [ring.newest] = [-Infinity, ring.indices.fill(-Infinity)];
    this.changes++;
  }

  frozen() {
    const copy = Object.assign(new Trace(), this);
    copy.rings = this.rings.map((ring) => ring.frozen());
    return copy;
  }

  /** The end of the newest bin, seconds by the board's clock; null without one. */
  get last_s() {
    const last_s = Math.max(...this.rings.map(({ newest, hz }) => (newest + 1) / hz));
    return Number.isFinite(last_s) ? last_s : null;
  }

  /** A shorter time without poses than this is no gap, in bins of `ring`. */
  #gap_s(ring) {
    return Math.max(1.5 / ring.hz, (2.5 * this.#spacing) / this.rings[0].hz);
  }

  /**
   * Calls `visit(ring, start of its numbers, from_s, to_s)` for the bins whose middle is in a span: fine ones where they hold
   * all scans of the coarse one.
   */
  each(from_s, to_s, visit) {
    const [fine, coarse] = this.rings;
    const ratio = fine.hz / coarse.hz;
    const oldest = fine.newest - fine.size;
    const call = (ring, index) => {
      const [at, middle_s] = [ring.find(index), (index + 0.5) / ring.hz];
      if (at >= 0 && middle_s >= from_s && middle_s < to_s) visit(ring, at, index / ring.hz, (index + 1) / ring.hz);
    };
    const scansOf = (ring, index) => ring.numbers[ring.find(index)] ?? 0;
    const last = Math.min(Math.floor(to_s * coarse.hz), Math.max(coarse.newest, Math.floor(fine.newest / ratio)));
    const first = Math.max(Math.floor(from_s * coarse.hz), last - coarse.size - 1);
    for (let k = first; k <= last; k++) {
      let scans = 0;
      for (let j = 0; j < ratio && (k + 1) * ratio > oldest; j++) scans += scansOf(fine, k * ratio + j);
      if (scans === 0 || scans < scansOf(coarse, k)) call(coarse, k);
      else for (let j = 0; j < ratio; j++) call(fine, k * ratio + j);
    }
  }

  /**
   * The bins of a span in `count` columns, for the six quantities from `first` on. Quantity `i` of column `c` stands at
   * `6 * c + i`; a column without poses has no `count`; a bin that is wider than a column is in one of them, from its start
   * to its end. `gaps` are the times without poses between others.
   */
  columns(first, from_s, to_s, count) {
    const columns = {
      first, size: count, count: new Float64Array(count), start_s: new Float64Array(count),
      end_s: new Float64Array(count), isBroken: new Uint8Array(count), gaps: [],
      ...Object.fromEntries(["mean", "low", "high", "sigma"].map((name) => [name, new Float64Array(6 * count)])),
    };
    const { mean, low, high, sigma } = columns;
    const step_s = (to_s - from_s) / count;
    let [lastEnd_s, wasMissing] = [null, false];
    this.each(from_s, to_s, ({ hz, numbers }, at, start_s, end_s) => {
      const poses = numbers[at + (first ? 2 : 1)];
      if (poses === 0) {
        wasMissing = true;
        return;
      }
      const c = Math.min(Math.floor(((start_s + end_s) / 2 - from_s) / step_s), count - 1);
      const gap = lastEnd_s !== null && (wasMissing || start_s - lastEnd_s > this.#gap_s({ hz }));
      if (gap) [columns.isBroken[c]] = [1, columns.gaps.push([lastEnd_s, start_s])];
      [lastEnd_s, wasMissing] = [end_s, false];
      const before = columns.count[c];
      const total = (columns.count[c] = before + poses);
      if (!before) columns.start_s[c] = start_s;
      columns.end_s[c] = end_s;
      for (let i = 0; i < 6; i++) {
        const [from, to] = [at + first + i, 6 * c + i];
        const value = numbers[from + MEAN];
        const [least, greatest] = [value - numbers[from + BELOW], value + numbers[from + ABOVE]];
        low[to] = before ? Math.min(low[to], least) : least;
        high[to] = before ? Math.max(high[to], greatest) : greatest;
        mean[to] += ((value - mean[to]) * poses) / total;
        sigma[to] += ((numbers[from + SIGMA] - sigma[to]) * poses) / total;
      }
    });
    return columns;
  }

  /**
   * Of all poses in a span, by quantity from `first` on: mean, rms deviation from it, extremes; null without a pose.
   * `from_s` and `to_s` are the ends of the bins that count.
   */
  statistics(first, from_s, to_s) {
    const found = { from_s: Infinity, to_s: -Infinity, scans: 0, count: 0 };
    const sums = Array.from({ length: 6 }, () => ({ mean: 0, squares: 0, low: Infinity, high: -Infinity }));
    this.each(from_s, to_s, ({ numbers }, at, start_s, end_s) => {
      found.scans += numbers[at];
      const poses = numbers[at + (first ? 2 : 1)];
      if (poses === 0) return;
      [found.from_s, found.to_s] = [Math.min(found.from_s, start_s), Math.max(found.to_s, end_s)];
      const total = found.count + poses;
      sums.forEach((sum, i) => {
        const from = at + first + i;
        const value = numbers[from + MEAN];
        const apart = value - sum.mean;
        sum.squares += poses * numbers[from + RMS] ** 2 + (apart * apart * found.count * poses) / total;
        sum.mean += (apart * poses) / total;
        sum.low = Math.min(sum.low, value - numbers[from + BELOW]);
        sum.high = Math.max(sum.high, value + numbers[from + ABOVE]);
      });
      found.count = total;
    });
    if (found.count === 0) return null;
    const of = ({ mean, squares, low, high }) => ({ mean, rms: Math.sqrt(squares / found.count), low, high });
    return { ...found, quantities: sums.map(of) };
  }

  /** Means of quantity `first + i` in equal steps: fine ones if the whole span has them; null if it has gaps. */
  series(first, i, from_s, to_s) {
    for (const ring of this.rings) {
      const [start, end] = [Math.ceil(from_s * ring.hz - 1e-6), Math.floor(to_s * ring.hz + 1e-6)];
      const values = [];
      for (let k = start; k < end; k++) {
        const at = ring.find(k);
        if (at < 0 || ring.numbers[at + (first ? 2 : 1)] === 0) break;
        values.push(ring.numbers[at + first + i + MEAN]);
      }
      if (values.length > 0 && values.length === end - start) return { hz: ring.hz, values };
    }
    return null;
  }
}
