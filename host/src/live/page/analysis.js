/**
 * Spectrum and Allan deviation of equally spaced values. Pure.
 */

/** Fewer values than these have no spectrum worth looking at. */
const MIN_VALUES = 16;
/** A longer span is cut into segments of this many values that overlap by half, and their spectra averaged. */
const MAX_SEGMENT = 4096;

/** Fourier transform in place; the length is a power of two (Cooley and Tukey 1965). */
function transform(re, im) {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) [re[i], re[j], im[i], im[j]] = [re[j], re[i], im[j], im[i]];
  }
  for (let half = 1; half < n; half *= 2) {
    for (let k = 0; k < half; k++) {
      const [c, s] = [Math.cos((Math.PI * k) / half), -Math.sin((Math.PI * k) / half)];
      for (let a = k, b = k + half; a < n; a += 2 * half, b += 2 * half) {
        const [x, y] = [re[b] * c - im[b] * s, re[b] * s + im[b] * c];
        [re[b], im[b]] = [re[a] - x, im[a] - y];
        re[a] += x;
        im[a] += y;
      }
    }
  }
}

/**
 * Amplitude spectral density, per √Hz, one-sided, by Welch's method (1967) with Hann's window: without the mean, and each
 * segment filled with as many zeros as it has values. `peak` has frequency and amplitude of the strongest sine, of which
 * `values` are the means over the time from one to the next: this weakens it, which is undone.
 */
export function spectrum({ hz, values }) {
  if (values.length < MIN_VALUES) return null;
  const length = Math.min(values.length, MAX_SEGMENT);
  const size = 2 ** Math.ceil(Math.log2(2 * length));
  const window = Float64Array.from({ length }, (_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * (i + 0.5)) / length));
  const power = new Float64Array(size / 2);
  const segments = Math.floor((2 * values.length) / length) - 1;
  for (let segment = 0; segment < segments; segment++) {
    const part = values.slice((segment * length) >> 1, ((segment * length) >> 1) + length);
    const mean = part.reduce((sum, value) => sum + value, 0) / length;
    const [re, im] = [new Float64Array(size), new Float64Array(size)];
    part.forEach((value, i) => (re[i] = (value - mean) * window[i]));
    transform(re, im);
    power.forEach((_, k) => (power[k] += (re[k] ** 2 + im[k] ** 2) / segments));
  }
  // The window's own lobe around zero has no part in it.
  const first = Math.ceil((2 * size) / length);
  const isTop = (k) => power[k] > power[k - 1] && power[k] >= power[k + 1];
  let top = 0;
  for (let k = first + 1; k < power.length - 1; k++) if (isTop(k) && (!top || power[k] > power[top])) top = k;
  // Its top by a parabola through the logarithms.
  const [a, b, c] = [top - 1, top, top + 1].map((k) => Math.log(power[k] + 1e-30) / 2);
  const shift = Math.max(-0.5, Math.min(0.5, (0.5 * (a - c)) / (a - 2 * b + c) || 0));
  const step = hz / size;
  const turn = (Math.PI * (top + shift)) / size;
  const amplitude = (Math.exp(b - 0.25 * (a - c) * shift) * 4 * turn) / (length * Math.sin(turn));
  const density = 2 / (hz * (3 / 8) * length);
  return {
    x: Array.from(power.subarray(first), (_, k) => (first + k) * step),
    y: Array.from(power.subarray(first), (value) => Math.sqrt(value * density)),
    peak: top && { hz: (top + shift) * step, amplitude },
  };
}

/** Overlapping Allan deviation over averaging times of one value to a third of all (Allan 1966; Howe 1981). */
export function allan({ hz, values }) {
  if (values.length < MIN_VALUES) return null;
  const sums = [0];
  for (const value of values) sums.push(sums.at(-1) + value - values[0]);
  const [x, y] = [[], []];
  for (let m = 1; 3 * m <= values.length; m = Math.max(m + 1, Math.round(m * 1.2))) {
    let squares = 0;
    const count = values.length - 2 * m + 1;
    for (let i = 0; i < count; i++) squares += (sums[i + 2 * m] - 2 * sums[i + m] + sums[i]) ** 2;
    x.push(m / hz);
    y.push(Math.sqrt(squares / (2 * m * m * count)));
  }
  return { x, y };
}
