/**
 * Numbers and words as the page shows them: millimetres, degrees, microamperes. Pure.
 */

export const DEG = Math.PI / 180;
export const COORDINATES = ["x", "y", "z", "rx", "ry", "rz"];
/** Display units of the six coordinates. */
export const UNITS = [1e-3, 1e-3, 1e-3, DEG, DEG, DEG];

const MINUS = "\u2212";

/** A number of fixed decimals, with a true minus; a dash for none. */
export function fixed(value, decimals, { plus = false } = {}) {
  if (value == null || !Number.isFinite(value)) return "–";
  const text = Math.abs(value).toFixed(decimals);
  const sign = value < 0 && Number(text) !== 0 ? MINUS : plus ? "+" : "";
  return sign + text;
}

const STEPS = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];

/** A value with three digits and a prefix: 0.00123 s is "1.23 ms". */
export function engineering(value, unit) {
  if (value == null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return `0 ${unit}`;
  // A value that rounds up to 1000 of one step belongs to the next.
  const [step, prefix] = STEPS.find(([s]) => size >= s * 0.9995) ?? STEPS.at(-1);
  const scaled = size / step;
  const decimals = scaled >= 99.95 ? 0 : scaled >= 9.995 ? 1 : 2;
  return `${value < 0 ? MINUS : ""}${scaled.toFixed(decimals)} ${prefix}${unit}`;
}

/** A count with thin spaces between thousands. */
export function count(value) {
  return value == null ? "–" : String(Math.round(value)).replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");
}

export function bytes(value) {
  for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
    if (value >= size) return `${(value / size).toFixed(1)} ${unit}`;
  }
  return `${value ?? 0} B`;
}

/** Minutes and seconds: 75.25 is "1:15.3". */
export function clock(seconds) {
  const tenths = Math.abs(Math.round((seconds ?? 0) * 10));
  return `${seconds <= -0.05 ? MINUS : ""}${Math.floor(tenths / 600)}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
}

/** The outcomes of a solution, as people say them. */
export const STATUS = {
  converged: "converged",
  degraded: "degraded: from fewer cells, or with a larger error",
  ambiguous: "no pose: several fit",
  unobservable: "no pose: the cells with light do not fix it",
  too_dark: "no pose: too little light",
  diverged: "no pose: none fits the currents",
};

export const VERIFIED = {
  well: "well: an error in one cell would be noticed",
  weakly: "weakly: one cell could shift the pose unnoticed",
  not: "not: nothing is left over to check with",
};

/** The states of a cell, gravest first, each with a sign, so that colour is never alone. */
export const CELL_STATES = [
  ["missing", "?", "bad"],
  ["saturated", "▲", "bad"],
  ["excluded", "✕", "bad"],
  ["missed", "●", "bad"],
  ["dark", "○", "warn"],
  ["behind", "◁", "warn"],
  ["faint", "▽", "warn"],
  ["clipped", "◧", "warn"],
  ["used", "✓", "good"],
];
