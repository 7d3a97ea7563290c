"use strict";
// What an explorer draws: signals and errors over time, densities over frequency, the error over a state.
const Views = (() => {
  const COLUMNS = 700; // of a plot over time
  const POINTS = 2000; // drawn over a state
  const BINS = 30; // of a state, in which the error is averaged

  // ---- time ---------------------------------------------------------------------------------------------------------------

  function time(ex) {
    if (!ex.now) return;
    const { grid, measured, models, errors, counted, sigma } = ex.now;
    const plot = ex.plots.time;
    const narrow = plot.width < Panels.NARROW;
    const columns = Math.min(COLUMNS, Math.max(160, plot.width));
    const i0 = Math.max(0, grid.index(ex.view[0]) - 1);
    const i1 = Math.min(grid.n - 1, grid.index(ex.view[1]) + 1);
    const cut = (y, keep) => Signals.envelope(grid, y, i0, i1, columns, keep);
    const traces = [];
    const put = (name, y, keep, options) => {
      const e = cut(y, keep);
      traces.push(Panels.line(name, e.x, e.y, { hoverinfo: "skip", ...options }));
      return e;
    };
    const whole = put("measured", measured, null, { colour: "measured", width: 3 });
    for (const m of ex.shown()) put(m.name, models[m.key], null, { colour: m.colour, dash: m.dash, width: 1.3 });
    for (const m of ex.shown()) put(`error, ${m.name}`, errors[m.key], counted, { colour: m.colour, dash: m.dash, width: 1, yaxis: "y2" });
    const chosen = ex.chosen();
    if (chosen?.band) put("error in the selected band", chosen.band, counted, { colour: "accent", width: 1.6, yaxis: "y2" });
    else if (chosen && ex.selection.kind === "state") put("selected", ex.error, chosen.keep, { colour: "accent", width: 2, yaxis: "y2" });
    const shapes = [];
    if (sigma > 0) for (const y of [-2 * sigma, 2 * sigma]) shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, yref: "y2", y0: y, y1: y, line: { color: Panels.colour("muted"), width: 1, dash: "dash" } });
    if (ex.selection?.kind === "time") shapes.push(shade(ex.selection));
    gaps(ex, shapes);
    const u = ex.spec.unit ? ` [${ex.spec.unit}]` : "";
    const judged = ex.shown().filter((m) => m.key !== "nominal" || ex.model === "nominal").map((m) => m.key);
    plot.draw(traces, {
      dragmode: ex.drag, shapes, margin: { l: narrow ? 56 : 68, r: 12, t: 8, b: 46 },
      xaxis: Panels.axis("time [s]", { range: ex.view, anchor: "y2", domain: [0, 1] }),
      yaxis: Panels.axis(`${ex.spec.channel}${u}`, { domain: [0.44, 1], fixedrange: true, range: limits([measured, ...judged.map((k) => models[k])], i0, i1, null) }),
      yaxis2: Panels.axis(`error${u}`, { domain: [0, 0.36], fixedrange: true, range: limits(judged.map((k) => errors[k]), i0, i1, counted, sigma) }),
    }, narrow ? 380 : 460);
    if (!plot.wired) {
      plot.wired = true;
      plot.gd.on("plotly_relayout", (change) => {
        const range = Panels.zoomed(change, false)?.map((v) => Signals.clamp(v, ...ex.all));
        if (!range) return;
        ex.view = range[1] > range[0] ? range : [...ex.all];
        ex.drawTime();
      });
      plot.gd.on("plotly_doubleclick", () => ex.step("time", "reset"));
      ex.tell();
    }
    const count = i1 - i0 + 1;
    const of = ex.now.samples > grid.n ? ` The page holds ${grid.n.toLocaleString("en")} of the ${ex.now.samples.toLocaleString("en")} samples: those at which the error is least and greatest in each stretch.` : "";
    ex.captions.time.textContent = (whole.every ? `Every sample is drawn (${count}).` : `The least and the greatest of every ${Math.round(count / columns)} samples are drawn; zoom in to see each sample.`)
      + (sigma > 0 ? " Dashed: two standard deviations of the noise." : "") + (judged.length < ex.shown().length ? " The error axis is not scaled to the model as given; choose its error to see it whole." : "") + of;
    ex.mark();
  }

  // Limits that hold the curves on the samples shown, with a margin.
  function limits(curves, i0, i1, keep, least = 0) {
    let low = least > 0 ? -2.2 * least : Infinity;
    let high = least > 0 ? 2.2 * least : -Infinity;
    for (const y of curves) {
      for (let i = i0; i <= i1; i += 1) {
        if (!Number.isFinite(y[i]) || (keep && !keep[i])) continue;
        if (y[i] < low) low = y[i];
        if (y[i] > high) high = y[i];
      }
    }
    if (!(high >= low)) return [-1, 1];
    const margin = 0.06 * (high - low) || Math.abs(high) || 1;
    return [low - margin, high + margin];
  }

  // Stretches that no model is judged on.
  function gaps(ex, shapes) {
    const { counted, grid } = ex.now;
    if (!counted) return;
    const edges = [0, ...ex.now.edges, grid.n];
    for (let i = 0; i < edges.length; i += 2) {
      const [a, b] = [grid.at(Math.max(0, edges[i] - 1)), grid.at(Math.min(grid.n - 1, edges[i + 1]))];
      if (edges.length < 120 && b - a > 0.004 * (ex.view[1] - ex.view[0])) {
        shapes.push({ type: "rect", xref: "x", x0: a, x1: b, yref: "paper", y0: 0, y1: 1, layer: "below", line: { width: 0 }, fillcolor: Panels.colour("grid"), opacity: 0.6 });
      }
    }
  }

  function shade({ low, high }) {
    return { type: "rect", xref: "x", x0: low, x1: high, yref: "paper", y0: 0, y1: 1, layer: "below", line: { width: 1, color: Panels.colour("accent") }, fillcolor: Panels.colour("select") };
  }

  // ---- frequency ----------------------------------------------------------------------------------------------------------

  function frequency(ex) {
    if (!ex.now) return;
    const { grid, measured, errors, counted, sigma } = ex.now;
    const plot = ex.plots.frequency;
    if (grid.step === null) { plot.figure.hidden = true; return; }
    plot.figure.hidden = false;
    ex.bands ??= {
      measured: Signals.density(measured, null, grid.step),
      errors: Object.fromEntries(Object.entries(errors).map(([k, e]) => [k, Signals.density(e, counted, grid.step)])),
    };
    if (!ex.bands.measured) { plot.figure.hidden = true; return; }
    const traces = [];
    const put = (name, d, options) => { if (d) traces.push(Panels.line(name, d.f, d.p.map((v) => (v > 0 ? v : null)), options)); };
    put("measured", ex.bands.measured, { colour: "measured", width: 3 });
    for (const m of ex.shown()) put(`error, ${m.name}`, ex.bands.errors[m.key], { colour: m.colour, dash: m.dash });
    if (sigma > 0) {
      const { f } = ex.bands.measured;
      traces.push(Panels.line("noise", [f[0], f[f.length - 1]], Array(2).fill(2 * grid.step * sigma ** 2), { colour: "muted", dash: "dash", width: 1 }));
    }
    const chosen = ex.chosen();
    if (chosen && !chosen.band) put("error while selected", Signals.density(ex.error, chosen.keep, grid.step), { colour: "accent", width: 2 });
    const { f } = ex.bands.measured;
    ex.extents.frequency = [f[0], f[f.length - 1]];
    const u = ex.spec.unit;
    plot.draw(traces, {
      dragmode: ex.drag, hovermode: "closest", shapes: ex.selection?.kind === "frequency" ? [shade(ex.selection)] : [],
      xaxis: Panels.logAxis("frequency [Hz]", ex.views.frequency ?? ex.extents.frequency),
      yaxis: Panels.logAxis(u ? `density [${/[^\w]/.test(u) ? `(${u})` : u}²/Hz]` : "density [1/Hz]", Panels.positive(traces.map((t) => t.y)), { fixedrange: true }),
    }, 330);
    wire(ex, plot, "frequency");
    ex.captions.frequency.textContent = `Spectral density of the measured ${ex.spec.channel} (grey) and of the errors${sigma > 0 ? "; dashed: the noise" : ""}.`;
  }

  function wire(ex, plot, part) {
    if (plot.wired) return;
    plot.wired = true;
    plot.gd.on("plotly_relayout", (change) => {
      const range = Panels.zoomed(change, part === "frequency");
      if (range) { ex.views[part] = range; ex.redraw(part); }
    });
    plot.gd.on("plotly_doubleclick", () => ex.step(part, "reset"));
  }

  // ---- state --------------------------------------------------------------------------------------------------------------

  function state(ex) {
    if (!ex.now) return;
    const plot = ex.plots.state;
    const { state: recorded, error } = ex;
    if (!recorded || !error) return;
    const { counted } = ex.now;
    const shown = (i) => (!counted || counted[i]) && Number.isFinite(error[i]) && Number.isFinite(recorded.values[i]);
    const every = Math.max(1, Math.ceil(error.length / POINTS));
    ex.drawn = [];
    for (let i = 0; i < error.length; i += every) if (shown(i)) ex.drawn.push(i);
    const m = ex.spec.models.find((o) => o.key === ex.model);
    const dots = (name, at, values, options) => ({
      type: "scatter", mode: "markers", name, x: at.map((i) => recorded.values[i]), y: at.map((i) => values[i]), hoverinfo: "skip",
      marker: { color: Panels.colour(options.colour), size: options.size, opacity: options.opacity },
    });
    const traces = [dots("error", ex.drawn, error, { colour: m.colour, size: 4, opacity: 0.35 })];
    const chosen = ex.chosen();
    if (chosen && ex.selection.kind !== "state") {
      const at = chosen.band ? ex.drawn : some(chosen.keep, shown);
      traces.push(dots("selected", at, chosen.band ?? error, { colour: "accent", size: 4, opacity: 0.6 }));
    }
    const mean = means(recorded.values, error, shown);
    traces.push(Panels.line("mean", mean.x, mean.y, { colour: "ink", width: 2, points: true, hovertemplate: "%{x:.4~g}: mean error %{y:.4~g}<extra></extra>" }));
    ex.extents.state = mean.extent;
    const u = ex.spec.unit ? ` [${ex.spec.unit}]` : "";
    const name = ex.choose.state.value;
    plot.draw(traces, {
      dragmode: ex.drag, hovermode: "closest", shapes: ex.selection?.kind === "state" ? [shade(ex.selection)] : [],
      xaxis: Panels.axis(`${name}${recorded.unit ? ` [${recorded.unit}]` : ""}`, { range: ex.views.state ?? mean.extent, zeroline: false }),
      yaxis: Panels.axis(`error${u}`, { fixedrange: true }),
    }, 330);
    wire(ex, plot, "state");
    ex.captions.state.textContent = `Error of the ${m.name} model over the recorded ${name}; line: its mean in ${BINS} bins. ${every > 1 ? `One of ${every} samples is drawn.` : "Every sample is drawn."}`;
    ex.mark();
  }

  // At most so many of the samples that are kept, evenly.
  function some(keep, shown) {
    const all = [];
    for (let i = 0; i < keep.length; i += 1) if (keep[i] && shown(i)) all.push(i);
    const every = Math.max(1, Math.ceil(all.length / POINTS));
    return all.filter((_, k) => k % every === 0);
  }

  function means(x, y, shown) {
    let low = Infinity;
    let high = -Infinity;
    for (let i = 0; i < x.length; i += 1) if (shown(i)) { low = Math.min(low, x[i]); high = Math.max(high, x[i]); }
    if (!(high > low)) return { x: [], y: [], extent: [low - 1, low + 1] };
    const sum = new Float64Array(BINS);
    const n = new Float64Array(BINS);
    const width = (high - low) / BINS;
    for (let i = 0; i < x.length; i += 1) {
      if (!shown(i)) continue;
      const k = Math.min(BINS - 1, Math.floor((x[i] - low) / width));
      sum[k] += y[i];
      n[k] += 1;
    }
    const out = { x: [], y: [], extent: [low - 0.02 * (high - low), high + 0.02 * (high - low)] };
    for (let k = 0; k < BINS; k += 1) if (n[k] >= 5) { out.x.push(low + (k + 0.5) * width); out.y.push(sum[k] / n[k]); }
    return out;
  }

  return { time, frequency, state };
})();
