/**
 * Source "scene": the accuracy of the position over a plane of the workspace, through the tool as it is placed.
 */
import { byId, show, write } from "./dom.js";

/** From best to worst: light to dark blue, told apart without hues. */
const RAMP = [[255, 255, 217], [161, 218, 180], [65, 182, 196], [34, 94, 168], [8, 29, 88]];
/** The worst hundredth of the places has the darkest colour: at the edge, σ may grow without limit. */
const WORST_SHARE = 0.99;
const AGAIN_MS = 300;

const um = (metres) => `${(metres * 1e6).toPrecision(3)} µm`;
const mm = (metres) => (metres * 1e3).toFixed(2);

export class AccuracyMap {
  #map = null;
  #timer = 0;
  #isUnanswered = false;

  /** @param {(request: object) => boolean} send @param {() => {t_m: number[], r_rad: number[]}} place */
  constructor(send, place) {
    [this.send, this.place] = [send, place];
    byId("map").addEventListener("toggle", () => this.#ask());
    byId("map-plane").addEventListener("change", () => this.#ask());
    byId("map-picture").addEventListener("pointermove", (event) => this.#point(event));
    byId("map-picture").addEventListener("pointerleave", () => this.#say());
    byId("map-ramp").style.background = `linear-gradient(to right, ${RAMP.map((colour) => `rgb(${colour})`)})`;
  }

  /** The tool or the head is another; asked for once it rests. */
  changed() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#ask(), AGAIN_MS);
  }

  /** The connection is gone, or refused the last request. */
  answered() {
    this.#isUnanswered = false;
  }

  #ask() {
    if (!byId("map").open) return;
    if (this.#isUnanswered) return this.changed();
    this.#isUnanswered = this.send({ kind: "map", plane: byId("map-plane").value, ...this.place() });
  }

  take(map) {
    this.#isUnanswered = false;
    if (map.plane !== byId("map-plane").value) return this.#ask();
    const known = map.sigma_m.filter((sigma) => sigma !== null).sort((a, b) => a - b);
    this.#map = { ...map, least: known[0], most: known[Math.floor(WORST_SHARE * (known.length - 1))], known };
    this.#draw();
    this.#say();
  }

  #draw() {
    const { points, sigma_m, least, most, known } = this.#map;
    const picture = byId("map-picture");
    [picture.width, picture.height] = [points, points];
    const image = new ImageData(points, points);
    sigma_m.forEach((sigma, i) => {
      if (sigma === null) return;
      const share = most > least ? Math.min((sigma - least) / (most - least), 1) * (RAMP.length - 1) : 0;
      const [step, part] = [Math.min(Math.floor(share), RAMP.length - 2), share - Math.min(Math.floor(share), RAMP.length - 2)];
      // Rows go up, as the axis does.
      const at = 4 * ((points - 1 - Math.floor(i / points)) * points + (i % points));
      for (let c = 0; c < 3; c++) image.data[at + c] = RAMP[step][c] + part * (RAMP[step + 1][c] - RAMP[step][c]);
      image.data[at + 3] = 255;
    });
    picture.getContext("2d").putImageData(image, 0, 0);
    show(byId("map-scale"), known.length > 0);
    write(byId("map-least"), known.length ? um(least) : "");
    write(byId("map-most"), known.length ? um(most) : "");
  }

  #say() {
    if (!this.#map) return;
    const { plane, half_m, known, sigma_m } = this.#map;
    const [across, up] = plane;
    const area = `${across} ±${mm(half_m[0])} mm, ${up} ±${mm(half_m[1])} mm`;
    const median = known.length ? `median ${um(known[known.length >> 1])}` : "no pose, or no noise in the scene";
    const without = known.length && known.length < sigma_m.length ? "; empty: no pose" : "";
    write(byId("map-words"), `σ of the position, ${area}: ${median}${without}`);
  }

  #point({ offsetX, offsetY, target }) {
    if (!this.#map) return;
    const { plane, half_m, points, sigma_m } = this.#map;
    const index = (offset, size) => Math.min(Math.max(Math.floor((offset / size) * points), 0), points - 1);
    const [column, row] = [index(offsetX, target.clientWidth), points - 1 - index(offsetY, target.clientHeight)];
    const sigma = sigma_m[row * points + column];
    const [u, v] = [column, row].map((at, axis) => mm(half_m[axis] * ((2 * at) / (points - 1) - 1)));
    write(byId("map-words"), `${plane[0]} ${u} mm, ${plane[1]} ${v} mm: ${sigma === null ? "no pose" : `σ ${um(sigma)}`}`);
  }
}
