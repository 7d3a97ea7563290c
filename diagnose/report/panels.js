"use strict";
// Plotly in the colours of the page: layout, overlays for cursor and selection, keys, redrawing with the theme.
const Panels = (() => {
  const NARROW = 560; // [px]
  const known = new Map();
  const drawn = new Set(); // functions that draw again when the colours change
  const probe = document.createElement("span");
  probe.hidden = true;
  document.body.append(probe);

  function colour(name) {
    if (!known.has(name)) {
      probe.style.color = `var(--${name})`;
      known.set(name, getComputedStyle(probe).color);
    }
    return known.get(name);
  }

  document.addEventListener("simgap-theme", () => {
    known.clear();
    for (const redraw of drawn) redraw();
  });

  const coarse = matchMedia("(pointer: coarse)").matches;
  const CONFIG = { displayModeBar: false, displaylogo: false, responsive: true, scrollZoom: false, doubleClick: false };

  function axis(title, options = {}) {
    const out = {
      title: { text: title, standoff: 6 }, gridcolor: colour("grid"), zerolinecolor: colour("line"), linecolor: colour("muted"),
      tickcolor: colour("muted"), tickfont: { color: colour("ink"), size: 12 }, ticks: "outside", ticklen: 4, showline: true,
      exponentformat: "e", minexponent: 4, hoverformat: ".4~g", ...options,
    };
    return out;
  }

  const RAISED = { "-": "\u207b", 0: "\u2070", 1: "\u00b9", 2: "\u00b2", 3: "\u00b3", 4: "\u2074", 5: "\u2075", 6: "\u2076", 7: "\u2077", 8: "\u2078", 9: "\u2079" };

  // A logarithmic axis from low to high with ticks at the decades, and between them where it shows few of them. Plotly's own
  // powers of ten set style attributes, which the page's policy does not allow.
  function logAxis(title, [low, high], options = {}) {
    const [a, b] = [Math.log10(low), Math.log10(high)];
    const factors = b - a < 1.2 ? [1, 1.5, 2, 3, 4, 5, 6, 8] : b - a < 2.2 ? [1, 2, 5] : [1];
    const every = Math.max(1, Math.ceil((b - a) / 8));
    const values = [];
    for (let k = Math.floor(a); k <= Math.ceil(b); k += 1) if (k % every === 0) values.push(...factors.map((f) => f * 10 ** k));
    const text = values.map((v) => {
      const k = Math.floor(Math.log10(v) + 1e-9);
      if (k >= -2 && k <= 4) return String(Number(v.toPrecision(3)));
      const f = Number((v / 10 ** k).toPrecision(2));
      return `${f === 1 ? "" : `${f}\u00b7`}10${[...String(k)].map((c) => RAISED[c]).join("")}`;
    });
    return axis(title, { type: "log", range: [a, b], tickmode: "array", tickvals: values, ticktext: text, hoverformat: ".3~g", ...options });
  }

  // Least and greatest positive value of several curves, with a margin on a logarithmic axis.
  function positive(curves) {
    let low = Infinity;
    let high = 0;
    for (const y of curves) for (const v of y) if (v > 0 && Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
    return high > 0 ? [low / 1.3, high * 1.3] : [0.1, 1];
  }

  // The horizontal stretch of a relayout event, null where it is about something else.
  function zoomed(change, log) {
    const range = change["xaxis.range"] ?? (change["xaxis.range[0]"] === undefined ? null : [change["xaxis.range[0]"], change["xaxis.range[1]"]]);
    return range && log ? range.map((v) => 10 ** v) : range;
  }

  function layout(options) {
    return {
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: colour("ink") },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: false,
      dragmode: coarse ? false : "zoom", margin: { l: 68, r: 14, t: 10, b: 46 },
      hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("line"), font: { color: colour("ink") } }, ...options,
    };
  }

  function line(name, x, y, options = {}) {
    const { colour: c, width = 1.3, dash = "", points = false, ...rest } = options;
    return {
      type: "scatter", mode: points ? "lines+markers" : "lines", name, x, y, connectgaps: false,
      line: { color: colour(c), width, dash: dash || "solid", simplify: false }, marker: { color: colour(c), size: 5 }, ...rest,
    };
  }

  // A plot in an element: Plotly below, an overlay for a cursor, and a brush that catches the pointer where one selects.
  class Plot {
    constructor(live) {
      this.live = live;
      this.figure = live.closest("figure");
      this.gd = document.createElement("div");
      this.gd.className = "gd";
      this.mark = document.createElement("div");
      this.mark.className = "cursor";
      this.dot = document.createElement("div");
      this.dot.className = "pointer";
      this.mark.hidden = true;
      this.dot.hidden = true;
      live.append(this.gd, this.mark, this.dot);
    }

    get width() { return this.live.clientWidth || this.figure.clientWidth; }

    draw(traces, options, height) {
      this.figure.classList.add("on");
      this.gd.style.height = `${height}px`;
      const first = !this.gd._fullLayout;
      const made = Plotly.react(this.gd, traces, layout(options), CONFIG);
      if (first) this.gd.on("plotly_afterplot", () => this.moved?.());
      return made;
    }

    axes(name = "xaxis", other = "yaxis") {
      const full = this.gd._fullLayout;
      return full && full[name] ? { x: full[name], y: full[other], size: full._size } : null;
    }

    // Horizontal data value of a pointer event, null outside the axes.
    at(event, name = "xaxis") {
      const a = this.axes(name);
      if (!a) return null;
      const px = event.clientX - this.gd.getBoundingClientRect().left - a.x._offset;
      return px < 0 || px > a.x._length ? null : a.x.p2d(px);
    }

    cursor(x) {
      const a = this.axes();
      const px = a ? a.x.d2p(x) : NaN;
      this.mark.hidden = !(px >= 0 && px <= a.x._length);
      if (this.mark.hidden) return;
      this.mark.style.transform = `translateX(${px + a.x._offset}px)`;
      this.mark.style.top = `${a.size.t}px`;
      this.mark.style.height = `${a.size.h}px`;
    }

    point(x, y) {
      const a = this.axes();
      const px = a ? a.x.d2p(x) : NaN;
      const py = a ? a.y.d2p(y) : NaN;
      this.dot.hidden = !(px >= 0 && px <= a?.x._length && py >= 0 && py <= a?.y._length);
      if (!this.dot.hidden) this.dot.style.transform = `translate(${px + a.x._offset}px, ${py + a.y._offset}px)`;
    }

    // Lets the pointer mark a stretch of the horizontal axis: done(low, high).
    brush(done) {
      const pane = document.createElement("div");
      const box = document.createElement("div");
      pane.className = "brush";
      box.className = "box";
      pane.append(box);
      pane.hidden = true;
      this.live.append(pane);
      let from = null;
      const edge = (event) => {
        const a = this.axes();
        const px = event.clientX - this.gd.getBoundingClientRect().left - a.x._offset;
        return Signals.clamp(px, 0, a.x._length);
      };
      const show = (to) => {
        const a = this.axes();
        box.style.left = `${a.x._offset + Math.min(from, to)}px`;
        box.style.width = `${Math.abs(to - from)}px`;
        box.style.top = `${a.size.t}px`;
        box.style.height = `${a.size.h}px`;
      };
      pane.addEventListener("pointerdown", (event) => { from = edge(event); pane.setPointerCapture(event.pointerId); show(from); box.hidden = false; });
      pane.addEventListener("pointermove", (event) => { if (from !== null) show(edge(event)); });
      pane.addEventListener("pointercancel", () => { from = null; box.hidden = true; });
      pane.addEventListener("pointerup", (event) => {
        if (from === null) return;
        const to = edge(event);
        const a = this.axes();
        const ends = [a.x.p2d(Math.min(from, to)), a.x.p2d(Math.max(from, to))];
        box.hidden = true;
        if (Math.abs(to - from) > 3) done(...ends);
        from = null;
      });
      box.hidden = true;
      return pane;
    }
  }

  // Stretch [low, high] after a step of a key or a button; on a logarithmic axis in its logarithm.
  function stepped(action, [low, high], [first, last], log) {
    if (action === "reset") return [first, last];
    const to = log ? Math.log10 : (v) => v;
    const from = log ? (v) => 10 ** v : (v) => v;
    const [a, b, c, d] = [low, high, first, last].map(to);
    const middle = (a + b) / 2;
    let half = (b - a) / 2;
    let centre = middle;
    if (action === "in") half *= 0.5;
    if (action === "out") half *= 2;
    if (action === "left") centre -= 0.5 * half;
    if (action === "right") centre += 0.5 * half;
    half = Math.min(half, (d - c) / 2);
    centre = Signals.clamp(centre, c + half, d - half);
    return [from(centre - half), from(centre + half)];
  }

  const KEYS = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", 0: "reset" };

  // Keys on a plot that has the focus.
  function keys(live, act) {
    live.addEventListener("keydown", (event) => {
      const action = event.ctrlKey || event.metaKey || event.altKey ? undefined : KEYS[event.key];
      if (action && event.target === live) { event.preventDefault(); act(action); }
    });
  }

  // The plot is drawn once it comes near the window, and again when the theme or the width class changes.
  function whenSeen(element, draw) {
    let narrow = null;
    const redraw = () => { if (narrow !== null) draw(); };
    drawn.add(redraw);
    const watch = new IntersectionObserver((entries) => {
      if (!entries.some((e) => e.isIntersecting)) return;
      watch.disconnect();
      narrow = element.clientWidth < NARROW;
      draw();
      new ResizeObserver(() => {
        const now = element.clientWidth < NARROW;
        if (element.clientWidth && now !== narrow) { narrow = now; draw(); }
      }).observe(element);
    }, { rootMargin: "200px" });
    watch.observe(element);
  }

  // An entry of a legend that is not clicked.
  function entry(name, text, dash, block) {
    const out = document.createElement("span");
    out.append(key(name, dash, block), text);
    return out;
  }

  // A sample of a line or a band for a legend.
  function key(name, dash, block = false) {
    const mark = document.createElement("span");
    mark.className = `key c-${name} ${block ? "block" : dash}`;
    mark.setAttribute("aria-hidden", "true");
    return mark;
  }

  return { key, entry, NARROW, colour, axis, logAxis, positive, zoomed, line, Plot, stepped, keys, whenSeen, coarse };
})();
