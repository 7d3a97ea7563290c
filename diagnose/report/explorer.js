"use strict";
// Recordings beside models: signals and errors over time, the density of an error, an error over a state; one cursor and one
// selection through all of them.
class Explorer {
  constructor(section, spec) {
    this.spec = spec;
    this.section = section;
    this.choose = Object.fromEntries([...section.querySelectorAll("[data-choose]")].map((e) => [e.dataset.choose, e]));
    this.say = Object.fromEntries([...section.querySelectorAll("[data-say]")].map((e) => [e.dataset.say, e]));
    this.captions = Object.fromEntries([...section.querySelectorAll("[data-caption]")].map((e) => [e.dataset.caption, e]));
    this.plots = {};
    for (const part of ["time", "frequency", "state"]) this.plots[part] = new Panels.Plot(section.querySelector(`[data-part="${part}"] .live`));
    this.film = section.querySelector("video");
    if (this.film) {
      this.film.controls = false; // the slider moves it
      this.film.addEventListener("loadeddata", () => this.mark());
    }
    this.hidden = new Set(); // models that the legend switches off
    this.selection = null;
    this.moment = 0;
    this.mode = Panels.coarse ? "" : "zoom";
    this.loaded = new Map();
    this.listen();
    this.legend();
    this.started = false;
    const start = () => { if (!this.started) { this.started = true; this.open(); } };
    Panels.whenSeen(this.plots.time.figure, () => { start(); this.drawTime(); });
    Panels.whenSeen(this.plots.frequency.figure, () => { start(); this.drawFrequency(); });
    Panels.whenSeen(this.plots.state.figure, () => { start(); this.drawState(); });
  }

  // ---- data -------------------------------------------------------------------------------------------------------------

  get model() { return this.choose.model.value; }

  get error() { return this.now.errors[this.model] ?? Object.values(this.now.errors)[0]; }

  get state() { return this.now.states[this.choose.state.value] ?? null; }

  open() {
    const index = Number(this.choose.recording.value);
    if (!this.loaded.has(index)) this.loaded.set(index, this.decode(this.spec.recordings[index]));
    this.now = this.loaded.get(index);
    const { grid } = this.now;
    this.all = [grid.at(0), grid.at(grid.n - 1)];
    this.view = [...this.all];
    this.bands = null;
    this.views = {};
    this.extents = {};
    this.choose.moment.max = grid.n - 1;
    for (const option of this.choose.model.options) option.disabled = !(option.value in this.now.errors);
    if (!(this.model in this.now.errors)) this.choose.model.value = Object.keys(this.now.errors)[0];
    this.moment = this.worst();
    this.choose.moment.value = this.moment;
    for (const option of this.choose.kind.options) if (option.value === "frequency") option.disabled = grid.step === null;
    if (this.film) this.film.closest("figure").hidden = Number(this.film.dataset.recording) !== index;
  }

  // The sample at which the error is largest: where the slider starts.
  worst() {
    const { error } = this;
    const { counted } = this.now;
    let at = 0;
    let most = -1;
    for (let i = 0; i < error.length; i += 1) if ((!counted || counted[i]) && Math.abs(error[i]) > most) { most = Math.abs(error[i]); at = i; }
    return at;
  }

  decode(r) {
    const grid = Signals.grid(r.time);
    const measured = Signals.values(r.measured);
    const models = Object.fromEntries(Object.entries(r.models).map(([k, v]) => [k, Signals.values(v)]));
    const errors = Object.fromEntries(Object.entries(models).map(([k, y]) => [k, measured.map((m, i) => m - y[i])]));
    const states = Object.fromEntries(Object.entries(r.states).map(([k, s]) => [k, { unit: s.unit, values: Signals.values(s.values) }]));
    let counted = null;
    if (r.counted) {
      counted = new Uint8Array(grid.n);
      for (let i = 0; i < r.counted.length; i += 2) counted.fill(1, r.counted[i], r.counted[i + 1]);
    }
    return { ...r, grid, measured, models, errors, states, counted, edges: r.counted };
  }

  // ---- controls -----------------------------------------------------------------------------------------------------------

  listen() {
    const again = () => { this.drawTime(); this.drawFrequency(); this.drawState(); this.tell(); };
    this.choose.recording.addEventListener("change", () => { this.stop(); this.selection = null; this.open(); again(); this.bound(); });
    this.choose.model.addEventListener("change", again);
    this.choose.state.addEventListener("change", () => { delete this.views.state; if (this.selection?.kind === "state") this.selection = null; again(); });
    this.choose.kind.addEventListener("change", () => this.bound());
    this.choose.moment.addEventListener("input", () => { this.stop(); this.go(Number(this.choose.moment.value)); });
    this.section.addEventListener("click", (event) => {
      const button = event.target.closest("button[data-do]");
      if (button && this.now) this.act(button.dataset.do);
    });
    this.section.querySelector("form").addEventListener("submit", (event) => {
      event.preventDefault();
      const ends = [this.choose.low, this.choose.high].map((e) => (e.value === "" ? NaN : Number(e.value)));
      if (ends.every(Number.isFinite) && ends[1] > ends[0]) this.select(this.choose.kind.value, ...ends);
      else this.say.selection.textContent = "A selection needs two numbers, the smaller one first.";
    });
    for (const [part, plot] of Object.entries(this.plots)) {
      plot.pane = plot.brush((low, high) => this.select(part, low, high));
      plot.moved = () => this.mark();
      Panels.keys(plot.live, (action) => this.step(part, action));
      plot.live.addEventListener("pointermove", (event) => this.hover(part, event));
    }
    this.setMode(this.mode);
  }

  act(action) {
    if (["zoom", "pan", "select"].includes(action)) this.setMode(this.mode === action && Panels.coarse ? "" : action);
    else if (action === "play") this.play();
    else if (action === "clear") this.select(null);
    else if (action === "csv") this.save();
    else this.step("time", action);
  }

  setMode(mode) {
    this.mode = mode;
    for (const b of this.section.querySelectorAll("button[aria-pressed][data-do]")) {
      if (["zoom", "pan", "select"].includes(b.dataset.do)) b.setAttribute("aria-pressed", String(b.dataset.do === mode));
    }
    for (const plot of Object.values(this.plots)) {
      plot.pane.hidden = mode !== "select";
      if (plot.gd._fullLayout) Plotly.relayout(plot.gd, { dragmode: this.drag });
    }
  }

  get drag() { return this.mode === "zoom" || this.mode === "pan" ? this.mode : false; }

  step(part, action) {
    if (part === "time") {
      this.view = Panels.stepped(action, this.view, this.all, false);
      this.drawTime();
      return;
    }
    if (!this.extents[part]) return;
    this.views[part] = Panels.stepped(action, this.views[part] ?? this.extents[part], this.extents[part], part === "frequency");
    this.redraw(part);
  }

  redraw(part) { if (part === "frequency") this.drawFrequency(); else this.drawState(); }

  legend() {
    const box = this.section.querySelector(".legend");
    box.append(Panels.entry("measured", `measured ${this.spec.channel}`, "thick"));
    for (const m of this.spec.models) {
      const button = document.createElement("button");
      button.type = "button";
      button.setAttribute("aria-pressed", "true");
      button.title = `Show or hide: ${m.name}`;
      button.append(Panels.key(m.colour, m.dash), m.name);
      button.addEventListener("click", () => {
        if (!this.hidden.delete(m.key)) this.hidden.add(m.key);
        button.setAttribute("aria-pressed", String(!this.hidden.has(m.key)));
        this.drawTime();
        this.drawFrequency();
      });
      box.append(button);
    }
  }

  shown() { return this.spec.models.filter((m) => m.key in this.now.models && !this.hidden.has(m.key)); }

  drawTime() { Views.time(this); }

  drawFrequency() { Views.frequency(this); }

  drawState() { Views.state(this); }

  // ---- one selection --------------------------------------------------------------------------------------------------------

  select(kind, low, high) {
    this.selection = kind ? { kind, low, high } : null;
    this.kept = null;
    if (kind) {
      this.choose.kind.value = kind;
      this.choose.low.value = Number(low.toPrecision(5));
      this.choose.high.value = Number(high.toPrecision(5));
    } else { this.choose.low.value = ""; this.choose.high.value = ""; }
    this.bound();
    this.drawTime();
    this.drawFrequency();
    this.drawState();
    this.tell();
  }

  bound() {
    const { kind } = Object.fromEntries([["kind", this.choose.kind.value]]);
    this.say.unit.textContent = kind === "time" ? "s" : kind === "frequency" ? "Hz" : this.state?.unit ?? "";
  }

  // Samples of the selection (keep), or the error in the selected band.
  chosen() {
    const s = this.selection;
    if (!s) return null;
    const { grid, counted } = this.now;
    const { error } = this;
    const key = `${s.kind} ${s.low} ${s.high} ${this.model} ${this.choose.state.value} ${this.choose.recording.value}`;
    if (this.kept?.key === key) return this.kept;
    if (s.kind === "frequency") {
      const inside = error.map((e, i) => (counted && !counted[i] ? 0 : e));
      this.kept = { key, band: Signals.band(inside, s.low, s.high, grid.step) };
      return this.kept;
    }
    const x = s.kind === "time" ? null : this.state.values;
    const keep = new Uint8Array(grid.n);
    for (let i = 0; i < grid.n; i += 1) {
      const v = x ? x[i] : grid.at(i);
      keep[i] = v >= s.low && v <= s.high && (!counted || counted[i]) ? 1 : 0;
    }
    this.kept = { key, keep };
    return this.kept;
  }

  // What the selection holds of the error, in words.
  tell() {
    if (!this.now) return;
    const s = this.selection;
    const name = this.spec.models.find((m) => m.key === this.model).name;
    if (!s) {
      this.say.selection.textContent = "Nothing is selected. Choose Select and drag in a plot, or give two numbers: the selected stretch is marked in all plots.";
      return;
    }
    const all = Signals.meanSquare(this.error, this.now.counted);
    const chosen = this.chosen();
    const part = chosen.band ? Signals.meanSquare(chosen.band, this.now.counted) : Signals.meanSquare(this.error, chosen.keep);
    const unit = { time: "s", frequency: "Hz", state: this.state?.unit ?? "" }[s.kind];
    const what = s.kind === "state" ? this.choose.state.value : s.kind;
    const share = all.sum > 0 ? part.sum / all.sum : 0;
    const samples = chosen.band ? "" : ` ${percent(part.n / Math.max(1, all.n))} of the samples,`;
    this.say.selection.textContent = part.n === 0 ? "The selection holds no sample."
      : `Selected, ${what} from ${number(s.low)} to ${number(s.high)} ${unit}:${samples} ${percent(share)} of the squared error of the model "${name}", ${number(Math.sqrt(part.sum / part.n))} ${this.spec.unit} rms.`;
    this.say.selection.prepend(Panels.key("accent", "thick"));
    function percent(v) { return `${(100 * v).toPrecision(v >= 0.9995 ? 3 : 2)} %`; }
  }

  // ---- one cursor -----------------------------------------------------------------------------------------------------------

  hover(part, event) {
    if (!this.now || event.pointerType === "touch" || this.timer) return;
    if (part === "time") {
      const t = this.plots.time.at(event);
      if (t !== null) this.go(this.now.grid.index(t));
    } else if (part === "state" && this.drawn && this.state) {
      const plot = this.plots.state;
      const a = plot.axes();
      if (!a) return;
      const box = plot.gd.getBoundingClientRect();
      const [px, py] = [event.clientX - box.left - a.x._offset, event.clientY - box.top - a.y._offset];
      let best = 144; // 12 px
      let found = -1;
      for (const i of this.drawn) {
        const d = (a.x.d2p(this.state.values[i]) - px) ** 2 + (a.y.d2p(this.error[i]) - py) ** 2;
        if (d < best) { best = d; found = i; }
      }
      if (found >= 0) this.go(found);
    } else if (part === "frequency") {
      const f = this.plots.frequency.at(event);
      if (f !== null) this.plots.frequency.cursor(f);
    }
  }

  go(index) {
    this.moment = index;
    this.choose.moment.value = index;
    this.mark();
  }

  mark() {
    if (!this.now) return;
    const { grid, measured, models, errors, states } = this.now;
    const i = this.moment;
    const t = grid.at(i);
    this.plots.time.cursor(t);
    if (this.state) this.plots.state.point(this.state.values[i], this.error[i]);
    const text = `${t.toFixed(4)} s`;
    this.say.moment.textContent = text;
    this.choose.moment.setAttribute("aria-valuetext", text);
    const rows = [[`measured ${this.spec.channel}`, "measured", measured[i], this.spec.unit]];
    for (const m of this.spec.models) {
      if (m.key in models) rows.push([m.name, m.colour, models[m.key][i], this.spec.unit, errors[m.key][i]]);
    }
    for (const [name, s] of Object.entries(states)) if (name !== this.spec.channel) rows.push([name, "", s.values[i], s.unit]);
    this.read(rows);
    this.follow(t);
  }

  read(rows) {
    const list = this.say.values;
    if (list.childElementCount !== rows.length) {
      list.replaceChildren(...rows.map(([name, colour]) => {
        const group = document.createElement("div");
        const term = document.createElement("dt");
        if (colour) term.append(Panels.key(colour, ""));
        term.append(name);
        group.append(term, document.createElement("dd"));
        return group;
      }));
    }
    rows.forEach(([name, , value, unit, error], k) => {
      const group = list.children[k];
      group.firstChild.lastChild.textContent = name;
      group.lastChild.textContent = `${number(value)} ${unit}${error === undefined ? "" : `, error ${number(error)}`}`;
    });
  }

  follow(t) {
    const v = this.film;
    if (!v || v.closest("figure").hidden || v.readyState < 1) return;
    const wanted = Signals.clamp((t - Number(v.dataset.start)) / Number(v.dataset.speed), 0, v.duration);
    if (Math.abs(v.currentTime - wanted) > 0.04 && !v.seeking) v.currentTime = wanted;
  }

  play() {
    if (this.timer) { this.stop(); return; }
    const { grid } = this.now;
    const button = this.section.querySelector('[data-do="play"]');
    button.setAttribute("aria-pressed", "true");
    button.textContent = "Stop";
    if (this.moment >= grid.n - 1) this.go(0);
    let last = performance.now();
    let t = grid.at(this.moment);
    const frame = (now) => {
      t += (now - last) / 1000;
      last = now;
      this.go(grid.index(t));
      if (t >= this.all[1]) this.stop(); else this.timer = requestAnimationFrame(frame);
    };
    this.timer = requestAnimationFrame(frame);
  }

  stop() {
    if (!this.timer) return;
    cancelAnimationFrame(this.timer);
    this.timer = null;
    const button = this.section.querySelector('[data-do="play"]');
    button.setAttribute("aria-pressed", "false");
    button.textContent = "Play";
  }

  // The recording and the models on it as a CSV file.
  save() {
    const { grid, measured, models, states, source } = this.now;
    const columns = [["time_s", null], [`measured_${this.spec.channel}`, measured], ...Object.entries(models), ...Object.entries(states).filter(([k]) => k !== this.spec.channel).map(([k, s]) => [k, s.values])];
    const lines = [columns.map(([k]) => k).join(",")];
    for (let i = 0; i < grid.n; i += 1) lines.push(columns.map(([, y]) => (y ? Number(y[i].toPrecision(7)) : Number(grid.at(i).toPrecision(9)))).join(","));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }));
    link.download = `${source.replace(/\.[^.]*$/, "").replace(/[^\w.-]+/g, "_") || "recording"}_simulated.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}

// Four significant digits, with a true minus sign.
function number(v) {
  if (!Number.isFinite(v)) return "–";
  const text = v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e5) ? v.toExponential(2) : v.toPrecision(4);
  return text.replace("-", "\u2212");
}
