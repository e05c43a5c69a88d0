/**
 * The 3-D view: the head, the tool, the light between them, and how exactly the position is known.
 *
 * All is drawn as filled outlines on a 2-D canvas, the farthest first; a head has a few dozen.
 */
import { Camera, hull, roundDown } from "./camera.js";
import { make, show, Surface, write } from "./dom.js";
import { fixed, STATUS } from "./format.js";
import * as head3d from "./head.js";
import { cellColour, cellDash, colours } from "./palette.js";
import { add, along, angleBetween, dot, ellipsoid, norm, scale, sub, transform } from "./vectors.js";

const TRAIL_S = 2;
/** Of its parts, oldest first. */
const TRAIL_ALPHAS = [0.15, 0.3, 0.5, 0.8];
const ROUND = Array.from({ length: 33 }, (_, i) => [Math.cos((i * Math.PI) / 16), Math.sin((i * Math.PI) / 16)]);
const AXES = [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]];

/** The frame with pose and truth in front of the head, if its numbers are in a frame of the user. */
function inBase(frame) {
  if (!frame?.base) return frame;
  const { tool, truth, cov_t } = frame.base;
  return { ...frame, t_m: tool?.t_m, q_xyzw: tool?.q_xyzw, truth, cov_t };
}

export class View3d {
  #head = null;
  #second = new Map();
  #magnification = 1;
  #bar = make("span", "scale-bar");
  #barText = make("span");
  #words = make("span");

  constructor(canvas, words, notes, changed) {
    this.camera = new Camera();
    this.words = words;
    /** The circle on the canvas that turns the tool when dragged: [x, y, radius], or null. */
    this.ring = null;
    this.surface = new Surface(canvas, changed);
    notes.append(this.#bar, this.#barText, this.#words);
  }

  /** @param {object | null} head of a `head` message */
  setHead(head) {
    this.#head = head;
    if (!head) return;
    this.#second = head3d.secondAxes(head.cells);
    this.radius_m = head3d.radius(head);
    this.camera.frame(this.radius_m);
  }

  /**
   * @param {object | undefined} frame
   * @param {object} trail history, and the index in it of the frame shown
   * @param {object | null} placed the pose that the tool was dragged to, if it is dragged
   * @param {boolean} isWritten whether numbers are due, too
   */
  draw(frame, trail, placed, isWritten) {
    const context = this.surface.start();
    if (!context) return;
    this.camera.resize(this.surface.width, this.surface.height);
    frame = inBase(frame);
    const measured = frame?.t_m && frame.q_xyzw ? frame : null;
    const pose = measured ?? placed;
    this.#explain(frame, measured, placed);
    this.ring = null;
    if (!this.#head) return;
    const outlines = [];
    this.#addCells(outlines, frame, pose);
    if (pose) this.#addTool(outlines, pose, measured ? colours.tool : colours.warn);
    outlines.sort((a, b) => b.depth - a.depth);
    this.#axes(context);
    for (const outline of outlines) paint(context, outline);
    if (trail) this.#trail(context, trail);
    if (frame?.truth) this.#ghost(context, frame.truth);
    if (measured?.cov_t) this.#ellipsoid(context, measured);
    if (placed) this.#drawRing(context, pose);
    this.#labels(context);
    if (isWritten) this.#measure(frame, measured);
  }

  #project(points) {
    const all = points.map((p) => this.camera.project(p));
    return all.includes(null) ? null : all;
  }

  /** An outline of the base frame; `nearer` moves it in front of what lies in the same plane. */
  #add(outlines, points, style, { closed = true, nearer = 0, holes = [] } = {}) {
    const projected = this.#project(points);
    if (!projected) return;
    const depth = projected.reduce((sum, p) => sum + p[2], 0) / projected.length - nearer * this.radius_m;
    const rings = [projected, ...holes.map((hole) => this.#project(hole)).filter(Boolean)];
    outlines.push({ rings, depth, closed, ...style });
  }

  #addCells(outlines, frame, pose) {
    this.#head.cells.forEach((cell, k) => {
      if (cell.second_axis_of != null) return;
      const [colour, dash, reading] = [cellColour(k), cellDash(k), frame?.cells[k]];
      const { detector } = cell;
      this.#add(outlines, head3d.detectorOutline(detector), { fill: colour, alpha: 0.3, stroke: colour, line: 2, dash });
      const mask = head3d.placedMask(cell, pose);
      if (mask) {
        const { plate, hole } = head3d.maskOutlines(mask);
        const isLens = cell.opening.kind === "lens";
        this.#add(outlines, plate, { fill: colours.mask, alpha: 0.13, stroke: colours.mask, line: 1 }, { holes: [hole] });
        if (isLens) this.#add(outlines, hole, { fill: colours.accent, alpha: 0.25 }, { nearer: 0.001 });
      }
      const second = this.#second.get(k);
      const light = head3d.beam(cell, pose, reading, frame?.cells[second]);
      if (light) this.#addLight(outlines, light, colour);
      if (reading?.x_m == null) return;
      // Measured, it stands whether or not there is a pose.
      const marks = [[detector, reading.x_m]];
      if (frame.cells[second]?.x_m != null) marks.push([this.#head.cells[second].detector, frame.cells[second].x_m]);
      for (const [part, x_m] of marks) {
        this.#add(outlines, head3d.markAcross(part, x_m), { stroke: colours.ink, line: 1.5 }, { closed: false, nearer: 0.02 });
      }
    });
  }

  #addLight(outlines, { emitter, opening, spot }, colour) {
    const points = this.#project([emitter, ...spot]);
    if (!points) return;
    const depth = points.reduce((sum, p) => sum + p[2], 0) / points.length;
    const through = opening && this.#project(opening);
    const parts = through ? [[points[0], ...through], [...through, ...points.slice(1)]] : [points];
    for (const part of parts) {
      outlines.push({ rings: [hull(part)], depth, closed: true, fill: colour, alpha: 0.28 });
    }
    this.#add(outlines, spot, { fill: colour, alpha: 0.95 }, { nearer: 0.01 });
  }

  #addTool(outlines, pose, colour) {
    const size = this.radius_m * 0.022;
    const emitters = this.#project(this.#head.cells.map(({ emitter }) => transform(pose, emitter.position_m)));
    // A body between its emitters, behind its arms.
    const depth = emitters && emitters.reduce((sum, p) => sum + p[2], 0) / emitters.length + 0.05 * this.radius_m;
    if (emitters) outlines.push({ rings: [hull(emitters)], depth, closed: true, fill: colour, alpha: 0.22, stroke: colour, line: 1 });
    this.#head.cells.forEach((cell, k) => {
      if (cell.second_axis_of != null) return;
      const emitter = transform(pose, cell.emitter.position_m);
      this.#add(outlines, [pose.t_m, emitter], { stroke: colour, line: 3 }, { closed: false });
      const disc = head3d.emitterOutline(cell.emitter, pose, size);
      this.#add(outlines, disc, { fill: cellColour(k), alpha: 1, stroke: colours.ink, line: 1 }, { nearer: 0.01 });
    });
  }

  #ghost(context, truth) {
    context.save();
    context.setLineDash([3, 3]);
    for (const { emitter, second_axis_of } of this.#head.cells) {
      if (second_axis_of == null) this.#line(context, [truth.t_m, transform(truth, emitter.position_m)], colours.ink, 1);
    }
    context.restore();
  }

  #line(context, points, colour, width) {
    const projected = this.#project(points);
    if (projected) stroke(context, projected, colour, width);
  }

  #axes(context) {
    const length = this.radius_m * 0.3;
    for (const [name, direction] of AXES) {
      const end = scale(direction, length);
      this.#line(context, [[0, 0, 0], end], colours.soft, 1);
      const tip = this.camera.project(scale(direction, length * 1.12));
      if (tip) text(context, name, tip, colours.soft, 12);
    }
  }

  /** The way of the tool, older parts fainter. */
  #trail(context, { history, index }) {
    const end = history.at(index);
    if (!end) return;
    [context.strokeStyle, context.lineWidth] = [colours.accent, 1.2];
    for (let part = 0; part < TRAIL_ALPHAS.length; part++) {
      const [from_s, to_s] = [part, part + 1].map((k) => end.time_s - TRAIL_S * (1 - k / TRAIL_ALPHAS.length));
      context.beginPath();
      let isDown = false;
      for (let i = history.indexAt(from_s); i <= index && history.at(i).time_s <= to_s; i++) {
        const { t_m } = inBase(history.at(i));
        const point = t_m && this.camera.project(t_m);
        if (point && isDown) context.lineTo(point[0], point[1]);
        else if (point) context.moveTo(point[0], point[1]);
        isDown = Boolean(point);
      }
      context.globalAlpha = TRAIL_ALPHAS[part];
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  /** The outline that all its points have, to the viewer, and its three principal sections. */
  #ellipsoid(context, { t_m, cov_t }) {
    const axes = ellipsoid(cov_t);
    const longest = axes[0].length * this.#magnification;
    if (!(longest > 0.05 * this.radius_m && longest < 0.2 * this.radius_m)) {
      this.#magnification = axes[0].length > 0 ? Math.max(roundDown((0.15 * this.radius_m) / axes[0].length), 1) : 1;
    }
    const [a, b, c] = axes.map(({ length, direction }) => scale(direction, length * this.#magnification));
    const section = (u, v) => this.#project(ROUND.map(([p, q]) => add(t_m, along(scale(u, p), v, q))));
    const sections = [section(a, b), section(a, c), section(b, c)];
    const body = this.#project(this.#silhouette(t_m, [a, b, c]));
    if (!body || sections.includes(null)) return;
    fill(context, [body], colours.accent, 0.22);
    stroke(context, [...body, body[0]], colours.accent, 1.5);
    for (const ring of sections) stroke(context, ring, colours.accent, 0.7);
  }

  /** Points where the line of sight touches the ellipsoid with the semi-axes `axes`, seen from far away. */
  #silhouette(t_m, axes) {
    const toViewer = sub(this.camera.eye, t_m);
    const seen = axes.map((axis) => dot(axis, toViewer));
    const [u, v] = head3d.across(norm(seen) > 0 ? scale(seen, 1 / norm(seen)) : [0, 0, 1]);
    return ROUND.slice(1).map(([p, q]) => {
      const w = add(scale(u, p), scale(v, q));
      return axes.reduce((point, axis, i) => along(point, axis, w[i]), t_m);
    });
  }

  #drawRing(context, pose) {
    const centre = this.camera.project(pose.t_m);
    if (!centre) return;
    const reach = this.#head.cells.map(({ emitter }) => this.camera.project(transform(pose, emitter.position_m)));
    const far = Math.max(...reach.map((p) => (p ? Math.hypot(p[0] - centre[0], p[1] - centre[1]) : 0)));
    const radius = Math.min(Math.max(far * 1.2, 44), Math.min(this.surface.width, this.surface.height) * 0.42);
    this.ring = [centre[0], centre[1], radius];
    context.beginPath();
    context.arc(centre[0], centre[1], radius, 0, 2 * Math.PI);
    [context.strokeStyle, context.lineWidth, context.globalAlpha] = [colours.accent, 5, 0.35];
    context.stroke();
    context.globalAlpha = 1;
  }

  #labels(context) {
    this.#head.cells.forEach(({ detector, second_axis_of }, k) => {
      if (second_axis_of != null) return;
      const place = this.camera.project(along(detector.centre_m, detector.z, -0.12 * this.radius_m));
      const second = this.#second.get(k);
      if (place) text(context, second == null ? `${k}` : `${k}, ${second}`, place, colours.ink, 13, cellColour(k));
    });
  }

  /** Scale bar, magnification, error: in words under the view. */
  #measure(frame, measured) {
    const length_m = roundDown(110 / this.camera.pixelsPerMetre);
    this.#bar.style.width = `${(length_m * this.camera.pixelsPerMetre).toFixed(0)}px`;
    write(this.#barText, `${Number((length_m * 1e3).toPrecision(1))} mm`);
    const words = [];
    if (measured?.cov_t) words.push(`ellipsoid: 1 σ × ${this.#magnification}`);
    if (measured && frame.truth) {
      const error = norm(sub(measured.t_m, frame.truth.t_m));
      const turn = angleBetween(measured.q_xyzw, frame.truth.q_xyzw);
      words.push(`dashed: true pose, ${fixed(error * 1e6, 1)} µm and ${fixed(turn * 1e3, 2)} mrad away`);
    }
    write(this.#words, words.join(" · "));
  }

  #explain(frame, measured, placed) {
    let words = "";
    if (!this.#head) words = "No head yet: waiting for the geometry of the board.";
    else if (!frame) words = placed ? "" : "No scan yet.";
    else if (!measured) {
      const status = STATUS[frame.status] ?? frame.status;
      words = `${status[0].toUpperCase()}${status.slice(1)}${frame.reason ? ` (${frame.reason})` : ""}`;
    }
    show(this.words, words !== "");
    write(this.words, words);
  }
}

function trace(context, rings, closed) {
  context.beginPath();
  for (const ring of rings) {
    ring.forEach(([x, y], i) => (i === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
    if (closed) context.closePath();
  }
}

function paint(context, { rings, closed, fill: colour, alpha = 1, stroke: edge, line, dash }) {
  trace(context, rings, closed);
  if (colour) {
    [context.fillStyle, context.globalAlpha] = [colour, alpha];
    context.fill("evenodd");
    context.globalAlpha = 1;
  }
  if (!edge) return;
  [context.strokeStyle, context.lineWidth] = [edge, line];
  if (dash?.length) context.setLineDash(dash);
  context.stroke();
  if (dash?.length) context.setLineDash([]);
}

const fill = (context, rings, colour, alpha) => paint(context, { rings, closed: true, fill: colour, alpha });
const stroke = (context, points, colour, line) => paint(context, { rings: [points], closed: false, stroke: colour, line });

function text(context, words, [x, y], colour, size, background) {
  context.font = `600 ${size}px system-ui, sans-serif`;
  [context.textAlign, context.textBaseline] = ["center", "middle"];
  if (background) {
    context.strokeStyle = colours.panel;
    context.lineWidth = 4;
    context.strokeText(words, x, y);
  }
  context.fillStyle = colour;
  context.fillText(words, x, y);
}
