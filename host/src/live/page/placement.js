/**
 * Source "scene": the tool is placed by hand, and the daemon says how exactly it would be measured there.
 */
import { byId, make } from "./dom.js";
import { COORDINATES, UNITS } from "./format.js";
import { add, multiply, quaternion, rotationVector } from "./vectors.js";

export class Placement {
  /** Translation in metres, rotation vector in radians. */
  #values = [0, 0, 0, 0, 0, 0];
  #limits = [0, 0, 0, 0, 0, 0];
  #isUnanswered = false;
  #isChanged = false;
  #rows = [];

  /** @param {(request: object) => boolean} send @param {() => void} changed */
  constructor(send, changed) {
    [this.send, this.changed] = [send, changed];
    this.#rows = COORDINATES.map((name, i) => this.#row(name, i));
    byId("sliders").append(...this.#rows.map(({ element }) => element));
    byId("tool-home").addEventListener("click", () => this.#set([0, 0, 0, 0, 0, 0]));
  }

  #row(name, i) {
    const unit = i < 3 ? "mm" : "°";
    const [slider, number] = ["range", "number"].map((type) => {
      const input = make("input");
      input.type = type;
      input.step = type === "range" ? "any" : i < 3 ? "0.01" : "0.1";
      input.setAttribute("aria-label", `${name}, ${unit}`);
      input.addEventListener("input", () => {
        const value = input.valueAsNumber;
        if (Number.isFinite(value)) this.#set(this.#values.with(i, value * UNITS[i]), input);
      });
      return input;
    });
    number.addEventListener("change", () => this.#write());
    return { slider, number, element: make("div", "row", make("span", "", `${name}, ${unit}`), slider, number) };
  }

  get pose() {
    return { t_m: this.#values.slice(0, 3), q_xyzw: quaternion(this.#values.slice(3)) };
  }

  /** Where the tool is, as requests have it. */
  get place() {
    return { t_m: this.#values.slice(0, 3), r_rad: this.#values.slice(3) };
  }

  /** Moves the tool by a vector of the base frame. */
  move(metres) {
    this.#set([...add(this.pose.t_m, metres), ...this.#values.slice(3)]);
  }

  /** Turns the tool about its origin by a rotation vector of the base frame. */
  turn(rotation) {
    this.#set([...this.#values.slice(0, 3), ...rotationVector(multiply(quaternion(rotation), this.pose.q_xyzw))]);
  }

  /** Takes the workspace of a head, and asks for the pose again: the head, or the connection, is new. */
  setHead({ workspace }) {
    this.#limits = [...workspace.half_extent_m, ...workspace.half_extent_rad];
    this.#isUnanswered = false;
    this.#set(this.#values);
  }

  /** The daemon has answered, or the connection is gone. */
  answered() {
    this.#isUnanswered = false;
    this.#ask();
  }

  #set(values, typed) {
    this.#values = values.map((v, i) => Math.min(Math.max(v, -this.#limits[i]), this.#limits[i]));
    this.#write(typed);
    this.#isChanged = true;
    this.#ask();
    this.changed();
  }

  #write(typed) {
    this.#rows.forEach((row, i) => {
      const limit = this.#limits[i] / UNITS[i];
      for (const input of [row.slider, row.number]) {
        [input.min, input.max, input.disabled] = [-limit, limit, limit === 0];
        if (input !== typed) input.value = (this.#values[i] / UNITS[i]).toFixed(i < 3 ? 3 : 2);
      }
    });
  }

  /** One request at a time; the newest pose goes next. */
  #ask() {
    if (this.#isUnanswered || !this.#isChanged) return;
    if (!this.send({ kind: "pose", ...this.place })) return;
    [this.#isUnanswered, this.#isChanged] = [true, false];
  }
}
