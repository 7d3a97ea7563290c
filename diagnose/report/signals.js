"use strict";
// Sampled signals: decoding, envelopes for drawing, spectral densities, filters of one band.
const Signals = (() => {
  function bytes(text) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const raw = atob(text);
    const out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i += 1) out[i] = raw.charCodeAt(i);
    return out;
  }

  // {f}: single precision; {q, low, step}: 16 bits.
  function values(spec) {
    if (spec.f !== undefined) return new Float32Array(bytes(spec.f).buffer);
    const q = new Uint16Array(bytes(spec.q).buffer);
    return Float32Array.from(q, (k) => spec.low + spec.step * k);
  }

  // A horizontal axis of n samples: at(i), and index(x): the sample nearest to x.
  function grid(spec) {
    if (spec.step !== undefined) {
      const { start, step, n } = spec;
      return { n, step, at: (i) => start + step * i, index: (x) => clamp(Math.round((x - start) / step), 0, n - 1) };
    }
    const x = Float64Array.from(values(spec), (v) => v + spec.start);
    const index = (wanted) => {
      let low = 0;
      let high = x.length - 1;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (x[middle] <= wanted) low = middle; else high = middle;
      }
      return wanted - x[low] > x[high] - wanted ? high : low;
    };
    return { n: x.length, step: null, at: (i) => x[i], index };
  }

  const clamp = (v, low, high) => Math.min(Math.max(v, low), high);

  // Of samples i0..i1 at most two a column, the least and the greatest in the order of time; keep[i] = 0 leaves a gap.
  function envelope(g, y, i0, i1, columns, keep = null) {
    const x = [];
    const out = [];
    const put = (i, v) => { x.push(g.at(i)); out.push(v); };
    const count = i1 - i0 + 1;
    const shown = (i) => (keep === null || keep[i]) && Number.isFinite(y[i]);
    if (count <= 2 * columns) {
      for (let i = i0; i <= i1; i += 1) put(i, shown(i) ? y[i] : null);
      return { x, y: out, every: true };
    }
    const width = count / columns;
    for (let c = 0; c < columns; c += 1) {
      const a = i0 + Math.floor(c * width);
      const b = Math.min(i1, i0 + Math.floor((c + 1) * width) - 1);
      let low = -1;
      let high = -1;
      for (let i = a; i <= b; i += 1) {
        if (!shown(i)) continue;
        if (low < 0 || y[i] < y[low]) low = i;
        if (high < 0 || y[i] > y[high]) high = i;
      }
      if (low < 0) put(a, null);
      else {
        put(Math.min(low, high), y[Math.min(low, high)]);
        if (low !== high) put(Math.max(low, high), y[Math.max(low, high)]);
      }
    }
    return { x, y: out, every: false };
  }

  // Discrete Fourier transform in place; the length is a power of two. sign -1 forward, +1 backward (without 1/n).
  function fft(re, im, sign) {
    const n = re.length;
    for (let i = 1, j = 0; i < n; i += 1) {
      let bit = n >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j ^= bit;
      if (i < j) { [re[i], re[j]] = [re[j], re[i]]; [im[i], im[j]] = [im[j], im[i]]; }
    }
    for (let size = 2; size <= n; size <<= 1) {
      const half = size >> 1;
      const angle = (sign * 2 * Math.PI) / size;
      for (let k = 0; k < half; k += 1) {
        const c = Math.cos(angle * k);
        const s = Math.sin(angle * k);
        for (let a = k; a < n; a += size) {
          const b = a + half;
          const tr = re[b] * c - im[b] * s;
          const ti = re[b] * s + im[b] * c;
          re[b] = re[a] - tr; im[b] = im[a] - ti;
          re[a] += tr; im[a] += ti;
        }
      }
    }
  }

  // One-sided spectral density by Welch's method, Hann window, half overlap, over the samples with keep[i]; in bins that are
  // equally wide on a logarithmic axis. Divided by the window's energy on these samples: the mean density while they last.
  function density(y, keep, dt) {
    const n = y.length;
    let segment = 64;
    while (segment * 2 <= n / 4 && segment < 4096) segment *= 2;
    if (n < segment) return null;
    const power = new Float64Array(segment / 2 + 1);
    let weight = 0;
    const re = new Float64Array(segment);
    const im = new Float64Array(segment);
    for (let start = 0; start + segment <= n; start += segment / 2) {
      let own = 0;
      for (let i = 0; i < segment; i += 1) {
        const k = start + i;
        const on = (keep === null || keep[k]) && Number.isFinite(y[k]);
        const w = on ? 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / segment) : 0;
        re[i] = on ? w * y[k] : 0;
        im[i] = 0;
        own += w * w;
      }
      if (own === 0) continue;
      fft(re, im, -1);
      weight += own;
      for (let i = 0; i <= segment / 2; i += 1) power[i] += re[i] * re[i] + im[i] * im[i];
    }
    if (weight === 0) return null;
    const f = [];
    const p = [];
    let sum = 0;
    let total = 0;
    let count = 0;
    for (let i = 1; i <= segment / 2; i += 1) {
      sum += power[i]; total += i; count += 1;
      if (Math.log10((i + 1) / (total / count)) > 1 / 60 || i === segment / 2) {
        f.push(total / count / (segment * dt));
        p.push((2 * dt * sum) / count / weight);
        sum = 0; total = 0; count = 0;
      }
    }
    return { f, p };
  }

  // The part of y between two frequencies, without a shift in time.
  function band(y, low, high, dt) {
    const n = y.length;
    let size = 1;
    while (size < n) size *= 2;
    const re = new Float64Array(size);
    const im = new Float64Array(size);
    for (let i = 0; i < n; i += 1) re[i] = Number.isFinite(y[i]) ? y[i] : 0;
    fft(re, im, -1);
    for (let i = 0; i <= size / 2; i += 1) {
      const f = i / (size * dt);
      if (f >= low && f <= high) continue;
      re[i] = 0; im[i] = 0;
      if (i > 0) { re[size - i] = 0; im[size - i] = 0; }
    }
    fft(re, im, 1);
    return Float32Array.from(re.subarray(0, n), (v) => v / size);
  }

  function meanSquare(y, keep) {
    let sum = 0;
    let n = 0;
    for (let i = 0; i < y.length; i += 1) {
      if ((keep === null || keep[i]) && Number.isFinite(y[i])) { sum += y[i] * y[i]; n += 1; }
    }
    return { sum, n };
  }

  return { values, grid, envelope, fft, density, band, meanSquare, clamp };
})();
