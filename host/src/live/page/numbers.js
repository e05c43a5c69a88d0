/**
 * The pose in numbers: six coordinates with σ and velocity, the outcome in words, and what it rests on.
 */
import { byId, make, show, write } from "./dom.js";
import { COORDINATES, fixed, STATUS, UNITS, VERIFIED } from "./format.js";
import { angleBetween, coordinates, norm, sub } from "./vectors.js";

/** Why a pose has no velocity. */
const NO_TWIST = { start: "withheld: too few poses yet", jump: "withheld: the tool is not where its motion led" };
const OUTCOME_SIGNS = { converged: ["✓", "good"], degraded: ["▽", "warn"] };

export class Numbers {
  #rows;
  #facts;

  constructor() {
    this.#rows = COORDINATES.map((name, i) => {
      const cells = [0, 1, 2].map((c) => make("td", c === 2 ? "number measured" : "number", "–"));
      const head = make("th", "", name, make("span", "unit", i < 3 ? " mm" : " °"));
      head.scope = "row";
      byId("pose").tBodies[0].append(make("tr", "", head, ...cells));
      return cells;
    });
    this.#facts = facts(byId("pose-facts"), ["Verified", "χ² / redundancy", "Frame", "Light level", "Velocity", "Error", "Filtered", "Board time", "Scan", "Scans in frame"]);
  }

  /** @param {object | undefined} frame @param {boolean} isScene whether the tool is placed by hand */
  draw(frame, isScene) {
    const pose = frame?.t_m && frame.q_xyzw ? frame : null;
    const values = pose ? coordinates(pose) : null;
    this.#rows.forEach(([value, sigma, velocity], i) => {
      const unit = UNITS[i];
      write(value, fixed(values && values[i] / unit, i < 3 ? 3 : 2, { plus: true }));
      const sigma_text = frame?.sigma ? fixed(frame.sigma[i] / unit, 4) : "–";
      write(sigma, sigma_text);
      write(velocity, fixed(frame?.twist && frame.twist[i] / unit, 1, { plus: true }));
    });
    const [sign, grade] = frame ? (OUTCOME_SIGNS[frame.status] ?? ["✕", "bad"]) : ["–", ""];
    write(byId("outcome-sign"), sign);
    byId("outcome").dataset.grade = grade;
    const reason = frame?.reason ? ` (${frame.reason})` : "";
    write(byId("outcome-words"), frame ? (STATUS[frame.status] ?? frame.status) + reason : "no scan yet");
    const chi2 = frame?.chi2 == null ? "–" : `${fixed(frame.chi2, 1)} / ${frame.redundancy}`;
    this.#facts({
      "Verified": (pose && VERIFIED[frame.verified]) ?? "–",
      "χ² / redundancy": chi2,
      "Frame": frame?.frame ?? null,
      "Light level": frame?.light_level == null ? null : `${fixed(frame.light_level * 100, 2)} %`,
      "Velocity": NO_TWIST[frame?.no_twist] ?? null,
      "Error": pose && frame.truth ? errorOf(pose, frame.truth) : null,
      "Filtered": frame?.filtered ? filtered(frame.filtered) : null,
      "Board time": isScene ? null : `${fixed(frame?.time_s, 2)} s`,
      "Scan": isScene ? null : String(frame?.seq ?? "–"),
      "Scans in frame": isScene ? null : frame ? `${frame.scans}, ${frame.poses} with a pose` : "–",
    });
  }
}

const errorOf = (pose, truth) =>
  `${fixed(norm(sub(pose.t_m, truth.t_m)) * 1e6, 1)} µm, ${fixed(angleBetween(pose.q_xyzw, truth.q_xyzw) * 1e3, 2)} mrad from the true pose`;

function filtered({ t_m, lag_s }) {
  return `${t_m.map((v) => fixed(v * 1e3, 3, { plus: true })).join(" ")} mm, ${fixed(lag_s * 1e3, 1)} ms late`;
}

/** A list of facts in fixed places: the function returned writes them, and hides those that are null. */
export function facts(list, names) {
  const places = new Map(
    names.map((name) => {
      const [term, text] = [make("dt", "", name), make("dd", "number", "–")];
      list.append(term, text);
      return [name, [term, text]];
    }),
  );
  return (values) => {
    for (const [name, value] of Object.entries(values)) {
      const [term, text] = places.get(name);
      show(term, value != null);
      show(text, value != null);
      if (value != null) write(text, value);
    }
  };
}
