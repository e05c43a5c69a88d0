// The pure modules of the live page: `node --test tests/page/test_modules.mjs`.
import assert from "node:assert/strict";
import test from "node:test";

const page = new URL("../../host/src/live/page/", import.meta.url);
const load = (name) => import(new URL(name, page));
const v = await load("vectors.js");
const { Camera, hull, roundDown } = await load("camera.js");
const { History } = await load("history.js");
const { Trace } = await load("trace.js");
const { allan, spectrum } = await load("analysis.js");
const { Memory } = await load("findings.js");
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
});

test("the frame of a time is the last one before it", () => {
  const history = new History();
  for (const n of [60, 90, 120]) history.push(frame(n));
  assert.deepEqual([0, 1, 1.4, 1.5, 9].map((t) => history.indexAt(t)), [0, 0, 0, 1, 2]);
});

/** Bins of `scans_hz` values of `x` nanometres over time, as the daemon makes them; σ is 7 nm. */
function bins(hz, from_s, to_s, scans_hz, x) {
  const found = new Map();
  for (let scan = Math.ceil(from_s * scans_hz); scan < to_s * scans_hz; scan++) {
    const k = Math.floor((scan / scans_hz) * hz + 1e-9);
    found.set(k, [...(found.get(k) ?? []), x(scan / scans_hz)]);
  }
  const twelve = (value) => [value, ...Array(11).fill(0)].map(Math.round);
  return [...found].map(([k, all]) => {
    const values = all.filter((value) => value !== null);
    const mean = values.reduce((sum, value) => sum + value, 0) / (values.length || 1);
    const rms = Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / (values.length || 1));
    const [low, high] = values.length ? [Math.min(...values), Math.max(...values)] : [mean, mean];
    return [k, all.length, values.length, 0, ...[mean, mean - low, high - mean, rms, 7].flatMap(twelve)];
  });
}
const kept = { fine_hz: 240, coarse_hz: 20, coarse_s: 600 };
const sine = (time_s) => 2e6 * Math.sin(2 * Math.PI * 19 * time_s);
const isNear = (actual, expected, share) => assert.ok(Math.abs(actual / expected - 1) <= share, `${actual} is not ${expected}`);

test("columns of a sine have its extremes at every span, whether fine or coarse, and statistics its rms", () => {
  const trace = new Trace(kept);
  // Coarse bins come later and twice; fine ones of the last three minutes only.
  trace.put({ fine: bins(240, 560, 600, 4000, sine) });
  for (let i = 0; i < 2; i++) trace.put({ coarse: bins(20, 0, 600, 1000, sine) });
  assert.equal(trace.last_s, 600);
  for (const span_s of [0.5, 1, 5, 10, 30, 60, 300, 600]) {
    const columns = trace.columns(0, 600 - span_s, 600, 700);
    let [low, high, filled] = [0, 0, 0];
    for (let c = 0; c < 700; c++) {
      if (!columns.count[c]) continue;
      [low, high] = [Math.min(low, columns.low[6 * c]), Math.max(high, columns.high[6 * c])];
      filled++;
      if ((columns.end_s[c] - columns.start_s[c]) * 19 > 1) isNear(columns.high[6 * c], 2e6, 0.01);
    }
    assert.ok(filled === 700 || span_s < 4, `${filled} columns of ${span_s} s`);
    assert.equal(columns.gaps.length, 0);
    isNear(low, -2e6, 0.001);
    isNear(high, 2e6, 0.001);
    const { count, from_s, to_s, quantities } = trace.statistics(0, 600 - span_s, 600);
    isNear(to_s - from_s, span_s, 1e-9);
    assert.ok(count >= span_s * 1000);
    isNear(quantities[0].rms, 2e6 / Math.SQRT2, 0.002);
    isNear(quantities[0].high - quantities[0].low, 4e6, 0.001);
    assert.ok(Math.abs(quantities[0].mean) < 0.04e6 / span_s);
  }
  assert.equal(trace.columns(6, 590, 600, 100).count.some(Boolean), false, "no velocity");
  assert.equal(trace.statistics(6, 590, 600), null);
});

test("a coarse bin stands for fine ones of which some are missing", () => {
  const trace = new Trace(kept);
  trace.put({ fine: bins(240, 0, 2, 1000, sine).filter(([k]) => k < 300 || k > 400), coarse: bins(20, 0, 2, 1000, sine) });
  assert.deepEqual([trace.statistics(0, 0, 2).count, trace.columns(0, 0, 2, 100).gaps], [2000, []]);
});

test("times without scans and without poses are gaps; slow scans are none", () => {
  const trace = new Trace(kept);
  trace.put({ fine: bins(240, 0, 1, 4000, (time_s) => (time_s >= 0.5 && time_s < 0.52 ? null : 5)) });
  trace.put({ fine: bins(240, 1.5, 2, 4000, () => 5) });
  const { gaps, isBroken } = trace.columns(0, 0, 2, 100);
  near(gaps.flat(), [0.5, 0.516667, 1, 1.5], 1e-6);
  assert.deepEqual([...isBroken.keys()].filter((c) => isBroken[c]), [25, 75]);
  assert.equal(trace.series(0, 0, 0.6, 0.9).values.length, 72);
  assert.equal(trace.series(0, 0, 0.4, 0.9), null);
  const slow = new Trace(kept);
  slow.put({ fine: bins(240, 0, 20, 50, () => 5) });
  assert.equal(slow.columns(0, 10, 20, 700).gaps.length, 0);
});

test("a frozen trace stays, and a cleared one is empty", () => {
  const trace = new Trace(kept);
  trace.put({ fine: bins(240, 0, 1, 4000, sine) });
  const frozen = trace.frozen();
  trace.put({ fine: bins(240, 1, 2, 4000, sine) });
  assert.deepEqual([frozen.last_s, trace.last_s], [1, 2]);
  trace.clear();
  assert.deepEqual([frozen.last_s, trace.last_s], [1, null]);
});

test("findings and losses stay for a minute, each once", () => {
  const memory = new Memory();
  const at = (second, p99_s, skipped_scans = 0, findings = []) => {
    const board = {
      name: "port", lag: { skipped_scans }, latencies: { total: { recent: { p99_s } } }, clock: {},
      losses: { board: { scans_dropped: 0, scans_lost: 0 }, link: { scans: 0 } },
    };
    const message = { findings, report: { uptime_s: second, boards: [board] } };
    return memory.take(message, second * 1e3).map(({ name, finding }) => `${name}: ${finding}`);
  };
  assert.deepEqual(at(100, 0), []);
  const late = "1 % of the poses were sent later than";
  assert.deepEqual(at(101, 0.053), [`port, poses: ${late} 53.0 ms after their instant`]);
  assert.deepEqual(at(115, 0), [`port, poses: in the last 20 s: ${late} 53.0 ms after their instant`]);
  assert.deepEqual(at(160, 0.021), [`port, poses: ${late} 21.0 ms after their instant`]);
  assert.deepEqual(at(221, 0), []);
  assert.match(at(230, 0, 7)[0], /^port, solver: in the last minute 7 scans were skipped/);
  assert.match(at(280, 0, 9)[0], /^port, solver: in the last minute 9 scans/);
  assert.match(at(300, 0, 9)[0], /^port, solver: in the last minute 2 scans/);
  assert.deepEqual(at(345, 0, 9), []);
  const failed = [{ name: "port, link", verdict: "failed", finding: "no scan for 4 s" }, { name: "x", verdict: "ok", finding: "" }];
  assert.deepEqual(at(346, 0, 9, failed), ["port, link: no scan for 4 s"]);
});

test("a spectrum has frequency and amplitude of a sine, and the density of noise", () => {
  for (const count of [120, 777, 2400, 14400]) {
    const { peak } = spectrum({ hz: 240, values: bins(240, 0, count / 240, 24000, sine).map((bin) => 5e6 + bin[4]) });
    isNear(peak.hz, 19, 0.001);
    isNear(peak.amplitude, 2e6, 0.01);
  }
  let seed = 1;
  const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const noise = Array.from({ length: 20000 }, () => 1000 * Math.sqrt(12) * (random() - 0.5));
  const { y } = spectrum({ hz: 240, values: noise });
  isNear(Math.sqrt(y.reduce((sum, v) => sum + v * v, 0) / y.length), 1000 * Math.sqrt(2 / 240), 0.03);
  // White noise falls with the root of the averaging time.
  const deviation = allan({ hz: 240, values: noise });
  for (const k of [0, 8]) isNear(deviation.y[k] * Math.sqrt(deviation.x[k] * 240), 1000, 0.05);
  assert.equal(allan({ hz: 240, values: [1, 2] }), null);
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
