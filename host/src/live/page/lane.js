/**
 * One plot of a quantity: a curve over time, or its spectrum or Allan deviation, with axes, markers and crosshair.
 *
 * A curve shows all scans: each pixel column is filled from the least to the greatest value in it, and the line is their
 * mean. Where a column covers more than a period of the motion the filled area is the curve.
 */
import { roundDown } from "./camera.js";
import { make, Surface, write } from "./dom.js";
import { engineering, fixed, UNITS } from "./format.js";
import { cellColour, colours } from "./palette.js";

/** Left of a plot, for the numbers of its axis; below it; and above. */
export const GUTTER = 46;
const [FOOT, TOP] = [15, 3];

export class Lane {
  #scale = null;
  #title = make("span", "plot-title");
  #value = make("span", "number");

  constructor(name, i, changed) {
    [this.name, this.i] = [name, i];
    const canvas = make("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${name} over time`);
    this.element = make("figure", "plot", make("figcaption", "row", this.#title, this.#value), canvas);
    this.surface = new Surface(canvas, changed);
  }

  drawTime(columns, { unit, units, least, decimals, from_s, to_s, span_s, now_s, marks, moment_s, cursor }) {
    const { i } = this;
    const factor = unit / UNITS[i];
    write(this.#title, `${this.name}, ${units[i]}`);
    const { at, range } = readAt(columns, i, cursor);
    write(this.#value, at < 0 ? "–" : reading(columns, i, at, factor, decimals, cursor !== null));
    const context = this.surface.start();
    if (!context) return;
    const { width, height } = this.surface;
    this.#scale = fit(this.#scale, range?.map((v) => v * factor), least, height / 34);
    const { low, high, tick } = this.#scale;
    const y = (v) => TOP + ((high - v) / (high - low)) * (height - FOOT - 2 * TOP);
    const x = (time_s) => GUTTER + ((time_s - from_s) / span_s) * (width - GUTTER);
    const places = Math.max(0, -Math.floor(Math.log10(tick) + 1e-9));
    const rows = steps(low, high, tick).map((v) => [y(v), fixed(v, places)]);
    const wide = roundUp((span_s * 70) / (width - GUTTER), span_s);
    const marksX = steps(from_s - now_s, to_s - now_s, wide).map((s) => [x(s + now_s), ago(s, wide)]);
    grid(context, this.surface, rows, marksX);
    context.save();
    context.beginPath();
    context.rect(GUTTER, 0, width - GUTTER, height - FOOT);
    context.clip();
    for (const [start_s, end_s] of columns.gaps) {
      context.fillStyle = colours.bad;
      context.globalAlpha = 0.14;
      context.fillRect(x(start_s), 0, Math.max(x(end_s) - x(start_s), 1), height - FOOT);
      context.globalAlpha = 1;
      context.fillRect(x(start_s), 0, Math.max(x(end_s) - x(start_s), 2), 2);
    }
    if (marks) this.#drawMarks(context, marks.map(x), height);
    curve(context, columns, i, x, (v) => y(v * factor), cellColour(i % 3));
    if (moment_s !== null) line(context, x(moment_s), height - FOOT, colours.accent);
    if (cursor !== null) {
      line(context, GUTTER + cursor * (width - GUTTER), height - FOOT, colours.ink);
      if (at >= 0) dot(context, x((columns.start_s[at] + columns.end_s[at]) / 2), y(columns.mean[6 * at + i] * factor));
    }
    context.restore();
    if (range === null) words(context, this.surface, columns.first ? "no velocity" : "no pose");
  }

  #drawMarks(context, [a, b], height) {
    context.fillStyle = colours.accent;
    context.globalAlpha = 0.12;
    context.fillRect(Math.min(a, b), 0, Math.abs(b - a), height - FOOT);
    context.globalAlpha = 1;
    [["A", a], ["B", b]].forEach(([name, x]) => {
      context.fillStyle = colours.accent;
      context.fillRect(x - 0.5, 0, 1, height - FOOT);
      const left = (name === "A") === a <= b ? x : x - 13;
      context.fillRect(left, 0, 13, 13);
      context.fillStyle = colours.panel;
      [context.font, context.textAlign, context.textBaseline] = ["bold 10px system-ui, sans-serif", "center", "middle"];
      context.fillText(name, left + 6.5, 7);
    });
  }

  /** Both axes are logarithmic. */
  drawAnalysis({ result, hasGaps }, { unit, first, per, x: xUnit, cursor, mode }) {
    const symbol = (this.i < 3 ? "m" : "rad") + (first ? "/s" : "");
    write(this.#title, `${this.name}, ${symbol}${per}`);
    const context = this.surface.start();
    const { width, height } = this.surface;
    if (!context || !result) {
      write(this.#value, "–");
      if (context) words(context, this.surface, hasGaps ? "the stretch has gaps" : "too short a stretch");
      return;
    }
    const { x: at, y: values, peak } = result;
    const visible = values.filter((value) => value > 0);
    const [left, right] = [Math.log10(at[0]), Math.log10(at.at(-1))];
    const [low, high] = [Math.min(...visible), Math.max(...visible)].map((value) => Math.log10(value * unit));
    const span = Math.max(high - low, 1) * 1.1;
    const x = (value) => GUTTER + ((Math.log10(value) - left) / (right - left)) * (width - GUTTER);
    const top = high + span * 0.04;
    const y = (value) => TOP + ((top - Math.log10(Math.max(value, 1e-30))) / span) * (height - FOOT - 2 * TOP);
    const decades = (from, to) => steps(from, to, Math.max(1, Math.ceil((to - from) / 6))).map((exponent) => 10 ** exponent);
    const rows = decades(top - span, top).map((value) => [y(value), power(value)]);
    grid(context, this.surface, rows, decades(left, right).map((value) => [x(value), `${power(value)} ${xUnit}`]));
    context.strokeStyle = cellColour(this.i % 3);
    context.beginPath();
    values.forEach((value, k) => context.lineTo(x(at[k]), y(value * unit)));
    [context.lineWidth, context.lineJoin] = [1.3, "bevel"];
    context.stroke();
    if (cursor === null) {
      const best = values.indexOf(Math.min(...visible));
      const strongest = peak ? `strongest ${fixed(peak.hz, 2)} Hz, ${engineering(peak.amplitude * unit, symbol)}` : "";
      const least = `least ${engineering(values[best] * unit, symbol)} at ${engineering(at[best], "s")}`;
      write(this.#value, mode === "spectrum" ? strongest : least);
      return;
    }
    const here = 10 ** (left + cursor * (right - left));
    const k = at.reduce((best, value, j) => (Math.abs(value - here) < Math.abs(at[best] - here) ? j : best), 0);
    line(context, x(at[k]), height - FOOT, colours.ink);
    dot(context, x(at[k]), y(values[k] * unit));
    write(this.#value, `${engineering(values[k] * unit, symbol + per)} at ${engineering(at[k], xUnit)}`);
  }
}

/** The column under the crosshair, or the newest; and the range of all of quantity `i`. */
function readAt({ size, count, low, high }, i, cursor) {
  let [least, greatest, last] = [Infinity, -Infinity, -1];
  for (let c = 0; c < size; c++) {
    if (!count[c]) continue;
    [least, greatest, last] = [Math.min(least, low[6 * c + i]), Math.max(greatest, high[6 * c + i]), c];
  }
  if (cursor !== null && last >= 0) {
    // Where bins are wider than columns, that of the bin; not across a gap.
    const middle = Math.min(Math.floor(cursor * size), size - 1);
    for (let c = 0; c < size; c++) if (count[c] && Math.abs(c - middle) < Math.abs(last - middle)) last = c;
    if (Math.abs(last - middle) > Math.max(size / 20, 2)) last = -1;
  }
  return { at: last, range: least <= greatest ? [least, greatest] : null };
}

/** Mean and σ in a column, and with the crosshair the range of the poses in it. */
function reading({ mean, low, high, sigma, count }, i, c, factor, decimals, isPointed) {
  const of = (values, plus) => fixed(values[6 * c + i] * factor, decimals, { plus });
  const range = isPointed && count[c] > 1 ? `  [${of(low, true)} … ${of(high, true)}]` : "";
  return `${of(mean, true)} ± ${of(sigma, false)}${range}`;
}

function curve(context, columns, i, x, y, colour) {
  const { size, count, start_s, end_s, mean, low, high, sigma, isBroken } = columns;
  /** Columns that are joined: start, end, and y of the mean and both extremes. */
  const runs = [];
  let [filled, wandered, noise] = [0, 0, 0];
  for (let c = 0; c < size; c++) {
    if (!count[c]) continue;
    if (isBroken[c] || runs.length === 0) runs.push([]);
    const k = 6 * c + i;
    const point = [x(start_s[c]), Math.max(x(end_s[c]), x(start_s[c]) + 1), y(mean[k]), y(high[k]), y(low[k])];
    const before = runs.at(-1).at(-1);
    filled += point[4] - point[3];
    noise += y(0) - y(sigma[k]);
    if (before) wandered += Math.abs(point[2] - before[2]);
    runs.at(-1).push(point);
  }
  const isArea = filled > 2 * wandered && filled > 8 * runs.flat().length;
  // The mean of some periods of a motion says nothing; that of noise does.
  const hasMean = !isArea || filled < 20 * noise;
  [context.lineJoin, context.fillStyle, context.strokeStyle] = ["bevel", colour, colour];
  for (const run of runs) {
    // Rectangles of whole pixels: a polygon with so many corners would cost ten times as much.
    run.forEach(([start, end, , ...extremes], k) => {
      // Columns of half a period hold the crest or the trough: three of them hold both.
      const near = hasMean ? [extremes] : run.slice(Math.max(k - 1, 0), k + 2).map((point) => point.slice(3));
      const [top, bottom] = [Math.min(...near.map(([y]) => y)), Math.max(...near.map(([, y]) => y))];
      const [left, width] = [Math.round(start), Math.max(Math.round(end) - Math.round(start), 1)];
      context.globalAlpha = isArea ? 0.5 : 0.3;
      context.fillRect(left, top, width, bottom - top);
      if (!isArea) return;
      context.globalAlpha = 1;
      context.fillRect(left, top, width, 1);
      context.fillRect(left, bottom - 1, width, 1);
    });
    if (!hasMean) continue;
    context.beginPath();
    if (run.length === 1) context.moveTo(run[0][0], run[0][2]);
    for (const [start, end, middle] of run) context.lineTo(run.length === 1 ? end : (start + end) / 2, middle);
    [context.globalAlpha, context.lineWidth] = isArea ? [0.6, 1] : [1, 1.5];
    context.stroke();
  }
  context.globalAlpha = 1;
}

function grid(context, { width, height }, rows, columns) {
  context.font = "10px system-ui, sans-serif";
  [context.textAlign, context.textBaseline] = ["right", "middle"];
  for (const [y, text] of rows) {
    context.fillStyle = colours.pale;
    context.fillRect(GUTTER, Math.round(y), width - GUTTER, 1);
    context.fillStyle = colours.soft;
    context.fillText(text, GUTTER - 5, Math.min(Math.max(y, 6), height - FOOT - 4));
  }
  context.textBaseline = "bottom";
  for (const [x, text] of columns) {
    context.fillStyle = colours.faint;
    context.fillRect(Math.round(x), 0, 1, height - FOOT);
    context.fillStyle = colours.soft;
    const half = context.measureText(text).width / 2;
    context.textAlign = "center";
    context.fillText(text, Math.min(Math.max(x, GUTTER + half), width - half), height);
  }
}

function line(context, x, height, colour) {
  context.fillStyle = colour;
  context.fillRect(Math.round(x), 0, 1, height);
}

function dot(context, x, y) {
  context.beginPath();
  context.arc(x, y, 3, 0, 2 * Math.PI);
  context.fill();
}

function words(context, { width, height }, text) {
  context.fillStyle = colours.soft;
  [context.font, context.textAlign, context.textBaseline] = ["12px system-ui, sans-serif", "center", "middle"];
  context.fillText(text, (GUTTER + width) / 2, (height - FOOT) / 2);
}

/** The scale of an axis, with so many lines: grows at once, shrinks when the values fill a third of it, so that it does not breathe. */
function fit(scale, range, least, lines) {
  if (!range) return scale ?? { low: -1, high: 1, tick: 1 };
  const [low, high] = range;
  const span = Math.max((high - low) * 1.15, least);
  const fits = scale && low >= scale.low && high <= scale.high && span > (scale.high - scale.low) / 3;
  const middle = (low + high) / 2;
  const { low: from, high: to } = fits ? scale : { low: middle - span * 0.54, high: middle + span * 0.54 };
  return { low: from, high: to, tick: 10 / roundDown((10 * lines) / (to - from)) };
}

/** A power of ten, in words. */
function power(value) {
  const exponent = String(Math.round(Math.log10(value)));
  return `10${exponent.replace(/./g, (letter) => "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"["0123456789-".indexOf(letter)])}`;
}

/** Multiples of `step` within a range. */
function steps(from, to, step) {
  const first = Math.ceil(from / step - 1e-9);
  return Array.from({ length: Math.max(Math.floor(to / step + 1e-9) - first + 1, 0) }, (_, k) => (first + k) * step);
}

/** The next larger step of a clock: 1, 2 or 5 times a power of ten below a minute. */
function roundUp(step_s, span_s) {
  const clock = span_s > 60 ? [10, 20, 30, 60, 120, 300] : [];
  return clock.find((step) => step >= step_s) ?? 10 / roundDown(10 / step_s);
}

/** Seconds before now, as precise as `step_s` asks for. */
export function ago(seconds, step_s) {
  return `${fixed(seconds, Math.max(0, Math.min(3, -Math.floor(Math.log10(step_s) + 1e-9))))} s`;
}
