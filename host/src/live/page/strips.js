/**
 * One strip a detector: where the light is and where the model puts it, both photocurrents, state, and findings.
 */
import { make, show, Surface, write } from "./dom.js";
import { CELL_STATES, fixed } from "./format.js";
import { cellColour, cellDash, colours } from "./palette.js";

const SIGNS = new Map(CELL_STATES.map(([name, sign, grade]) => [name, { sign, grade }]));
/** Left and right of the detector, for the numbers of the electrodes. */
const MARGIN = 14;
const GRADES = ["bad", "warn", "good"];

export class Strips {
  #strips = [];

  constructor(container, changed) {
    this.container = container;
    this.changed = changed;
  }

  setHead(head) {
    const longest_m = Math.max(...(head?.cells ?? []).map(({ detector }) => detector.length_m));
    this.#strips = (head?.cells ?? []).map((cell, k) => new Strip(cell, k, longest_m, this.changed));
    this.container.replaceChildren(...this.#strips.map((strip) => strip.element));
  }

  /** @param {object | undefined} frame */
  draw(frame) {
    this.#strips.forEach((strip, k) => strip.draw(frame?.cells[k]));
  }

  /** @param {{fault: object | string, text: string}[]} findings of the head @param {object[]} cells their health */
  setHealth(findings, cells) {
    this.#strips.forEach((strip, k) => {
      strip.setDrift(cells[k]);
      strip.setFinding(findings.filter(({ fault }) => concerns(fault, k)).map(({ text }) => text).join(" "));
    });
  }
}

/** Whether a fault of `boards[].head.findings` is that of cell `k`. */
export function concerns(fault, k) {
  const { cell, exchange, calibration_stale: stale } = fault;
  return [cell?.cell, exchange?.electrodes?.cell, ...(exchange?.cells?.cells ?? []), stale?.cell].includes(k);
}

class Strip {
  #canvas = make("canvas");
  #states = make("span", "states");
  #place = make("span", "number");
  #drift = make("span", "drift");
  #finding = make("p", "finding");
  #shown = null;
  /** The colour of the swatch: themes differ. */
  #swatched = "";

  constructor(cell, k, longest_m, changed) {
    [this.cell, this.k, this.longest_m] = [cell, k, longest_m];
    const note = cell.second_axis_of == null ? "" : ` (across ${cell.second_axis_of})`;
    const swatch = make("canvas", "swatch");
    swatch.width = swatch.height = 12;
    this.swatch = swatch.getContext("2d");
    this.#finding.hidden = true;
    const title = make("h3", "", swatch, ` cell ${k}${note}`);
    const top = make("div", "row", title, this.#place);
    const state = make("div", "row", this.#states, this.#drift);
    this.#drift.title = "What its emitter deviates from the common light level, as the tool's motion has told";
    this.element = make("article", "strip", top, state, this.#canvas, this.#finding);
    this.#canvas.setAttribute("aria-hidden", "true");
    this.surface = new Surface(this.#canvas, changed);
  }

  setDrift({ emitter_drift: drift, emitter_drift_sigma: sigma } = {}) {
    const percent = (value, options) => fixed(value * 100, 2, options);
    write(this.#drift, drift == null ? "" : `emitter ${percent(drift, { plus: true })} ± ${percent(sigma)} %`);
  }

  setFinding(text) {
    write(this.#finding, text);
    show(this.#finding, text !== "");
  }

  draw(reading) {
    this.#writeStates(reading?.state ?? ["missing"]);
    write(this.#place, reading?.x_m == null ? "– mm" : `${fixed(reading.x_m * 1e3, 3, { plus: true })} mm`);
    const context = this.surface.start();
    if (!context) return;
    const width = this.surface.width - 2 * MARGIN;
    const scale = width / this.longest_m;
    const middle = MARGIN + width / 2;
    this.#drawDetector(context, reading, (x_m) => middle + x_m * scale);
    this.#drawCurrents(context, reading, width);
    const colour = cellColour(this.k);
    if (this.#swatched === colour) return;
    this.#swatched = this.swatch.fillStyle = colour;
    this.swatch.fillRect(0, 0, 12, 12);
  }

  #drawDetector(context, reading, at) {
    const { length_m } = this.cell.detector;
    const colour = cellColour(this.k);
    const [left, right] = [at(-length_m / 2), at(length_m / 2)];
    context.fillStyle = colours.faint;
    context.fillRect(left, 8, right - left, 12);
    if (reading?.spot_m) {
      const [from, to] = reading.spot_m.map((x) => Math.min(Math.max(at(x), left - 6), right + 6));
      context.fillStyle = colour;
      context.globalAlpha = 0.45;
      context.fillRect(from, 8, Math.max(to - from, 1), 12);
      context.globalAlpha = 1;
    }
    context.strokeStyle = colour;
    context.lineWidth = 1.5;
    context.setLineDash(cellDash(this.k));
    context.strokeRect(left, 8, right - left, 12);
    context.setLineDash([]);
    context.fillStyle = colours.soft;
    context.fillRect(at(0) - 0.5, 18, 1, 4);
    if (reading?.expected_x_m != null) {
      const x = at(reading.expected_x_m);
      context.fillStyle = colours.soft;
      context.beginPath();
      context.moveTo(x - 4, 1);
      context.lineTo(x + 4, 1);
      context.lineTo(x, 7);
      context.fill();
    }
    if (reading?.x_m != null) {
      context.fillStyle = colours.ink;
      context.fillRect(at(reading.x_m) - 1, 5, 2, 18);
    }
    context.fillStyle = colours.soft;
    context.font = "10px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "right";
    context.fillText("1", left - 4, 14);
    context.textAlign = "left";
    context.fillText("2", right + 4, 14);
  }

  #drawCurrents(context, reading, width) {
    const { full_scale_a: full, faint_a: faint } = this.cell.detector;
    [0, 1].forEach((electrode) => {
      const y = 27 + 10 * electrode;
      context.fillStyle = colours.faint;
      context.fillRect(MARGIN, y, width, 7);
      const share = Math.min(Math.max((reading?.i_a?.[electrode] ?? 0) / full, 0), 1);
      context.fillStyle = share > 0.98 ? colours.bad : colours.soft;
      context.fillRect(MARGIN, y, share * width, 7);
      context.fillStyle = colours.soft;
      context.textAlign = "right";
      context.fillText(`${electrode + 1}`, MARGIN - 4, y + 4);
    });
    // Below this, both together are too faint.
    context.fillStyle = colours.warn;
    context.fillRect(MARGIN + Math.min(faint / full, 1) * width, 25, 1, 21);
  }

  #writeStates(states) {
    const key = states.join();
    if (key === this.#shown) return;
    this.#shown = key;
    const known = CELL_STATES.map(([name]) => name).filter((name) => states.includes(name));
    if (known.length === 0) known.push("not used");
    this.#states.replaceChildren(
      ...known.map((name) => {
        const { sign, grade } = SIGNS.get(name) ?? { sign: "–", grade: "warn" };
        const mark = make("span", "", sign);
        mark.setAttribute("aria-hidden", "true");
        return make("span", `state ${grade}`, mark, ` ${name}`);
      }),
    );
    const grades = known.map((name) => SIGNS.get(name)?.grade ?? "warn");
    this.element.dataset.grade = GRADES.find((grade) => grades.includes(grade));
  }
}
