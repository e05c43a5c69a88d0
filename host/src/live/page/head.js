/**
 * The parts of a head in space: detectors, masks, openings, beams and spots, base frame, metres.
 *
 * A `head` message holds detectors and resting masks in the base frame, emitters and riding masks in the tool frame.
 * Pure: poses come in, polygons go out.
 */
import { add, cross, dot, inPlane, norm, rotate, sub, transform } from "./vectors.js";

const CIRCLE = Array.from({ length: 16 }, (_, i) => [Math.cos((i * Math.PI) / 8), Math.sin((i * Math.PI) / 8)]);

/** The four corners of a rectangle. */
const rectangle = (centre, x, y, [u0, u1], [v0, v1]) =>
  [[u0, v0], [u1, v0], [u1, v1], [u0, v1]].map(([u, v]) => inPlane(centre, x, u, y, v));

const both = (half) => [-half, half];

export function detectorOutline({ centre_m, x, y, length_m, width_m }) {
  return rectangle(centre_m, x, y, both(length_m / 2), both(width_m / 2));
}

/** The mask of a cell in the base frame; null if it rides on a tool without pose. */
export function placedMask({ mask, opening }, pose) {
  if (!mask.rides) return { ...mask, opening };
  if (!pose) return null;
  return {
    ...mask,
    opening,
    centre_m: transform(pose, mask.centre_m),
    x: rotate(pose.q_xyzw, mask.x),
    y: rotate(pose.q_xyzw, mask.y),
  };
}

/** The edge of its plate, and that of the hole: a rectangle, or a circle. */
export function maskOutlines({ centre_m, x, y, half_m, opening }) {
  const plate = rectangle(centre_m, x, y, both(half_m[0]), both(half_m[1]));
  const [u, v] = opening.half_m;
  const hole =
    opening.kind === "slit"
      ? rectangle(centre_m, x, y, both(u), both(v))
      : CIRCLE.map(([c, s]) => inPlane(centre_m, x, c * u, y, s * v));
  return { plate, hole };
}

/** Whether the daemon gives a place to the light of a cell. */
export const hasLight = (reading) =>
  Boolean(reading?.spot_m) && !reading.state.some((s) => s === "dark" || s === "missed" || s === "missing" || s === "behind");

/** The second axis of each detector that has one: a map from the first cell to the second. */
export const secondAxes = (cells) =>
  new Map(cells.flatMap((cell, k) => (cell.second_axis_of == null ? [] : [[cell.second_axis_of, k]])));

/**
 * The spot on a detector, and the way of the light to it.
 *
 * Along the detector the daemon gives the ends of the spot; across it, either the second axis does, or the opening's
 * shadow as the emitter throws it, as far as it falls on the detector.
 * @returns {{emitter: number[], opening: number[][] | null, spot: number[][]} | null}
 */
export function beam(cell, pose, reading, across) {
  if (!pose || !hasLight(reading)) return null;
  const { detector } = cell;
  const emitter = transform(pose, cell.emitter.position_m);
  const mask = placedMask(cell, pose);
  const { hole } = maskOutlines(mask);
  const isLens = cell.opening.kind === "lens";
  const half = detector.width_m / 2;
  const v = across?.spot_m ?? (isLens ? both(half) : shadow(emitter, hole, detector, half));
  if (!v) return null;
  const end = detector.length_m / 2;
  const u = reading.spot_m.map((x) => Math.min(Math.max(x, -end), end));
  const spot = rectangle(detector.centre_m, detector.x, detector.y, u, v.map((y) => Math.min(Math.max(y, -half), half)));
  return { emitter, opening: isLens ? hole : null, spot };
}

/** The extent along y that light from `emitter` through `hole` covers on the detector. */
function shadow(emitter, hole, detector, half) {
  const height = dot(sub(emitter, detector.centre_m), detector.z);
  const places = hole.map((corner) => {
    const ray = sub(corner, emitter);
    const fall = -dot(ray, detector.z);
    return fall > 0 ? dot(sub(inPlane(emitter, ray, height / fall, ray, 0), detector.centre_m), detector.y) : NaN;
  });
  const [low, high] = [Math.max(Math.min(...places), -half), Math.min(Math.max(...places), half)];
  return low < high ? [low, high] : null;
}

/** The place on the detector at `x_m` from its middle: the ends of a mark across it. */
export function markAcross({ centre_m, x, y, width_m }, x_m, overhang = 0.8) {
  return both(width_m * overhang).map((v) => inPlane(centre_m, x, x_m, y, v));
}

/** The distance of the farthest part from the origin of the base frame with the tool at home. */
export function radius(head) {
  const far = head.cells.flatMap((cell) => [
    ...detectorOutline(cell.detector),
    ...maskOutlines({ ...cell.mask, opening: cell.opening }).plate,
    cell.emitter.position_m,
  ]);
  return Math.max(...far.map(norm), 1e-4);
}

/** Two directions that span the plane across `axis`. */
export function across(axis) {
  const u = cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]);
  const length = norm(u) || 1;
  const x = u.map((c) => c / length);
  return [x, cross(axis, x)];
}

/** A disc across the axis of an emitter: its package. */
export function emitterOutline({ position_m, axis }, pose, radius_m) {
  const [x, y] = across(axis);
  return CIRCLE.map(([c, s]) => transform(pose, add(position_m, inPlane([0, 0, 0], x, c * radius_m, y, s * radius_m))));
}
