/**
 * Six scrolling plots: a coordinate of the pose or the velocity, its envelope between frames, and gaps without a pose.
 *
 * A plot is drawn again only when a pixel column is complete, so a wide time span costs little.
 */
import { make, Surface, write } from "./dom.js";
import { COORDINATES, fixed, UNITS } from "./format.js";
import { Columns, poseValues, twistValues } from "./history.js";
import { cellColour, colours } from "./palette.js";
import { roundDown } from "./camera.js";

const QUANTITIES = {
  pose: { read: poseValues, units: ["mm", "mm", "mm", "°", "°", "°"], least: 0.02 },
  twist: { read: twistValues, units: ["mm/s", "mm/s", "mm/s", "°/s", "°/s", "°/s"], least: 2 },
};
const GUTTER = 46;
const FOOT = 14;
/** The line is broken where frames are farther apart: six of sixty a second. */
const LONGEST_BETWEEN_S = 0.1;

export class Plots {
  #plots;
  #columns = null;
  #drawn = "";
  #changes = 0;
  quantity = "pose";
  span_s = 10;

  constructor(container, changed) {
    this.#plots = COORDINATES.map((name, i) => new Plot(name, i, () => this.redraw(changed)));
    container.append(...this.#plots.map((plot) => plot.element));
  }

  /** Draws all again at the next frame: theme, size, or choice have changed. */
  redraw(changed) {
    this.#changes++;
    changed?.();
  }

  /** @param {import("./history.js").History} history @param {number} index in it of the frame shown */
  draw(history, index) {
    const last = history.last;
    const { read, units, least } = QUANTITIES[this.quantity];
    const width = Math.max(this.#plots[0].surface.width - GUTTER, 1);
    const step_s = this.span_s / width;
    if (this.#columns?.step_s !== step_s || this.#columns.read !== read) this.#columns = new Columns(step_s, read);
    const to = last ? Math.floor(last.time_s / step_s) : 0;
    const from = to - Math.floor(width) + 1;
    const oldest = last ? Math.floor((last.time_s - history.span_s) / step_s) : 0;
    this.#columns.update(history, Math.min(from, oldest));
    const marked = index < history.length - 1 ? history.at(index) : null;
    const key = [this.#changes, this.quantity, step_s, to, history.epoch, marked?.n].join();
    if (key === this.#drawn) return;
    this.#drawn = key;
    const cursor = marked ? marked.time_s / step_s - from : null;
    const values = marked ?? last;
    const now = values && read(values)?.value;
    this.#plots.forEach((plot, i) => {
      plot.draw({ columns: this.#columns, from, to, cursor, unit: units[i], least, span_s: this.span_s, now: now?.[i] });
    });
  }
}

class Plot {
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

  draw({ columns, from, to, cursor, unit, least, span_s, now }) {
    const factor = 1 / UNITS[this.i];
    write(this.#title, `${this.name}, ${unit}`);
    const context = this.surface.start();
    if (!context) return;
    const { width, height } = this.surface;
    const range = columns.range(this.i, from, to);
    this.#scale = fit(this.#scale, range?.map((v) => v * factor), least);
    const { low, high, tick } = this.#scale;
    const decimals = Math.max(0, -Math.floor(Math.log10(tick) + 1e-9));
    write(this.#value, now == null ? "–" : fixed(now * factor, unit.endsWith("/s") ? 1 : 3, { plus: true }));
    const y = (v) => 4 + ((high - v) / (high - low)) * (height - FOOT - 8);
    this.#grid(context, { low, high, tick, decimals, y, width, height, span_s });
    const x = (k) => GUTTER + (k - from) * ((width - GUTTER) / (to - from + 1));
    const colour = cellColour(this.i % 3);
    curve(context, columns, { from, to, x, y: (v) => y(v * factor), i: this.i, colour });
    if (range === null) {
      context.fillStyle = colours.soft;
      [context.textAlign, context.textBaseline] = ["center", "middle"];
      context.fillText(unit.endsWith("/s") ? "no velocity" : "no pose", (GUTTER + width) / 2, (height - FOOT) / 2);
    }
    if (cursor != null) {
      context.fillStyle = colours.ink;
      context.fillRect(GUTTER + cursor, 0, 1, height - FOOT);
    }
  }

  #grid(context, { low, high, tick, decimals, y, width, height, span_s }) {
    context.font = "10px system-ui, sans-serif";
    [context.textAlign, context.textBaseline] = ["right", "middle"];
    for (let v = Math.ceil(low / tick) * tick; v <= high + 1e-9 * tick; v += tick) {
      context.fillStyle = colours.pale;
      context.fillRect(GUTTER, Math.round(y(v)), width - GUTTER, 1);
      context.fillStyle = colours.soft;
      context.fillText(fixed(v, decimals), GUTTER - 4, y(v));
    }
    context.textBaseline = "bottom";
    for (const [share, align] of [[0, "left"], [0.5, "center"], [1, "right"]]) {
      context.textAlign = align;
      const ago_s = span_s * (1 - share);
      context.fillText(ago_s === 0 ? "0 s" : fixed(-ago_s, 0), GUTTER + share * (width - GUTTER), height);
    }
  }
}

/** The scale of an axis: grows at once, shrinks when the values fill a third of it, so that it does not breathe. */
export function fit(scale, range, least) {
  if (!range) return scale ?? { low: -1, high: 1, tick: 1 };
  const [low, high] = range;
  const span = Math.max((high - low) * 1.15, least);
  if (scale && low >= scale.low && high <= scale.high && span > (scale.high - scale.low) / 3) return scale;
  const middle = (low + high) / 2;
  const tick = roundDown(span / 2);
  return { low: middle - span * 0.54, high: middle + span * 0.54, tick };
}

function curve(context, columns, { from, to, x, y, i, colour }) {
  context.fillStyle = colour;
  context.globalAlpha = 0.35;
  for (let k = from; k <= to; k++) {
    const column = columns.at(k);
    if (!column?.low) continue;
    const [top, bottom] = [y(column.high[i]), y(column.low[i])];
    if (bottom - top > 1) context.fillRect(x(k), top, 1.2, bottom - top);
  }
  context.globalAlpha = 1;
  context.beginPath();
  // A column may be shorter than the time between frames; longer times without frames are gaps, too.
  const longest = Math.max(LONGEST_BETWEEN_S / columns.step_s, 1);
  let [isDown, before] = [false, from];
  for (let k = from; k <= to; k++) {
    const column = columns.at(k);
    if (!column) continue;
    if (k - before > longest) isDown = false;
    before = k;
    if (column.value) {
      if (isDown) context.lineTo(x(k), y(column.value[i]));
      else context.moveTo(x(k), y(column.value[i]));
    }
    isDown = Boolean(column.value) && !column.hasGap;
  }
  [context.strokeStyle, context.lineWidth, context.lineJoin] = [colour, 1.4, "bevel"];
  context.stroke();
}
