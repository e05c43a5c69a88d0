// The pure modules of the live page: `node --test tests/page/test_modules.mjs`.
import assert from "node:assert/strict";
import test from "node:test";

const page = new URL("../../host/src/live/page/", import.meta.url);
const load = (name) => import(new URL(name, page));
const v = await load("vectors.js");
const { Camera, hull, roundDown } = await load("camera.js");
const { Columns, History, poseValues } = await load("history.js");
const head = await load("head.js");
const format = await load("format.js");

const near = (actual, expected, tolerance = 1e-12) => {
  assert.equal(actual.length, expected.length);
  actual.forEach((a, i) => assert.ok(Math.abs(a - expected[i]) <= tolerance, `${actual} is not ${expected}`));
};

test("a quarter turn about z takes x to y", () => {
  near(v.rotate(v.quaternion([0, 0, Math.PI / 2]), [1, 0, 0]), [0, 1, 0]);
});

test("rotation vectors survive quaternions, also near none and near half a turn", () => {
  for (const r of [[0, 0, 0], [1e-10, 0, 0], [0.3, -0.4, 0.5], [0, 3.14, 0], [-1, 2, 0.1]]) {
    near(v.rotationVector(v.quaternion(r)), r);
    near(v.rotationVector(v.quaternion(r).map((q) => -q)), r);
  }
});

test("a product of quaternions turns by the second, then by the first", () => {
  const [a, b, p] = [v.quaternion([0.2, 0.5, -1]), v.quaternion([1, 0.1, 0.3]), [0.3, 2, -1]];
  near(v.rotate(v.multiply(a, b), p), v.rotate(a, v.rotate(b, p)));
  assert.ok(Math.abs(v.angleBetween(a, v.multiply(a, v.quaternion([0, 0.01, 0]))) - 0.01) < 1e-12);
});

test("the ellipsoid of a turned diagonal covariance has its axes and lengths", () => {
  const turn = v.quaternion([0.4, -0.7, 0.2]);
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((e) => v.rotate(turn, e));
  const lengths = [5e-6, 2e-6, 1e-6];
  const at = (i, j) => axes.reduce((sum, a, k) => sum + lengths[k] ** 2 * a[i] * a[j], 0);
  const found = v.ellipsoid([at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)]);
  near(found.map(({ length }) => length), lengths, 1e-15);
  found.forEach(({ direction }, k) => assert.ok(Math.abs(Math.abs(v.dot(direction, axes[k])) - 1) < 1e-9));
});

test("the target is in the middle, x to the right and z upwards seen from the front", () => {
  const camera = new Camera(0.03);
  camera.resize(800, 600);
  camera.home("front");
  const middle = camera.project([0, 0, 0]);
  near(middle.slice(0, 2), [400, 300], 1e-9);
  assert.ok(camera.project([0.01, 0, 0])[0] > 400);
  assert.ok(camera.project([0, 0, 0.01])[1] < 300);
  assert.equal(camera.project(camera.eye), null);
});

test("a point moved by the vector of some pixels moves by these pixels", () => {
  const camera = new Camera(0.03);
  camera.resize(700, 500);
  const p = [0.004, -0.003, 0.002];
  const [before, after] = [camera.project(p), camera.project(v.add(p, camera.inView(13, -7, p)))];
  near([after[0] - before[0], after[1] - before[1]], [13, -7], 1e-9);
});

test("a hull leaves inner points out", () => {
  const corners = hull([[0, 0], [2, 0], [1, 1], [2, 2], [0, 2], [1, 0]]);
  assert.deepEqual(corners.map(String).sort(), ["0,0", "0,2", "2,0", "2,2"]);
});

test("magnifications are 1, 2 or 5 times a power of ten, never above the value", () => {
  assert.deepEqual([1999, 4.9, 5, 0.0071, 1000].map(roundDown), [1000, 2, 5, 0.005, 1000]);
});

const frame = (n, x = n) => ({ n, time_s: n / 60, t_m: [x, 0, 0], q_xyzw: [0, 0, 0, 1], low: null, high: null });
const numbers = (history) => Array.from({ length: history.length }, (_, i) => history.at(i).n);

test("a history keeps its span and no more", () => {
  const history = new History(2, 60);
  for (let n = 0; n < 5000; n++) history.push(frame(n));
  assert.equal(history.last.n, 4999);
  assert.equal(history.length, 121);
  for (let n = 5000; n < 9000; n++) history.push({ ...frame(n), time_s: 5000 / 60 });
  assert.equal(history.length, 150, "bounded by count where the clock stands");
});

test("older frames after newer ones are put in place, and doubles left out", () => {
  const history = new History();
  for (const n of [10, 11]) history.push(frame(n));
  history.merge([8, 9, 10].map((n) => frame(n)));
  history.push(frame(7));
  history.push(frame(11));
  assert.deepEqual(numbers(history), [7, 8, 9, 10, 11]);
});

test("a clock that starts again drops what was before", () => {
  const history = new History();
  for (const n of [10, 11]) history.push(frame(n));
  history.push({ ...frame(12), time_s: 0 });
  assert.deepEqual(numbers(history), [12]);
  history.merge([frame(9)]);
  assert.deepEqual(numbers(history), [12]);
});

test("a frozen history stays", () => {
  const history = new History();
  history.push(frame(1));
  const frozen = history.frozen();
  history.push(frame(2));
  assert.deepEqual([frozen.length, history.length], [1, 2]);
  assert.notEqual(frozen.epoch, history.epoch);
});

test("the frame of a time is the last one before it", () => {
  const history = new History();
  for (const n of [60, 90, 120]) history.push(frame(n));
  assert.deepEqual([0, 1, 1.4, 1.5, 9].map((t) => history.indexAt(t)), [0, 0, 0, 1, 2]);
});

test("columns hold the envelope, the last value, and gaps; frames are read once", () => {
  const history = new History();
  let reads = 0;
  const columns = new Columns(0.1, (f) => (reads++, poseValues(f)));
  history.push({ ...frame(0, 5), low: [4, 0, 0, 0, 0, 0], high: [9, 0, 0, 0, 0, 0] });
  history.push(frame(1, 3));
  history.push({ ...frame(6), t_m: null });
  columns.update(history, -100);
  columns.update(history, -100);
  assert.equal(reads, 3);
  assert.deepEqual([columns.at(0).low[0], columns.at(0).high[0], columns.at(0).value[0]], [3, 9, 3]);
  assert.equal(columns.at(0).hasGap, false);
  assert.deepEqual([columns.at(1).value, columns.at(1).hasGap], [null, true]);
  assert.deepEqual(columns.range(0, 0, 1), [3, 9]);
  assert.equal(columns.range(0, 1, 1), null);
});

/** A slit 5 mm in front of a detector that faces x. */
const cell = {
  detector: { centre_m: [0, 0, 0], x: [0, 1, 0], y: [0, 0, 1], z: [1, 0, 0], length_m: 0.012, width_m: 0.001 },
  mask: { centre_m: [0.005, 0, 0], x: [0, 1, 0], y: [0, 0, 1], half_m: [0.007, 0.006], rides: false },
  opening: { kind: "slit", half_m: [0.0003, 0.005] },
  emitter: { position_m: [0.015, 0, 0], axis: [-1, 0, 0] },
  second_axis_of: null,
};
const home = { t_m: [0, 0, 0], q_xyzw: [0, 0, 0, 1] };

test("a spot lies between its ends, and covers the width that the slit lets through", () => {
  const { spot } = head.beam(cell, home, { spot_m: [-0.001, 0.0005], state: ["used"] });
  near([...new Set(spot.map((p) => p[1]))].sort(), [-0.001, 0.0005].sort());
  near([...new Set(spot.map((p) => p[2]))].sort(), [-0.0005, 0.0005].sort());
  const short = { ...cell, opening: { kind: "slit", half_m: [0.0003, 0.0002] } };
  const narrow = head.beam(short, home, { spot_m: [-0.001, 0.0005], state: ["used"] });
  near([Math.max(...narrow.spot.map((p) => p[2]))], [0.0003]);
});

test("cells without light have no beam, nor has a tool without pose", () => {
  const lit = { spot_m: [0, 0.001], state: ["used"] };
  assert.equal(head.beam(cell, null, lit), null);
  assert.equal(head.beam(cell, home, { ...lit, spot_m: null }), null);
  assert.equal(head.beam(cell, home, { ...lit, state: ["dark"] }), null);
  assert.notEqual(head.beam(cell, home, lit), null);
});

test("a second axis gives the extent across, and riding masks follow the tool", () => {
  const { spot } = head.beam(cell, home, { spot_m: [0, 0.001], state: [] }, { spot_m: [0.0001, 0.0002], state: [] });
  near([...new Set(spot.map((p) => p[2]))].sort(), [0.0001, 0.0002]);
  const riding = { ...cell, mask: { ...cell.mask, rides: true } };
  assert.equal(head.placedMask(riding, null), null);
  near(head.placedMask(riding, { ...home, t_m: [0, 0, 0.001] }).centre_m, [0.005, 0, 0.001]);
});

test("numbers are written with a true minus, prefixes, and no minus zero", () => {
  assert.equal(format.fixed(-1.2345, 2), "−1.23");
  assert.equal(format.fixed(-0.0001, 2, { plus: true }), "+0.00");
  assert.equal(format.fixed(null, 2), "–");
  assert.equal(format.engineering(0.00123, "s"), "1.23 ms");
  assert.equal(format.engineering(9.997e-4, "s"), "1.00 ms");
  assert.equal(format.engineering(-5e-9, "A"), "−5.00 nA");
  assert.equal(format.clock(75.25), "1:15.3");
  assert.equal(format.clock(59.97), "1:00.0");
  assert.equal(format.count(1234567), "1\u202f234\u202f567");
});
