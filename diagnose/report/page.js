"use strict";
// Charts of a page: a grid of panels from a description, stacked on a narrow screen. Then all explorers are started.
(() => {
  const data = JSON.parse(document.getElementById("simgap-data").textContent);
  const COLUMNS = 700;

  function decoded(spec) {
    for (const panel of spec.rows.flat()) {
      for (const m of panel.marks) {
        if (m.kind === "band") Object.assign(m, { x: Signals.values(m.x), low: Signals.values(m.low), high: Signals.values(m.high) });
        else Object.assign(m, { grid: Signals.grid(m.x), y: Signals.values(m.y) });
      }
    }
    return spec;
  }

  class Chart {
    constructor(figure, spec) {
      this.spec = decoded(spec);
      this.figure = figure;
      this.plot = new Panels.Plot(figure.querySelector(".live"));
      this.view = null; // horizontal stretch of the first column, null for all
      figure.querySelector(".tools").addEventListener("click", (event) => {
        const action = event.target.closest("button")?.dataset.do;
        if (action) this.act(action);
      });
      Panels.keys(this.plot.live, (action) => this.act(action));
      Panels.whenSeen(figure, () => this.draw());
    }

    act(action) {
      const [panel] = this.spec.rows[0];
      const all = this.extent(panel);
      this.view = action === "reset" ? null : Panels.stepped(action, this.view ?? all, all, panel.x.log);
      this.draw();
    }

    extent(panel) {
      if (panel.x.limits) return panel.x.limits;
      let low = Infinity;
      let high = -Infinity;
      for (const m of panel.marks) {
        const ends = m.kind === "band" ? [m.x[0], m.x[m.x.length - 1]] : [m.grid.at(0), m.grid.at(m.grid.n - 1)];
        low = Math.min(low, ...ends);
        high = Math.max(high, ...ends);
      }
      if (panel.x.log) return low > 0 ? [low, high] : [1e-3, high];
      const margin = panel.marks.some((m) => m.points) ? 0.02 * (high - low) : 0;
      return [low - margin, high + margin];
    }

    draw() {
      const narrow = this.plot.width < Panels.NARROW;
      const { rows } = this.spec;
      const wide = Math.max(...rows.map((r) => r.length));
      const cells = rows.flatMap((row, i) => row.map((panel, k) => ({ panel, i, k })));
      const stacked = narrow && wide > 1;
      const places = stacked ? this.stack(cells) : this.grid(rows, wide);
      const traces = [];
      const options = { annotations: [], shapes: [], hovermode: "closest", margin: { l: narrow ? 56 : 68, r: 12, t: this.top(), b: 46 } };
      const seen = new Set();
      cells.forEach(({ panel, i, k }, n) => {
        const id = n === 0 ? "" : n + 1;
        const [x, y] = [`x${id}`, `y${id}`];
        const place = places[n];
        const lead = stacked ? n : cells.findIndex((c) => c.k === k); // panels of a column share their horizontal axis
        const horizontal = { domain: place.x, anchor: y, showticklabels: place.titled, ...(lead !== n ? { matches: `x${lead === 0 ? "" : lead + 1}` } : {}) };
        const range = this.view && k === 0 ? this.view : this.extent(panel);
        const title = place.titled ? panel.x.title : "";
        options[`xaxis${id}`] = panel.x.log ? Panels.logAxis(title, range, horizontal) : Panels.axis(title, { range, ...horizontal });
        const vertical = { domain: place.y, anchor: x, fixedrange: panel.y.log };
        const name = stacked || place.first || place.own ? panel.y.title : "";
        options[`yaxis${id}`] = panel.y.log ? Panels.logAxis(name, panel.y.limits ?? Panels.positive(panel.marks.map((m) => m.y ?? m.high)), vertical)
          : Panels.axis(name, { ...(panel.y.limits ? { range: panel.y.limits } : {}), ...vertical });
        for (const m of panel.marks) {
          for (const t of this.traces(m, panel, x, y)) {
            if (m.name) seen.add(m.name);
            traces.push(t);
          }
        }
        for (const s of panel.spans) this.span(s, panel, x, y, options);
        if (panel.title) options.annotations.push(this.text(panel.title, { xref: `${x} domain`, yref: `${y} domain`, x: 0, y: 1, xanchor: "left", yanchor: "bottom" }));
      });
      this.legend([...seen]);
      const height = stacked ? cells.length * Math.max(220, this.spec.height * 0.8) : this.spec.height + 40;
      this.plot.draw(traces, options, height);
      if (this.wired) return;
      this.wired = true;
      this.plot.gd.on("plotly_relayout", (change) => {
        const range = Panels.zoomed(change, this.spec.rows[0][0].x.log);
        if (range) { this.view = range; this.draw(); }
      });
      this.plot.gd.on("plotly_doubleclick", () => this.act("reset"));
    }

    top() { return this.spec.rows.flat().some((p) => p.title || p.spans.some((s) => s.label)) ? 26 : 12; }

    stack(cells) {
      const n = cells.length;
      const gap = 0.34 / n;
      return cells.map((_, i) => ({ x: [0, 1], y: [1 - (i + 1) / n + (i === n - 1 ? 0 : gap), 1 - i / n], titled: true, first: true }));
    }

    grid(rows, wide) {
      const widths = this.spec.widths.length ? this.spec.widths : Array(wide).fill(1);
      const total = widths.reduce((a, b) => a + b, 0);
      const gap = wide > 1 ? 0.055 : 0;
      const starts = widths.map((_, k) => (widths.slice(0, k).reduce((a, b) => a + b, 0) / total) * (1 + gap));
      return rows.flatMap((row, i) => row.map((panel, k) => ({
        x: [starts[k], Math.min(1, starts[k] + (widths[k] / total) * (1 + gap) - gap)],
        y: [1 - (i + 1) / rows.length + (i === rows.length - 1 ? 0 : 0.04), 1 - i / rows.length],
        titled: i === rows.length - 1 || k >= rows[i + 1].length, first: k === 0, own: panel.y.title !== row[0].y.title,
      })));
    }

    traces(m, panel, x, y) {
      const axes = { xaxis: x, yaxis: y };
      if (m.kind === "band") {
        const fill = { ...axes, hoverinfo: "skip", line: { width: 0, color: Panels.colour(m.colour) } };
        return [
          { type: "scatter", mode: "lines", x: [...m.x], y: [...m.low], ...fill },
          { type: "scatter", mode: "lines", x: [...m.x], y: [...m.high], fill: "tonexty", fillcolor: Panels.colour(m.colour), ...fill },
        ];
      }
      const [low, high] = this.view ?? this.extent(panel);
      const [i0, i1] = [m.grid.index(low), m.grid.index(high)];
      const e = Signals.envelope(m.grid, m.y, Math.max(0, i0 - 1), Math.min(m.grid.n - 1, i1 + 1), COLUMNS);
      return [Panels.line(m.name, e.x, e.y, { colour: m.colour, width: m.width, dash: m.dash, points: m.points, ...axes })];
    }

    span(s, panel, x, y, options) {
      options.shapes.push({
        type: "rect", xref: x, yref: `${y} domain`, x0: s.low, x1: s.high, y0: 0, y1: 1, layer: "below", line: { width: 0 },
        fillcolor: Panels.colour(s.colour), opacity: s.colour === "alarm" ? 0.35 : 1,
      });
      if (!s.label) return;
      const at = panel.x.log ? Math.log10(Math.sqrt(s.low * s.high)) : (s.low + s.high) / 2;
      const [a, b] = this.extent(panel).map((v) => (panel.x.log ? Math.log10(v) : v));
      const near = options.annotations.some((o) => o.span === x && Math.abs(o.x - at) < 0.08 * (b - a));
      if (!near && at >= a && at <= b) options.annotations.push({ ...this.text(s.label, { xref: x, yref: `${y} domain`, x: at, y: 1, yanchor: "bottom" }), span: x });
    }

    text(text, options) { return { text, showarrow: false, font: { size: 12 }, ...options }; }

    legend(names) {
      if (this.named || names.length < 2) return;
      this.named = document.createElement("p");
      this.named.className = "legend";
      const marks = this.spec.rows.flat().flatMap((p) => p.marks);
      for (const name of names) {
        const m = marks.find((o) => o.name === name);
        this.named.append(Panels.entry(m.colour, name, m.dash ?? "", m.kind === "band"));
      }
      this.plot.live.before(this.named);
    }
  }

  for (const section of document.querySelectorAll("[data-explorer]")) new Explorer(section, data.explorers[section.dataset.explorer]);
  for (const figure of document.querySelectorAll("[data-chart]")) new Chart(figure, data.charts[figure.dataset.chart]);
  document.documentElement.dataset.ready = "true";
})();
