/**
 * The camera of the 3-D view: where it stands, and where a point of the base frame lands on the canvas.
 *
 * It orbits a target. Azimuth and elevation are in radians; z of the base frame points up. Pure: it knows no canvas.
 */
import { add, along, cross, dot, scale, sub } from "./vectors.js";

/** Half the angle of view: long, so that lengths compare. */
const TAN_HALF_VIEW = Math.tan((24 / 2) * (Math.PI / 180));
/** Heads are flatter than the sphere around them, so their views may be cut above and below. */
const FLATNESS = 1.2;
const HOME = {
  iso: [-0.9, 0.5],
  top: [-Math.PI / 2, Math.PI / 2],
  front: [-Math.PI / 2, 0],
  side: [0, 0],
};

export class Camera {
  /** @param {number} radius_m of the sphere that a home view shows */
  constructor(radius_m = 0.03) {
    this.width = this.height = 1;
    this.frame(radius_m);
  }

  /** Shows all within `radius_m` of the origin, from the side `view`. */
  frame(radius_m, view = "iso") {
    this.radius_m = radius_m;
    this.target = [0, 0, 0];
    [this.azimuth, this.elevation] = HOME[view];
    this.distance = (radius_m / TAN_HALF_VIEW) * 1.2;
    this.#turn();
  }

  home(view) {
    this.frame(this.radius_m, view);
  }

  resize(width, height) {
    [this.width, this.height] = [width, height];
    this.#turn();
  }

  orbit(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, -Math.PI / 2), Math.PI / 2);
    this.#turn();
  }

  /** Moves the scene by pixels on the canvas. */
  pan(dx, dy) {
    this.target = add(this.target, this.inView(-dx, -dy, this.target));
    const far = Math.hypot(...this.target) / (4 * this.radius_m);
    if (far > 1) this.target = scale(this.target, 1 / far);
    this.#turn();
  }

  zoom(factor) {
    const [near, far] = [0.2 * this.radius_m, 40 * this.radius_m];
    this.distance = Math.min(Math.max(this.distance / factor, near), far);
    this.#turn();
  }

  #turn() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    /** Towards the viewer; right and up on the canvas. */
    this.back = [ca * ce, sa * ce, se];
    this.right = [-sa, ca, 0];
    this.up = cross(this.back, this.right);
    this.eye = along(this.target, this.back, this.distance);
    this.focal = Math.min(this.width, this.height * FLATNESS) / 2 / TAN_HALF_VIEW;
  }

  /**
   * @param {number[]} p base frame
   * @returns {number[]} x, y in pixels from the upper left, and the depth in metres; null behind the camera
   */
  project(p) {
    const d = sub(p, this.eye);
    const depth = -dot(d, this.back);
    if (depth < this.distance * 0.02) return null;
    const f = this.focal / depth;
    return [this.width / 2 + dot(d, this.right) * f, this.height / 2 - dot(d, this.up) * f, depth];
  }

  /** The vector of the base frame that dx, dy pixels on the canvas are at the depth of `p`. */
  inView(dx, dy, p) {
    const metres = -dot(sub(p, this.eye), this.back) / this.focal;
    return add(scale(this.right, dx * metres), scale(this.up, -dy * metres));
  }

  /** The rotation vector of a ball turned by dx, dy pixels; half the canvas is one radian and a half. */
  inBall(dx, dy) {
    const angle = 3 / Math.min(this.width, this.height);
    return add(scale(this.up, dx * angle), scale(this.right, dy * angle));
  }

  /** Pixels a metre at the target. */
  get pixelsPerMetre() {
    return this.focal / this.distance;
  }
}

/** The greatest of 1, 2, 5 × 10^k that is at most `value`. */
export function roundDown(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const digit = value / power;
  return (digit >= 5 ? 5 : digit >= 2 ? 2 : 1) * power;
}

/** The convex hull of points on the canvas, in order around it (Andrew's monotone chain). */
export function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (list) => {
    const chain = [];
    for (const p of list) {
      while (chain.length > 1 && turn(chain.at(-2), chain.at(-1), p) <= 0) chain.pop();
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return sorted.length < 3 ? sorted : [...half(sorted), ...half(sorted.reverse())];
}

const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
