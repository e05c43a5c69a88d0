/**
 * Vectors, quaternions and symmetric matrices, as plain arrays.
 *
 * Vectors are [x, y, z]; quaternions [x, y, z, w], as in every message; rotation vectors are in radians.
 * @typedef {[number, number, number]} Vec3
 * @typedef {[number, number, number, number]} Quat
 * @typedef {{t_m: Vec3, q_xyzw: Quat}} Pose base_from_tool
 */

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
/** a + s·b */
export const along = (a, b, s) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
/** a + u·x + v·y: a point of the plane through a. */
export const inPlane = (a, x, u, y, v) => along(along(a, x, u), y, v);
export const unit = (a) => scale(a, 1 / (norm(a) || 1));

/** @param {Quat} q @param {Vec3} v @returns {Vec3} v turned by q */
export function rotate(q, v) {
  const t = scale(cross(q, v), 2);
  return add(along(v, t, q[3]), cross(q, t));
}

/** @returns {Quat} first b, then a */
export function multiply(a, b) {
  const v = add(add(scale(b, a[3]), scale(a, b[3])), cross(a, b));
  return [...v, a[3] * b[3] - dot(a, b)];
}

export const conjugate = (q) => [-q[0], -q[1], -q[2], q[3]];

/** @param {Pose} pose @param {Vec3} p in the tool frame @returns {Vec3} in the base frame */
export const transform = (pose, p) => add(pose.t_m, rotate(pose.q_xyzw, p));

/** @param {Vec3} r rotation vector @returns {Quat} */
export function quaternion(r) {
  const angle = norm(r);
  const s = angle < 1e-9 ? 0.5 : Math.sin(angle / 2) / angle;
  return [...scale(r, s), Math.cos(angle / 2)];
}

/** @param {Quat} q @returns {Vec3} rotation vector of at most half a turn */
export function rotationVector(q) {
  const sign = q[3] < 0 ? -1 : 1;
  const s = Math.hypot(q[0], q[1], q[2]);
  if (s < 1e-12) return scale(q, 2 * sign);
  return scale(q, (sign * 2 * Math.atan2(s, sign * q[3])) / s);
}

/** The six coordinates of a pose: translation, then rotation vector. */
export const coordinates = (pose) => [...pose.t_m, ...rotationVector(pose.q_xyzw)];

/** Angle between two orientations, radians. */
export const angleBetween = (a, b) => norm(rotationVector(multiply(conjugate(a), b)));

/**
 * Semi-axes of the 1 σ ellipsoid of a covariance, longest first, by Jacobi's rotations.
 * @param {number[]} c xx, xy, xz, yy, yz, zz
 * @returns {{length: number, direction: Vec3}[]}
 */
export function ellipsoid(c) {
  const a = [
    [c[0], c[1], c[2]],
    [c[1], c[3], c[4]],
    [c[2], c[4], c[5]],
  ];
  const v = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ];
  const size = Math.abs(c[0]) + Math.abs(c[3]) + Math.abs(c[5]);
  for (let sweep = 0; sweep < 12; sweep++) {
    if (Math.abs(a[0][1]) + Math.abs(a[0][2]) + Math.abs(a[1][2]) <= 1e-14 * size) break;
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) turnOut(a, v, p, q);
  }
  return [0, 1, 2]
    .map((i) => ({ length: Math.sqrt(Math.max(a[i][i], 0)), direction: [v[0][i], v[1][i], v[2][i]] }))
    .sort((one, other) => other.length - one.length);
}

/** One rotation, which makes a[p][q] zero; v gathers the rotations. */
function turnOut(a, v, p, q) {
  if (a[p][q] === 0) return;
  const theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
  const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.hypot(theta, 1));
  const c = 1 / Math.hypot(t, 1);
  const s = t * c;
  for (const m of [a, v]) {
    for (let i = 0; i < 3; i++) [m[i][p], m[i][q]] = [c * m[i][p] - s * m[i][q], s * m[i][p] + c * m[i][q]];
  }
  for (let i = 0; i < 3; i++) [a[p][i], a[q][i]] = [c * a[p][i] - s * a[q][i], s * a[p][i] + c * a[q][i]];
}
