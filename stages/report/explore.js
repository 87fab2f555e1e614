"use strict";
// Each .explore of a page is a group of films and charts with one clock [ms]. Pointing, playing, stepping and zooming in
// one of them changes all.

const dark = matchMedia("(prefers-color-scheme: dark)");
const LEAST_HEIGHT = 120; // of a chart above its legend [px]
const STEPS = [1, 2, 5]; // lengths of the scale bar of a film, times a power of ten

// The current colour of a theme name, or the colour itself.
function colour(name) {
  return name.startsWith("#") ? name : getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

// The index of the time that is nearest to t, in ascending times.
function nearest(times, t) {
  const after = times.findIndex((one) => one >= t);
  if (after < 1) return after < 0 ? times.length - 1 : 0;
  return times[after] - t < t - times[after - 1] ? after : after - 1;
}

function trace(pen, points, name, closed, width = 2) {
  pen.strokeStyle = colour(name);
  pen.lineWidth = width;
  pen.lineJoin = "round";
  pen.beginPath();
  points.forEach(([u, v]) => pen.lineTo(u, v));
  if (closed) pen.closePath();
  pen.stroke();
}

class Group {
  constructor(box) {
    this.members = [];
    this.t = null;
    this.whole = [Infinity, -Infinity];
    this.controls = box.querySelector(".controls") && new Controls(box, this);
    for (const film of box.querySelectorAll(".film")) this.members.push(new Film(film, this));
    for (const chart of box.querySelectorAll(".chart")) this.members.push(new Chart(chart, this));
    for (const jump of box.querySelectorAll("[data-t]")) jump.onclick = () => this.show(Number(jump.dataset.t));
    if (this.controls) this.controls.begin();
  }
  covers(times) {
    this.whole = [Math.min(this.whole[0], times[0]), Math.max(this.whole[1], times[times.length - 1])];
  }
  show(t, from) {
    if (from && this.controls) this.controls.stop(); // pointing stops playback
    this.t = Math.min(Math.max(t, this.whole[0]), this.whole[1]);
    for (const member of this.members) if (member !== from) member.show(this.t);
    if (this.controls) this.controls.show(this.t);
  }
  zoom(range, from) {
    for (const member of this.members) if (member !== from) member.zoom(range);
  }
  // Zoom to an interval `factor` times as long around the clock.
  closer(factor) {
    const chart = this.members.find((member) => member.plot);
    if (!chart) return;
    const [low, high] = chart.range(), half = ((high - low) * factor) / 2;
    const middle = this.t === null ? (low + high) / 2 : this.t;
    const range = [Math.max(middle - half, this.whole[0]), Math.min(middle + half, this.whole[1])];
    this.zoom(factor ? range : this.whole);
  }
  again() {
    for (const member of this.members) member.again();
  }
}

// Play, slider, speed, layers, and zoom without a mouse.
class Controls {
  constructor(box, group) {
    this.group = group;
    this.find = (name) => box.querySelector(".controls " + name);
    this.slider = this.find("input[type=range]");
    this.clock = this.find("output");
    this.button = this.find(".play");
    this.layers = [...box.querySelectorAll(".controls input[type=checkbox]")];
    this.times = this.find(".times");
    this.playing = null;
    this.plays = "plays" in box.dataset;
    this.button.onclick = () => (this.playing === null ? this.play() : this.stop());
    this.slider.oninput = () => {
      this.stop();
      group.show(Number(this.slider.value));
    };
    for (const one of [...this.layers, this.times]) if (one) one.onchange = () => group.again();
    this.find(".closer").onclick = () => group.closer(0.5);
    this.find(".whole").onclick = () => group.closer(0);
  }
  begin() {
    [this.slider.min, this.slider.max] = this.group.whole;
    const film = this.group.members.find((member) => member.data.start !== undefined);
    const start = film ? film.data.t[film.data.start] : this.group.whole[0];
    this.slider.value = start;
    this.show(start);
    if (this.plays && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.play();
  }
  show(t) {
    this.slider.value = t;
    this.clock.textContent = Math.round(t) + " ms";
    this.slider.setAttribute("aria-valuetext", this.clock.textContent);
  }
  play() {
    this.button.textContent = "Pause";
    const [first, last] = this.group.whole;
    const from = Number(this.slider.value) >= last ? first : Number(this.slider.value);
    let begun = null;
    const step = (now) => {
      begun = begun === null ? now : begun;
      const t = from + (now - begun) / Number(this.find("select").value);
      this.group.show(t);
      if (t >= last && this.plays) return this.play();
      if (t >= last) return this.stop();
      this.playing = requestAnimationFrame(step);
    };
    this.playing = requestAnimationFrame(step);
  }
  stop() {
    cancelAnimationFrame(this.playing);
    this.playing = null;
    this.button.textContent = "Play";
  }
}

// Strings over time, on camera frames if there are any.
class Film {
  constructor(box, group) {
    this.group = group;
    this.data = JSON.parse(box.querySelector("script").textContent);
    this.canvas = box.querySelector("canvas");
    this.pen = this.canvas.getContext("2d");
    this.images = (this.data.frames || []).map((source) => Object.assign(new Image(), { src: source }));
    this.index = this.data.start;
    this.stills = this.data.stills.map(([index, words]) => [this.still(box, words), index]);
    this.images.forEach((image) => (image.onload = () => this.again()));
    group.covers(this.data.t);
    this.again();
  }
  show(t) {
    this.index = nearest(this.data.t, t);
    this.draw(this.pen, this.index);
  }
  zoom() {}
  // A small picture of the film, in the strip below it.
  still(box, words) {
    const figure = document.createElement("figure"), canvas = document.createElement("canvas");
    const caption = document.createElement("figcaption");
    Object.assign(canvas, { width: this.data.width, height: this.data.height });
    caption.textContent = words;
    figure.append(canvas, caption);
    box.querySelector(".strip").append(figure);
    return canvas.getContext("2d");
  }
  again() {
    this.draw(this.pen, this.index);
    this.stills.forEach(([pen, index]) => this.draw(pen, index));
  }
  draw(pen, index) {
    const { data } = this, image = this.images[index];
    if (image && !image.complete) return;
    if (image) pen.drawImage(image, 0, 0, data.width, data.height);
    else pen.clearRect(0, 0, data.width, data.height);
    for (const [name, corners] of data.boxes) trace(pen, corners, name, true);
    if (data.metre) this.scale(pen);
    const { layers, times } = this.group.controls;
    for (const layer of layers.filter((one) => one.checked && data.strings[one.value])) {
      pen.globalAlpha = 0.35;
      if (data.paths) trace(pen, data.paths[layer.value], layer.dataset.colour, false, 1);
      pen.globalAlpha = 1;
      this.string(pen, index, layer, Number(times ? times.value : 1));
    }
  }
  // A string, its distance from the measured one magnified by `times`.
  string(pen, index, layer, times) {
    const points = this.data.strings[layer.value][index], measured = this.data.strings.measured[index];
    const away = (one, i) => one.map((u, k) => measured[i][k] + times * (u - measured[i][k]));
    const drawn = times === 1 ? points : points.map(away);
    if (!layer.dataset.dots) return trace(pen, drawn, layer.dataset.colour, false);
    pen.fillStyle = colour(layer.dataset.colour);
    for (const [u, v] of drawn) pen.fillRect(u - 2, v - 2, 4, 4);
  }
  // A scale bar of a round length, about a quarter of the film's width.
  scale(pen) {
    const most = this.data.width / 4 / this.data.metre, power = 10 ** Math.floor(Math.log10(most));
    const length = Math.max(...STEPS.filter((step) => step * power <= most)) * power;
    const v = this.data.height - 10;
    trace(pen, [[10, v], [10 + length * this.data.metre, v]], "soft", false);
    pen.fillStyle = colour("soft");
    pen.font = "13px system-ui, sans-serif";
    pen.fillText(Math.round(length * 1e3) + " mm", 10, v - 6);
  }
}

// Curves over time: hover, drag to zoom, double click or 0 for the whole; arrows, + and - on the keyboard.
class Chart {
  constructor(box, group) {
    this.box = box.querySelector(".plot");
    this.group = group;
    this.data = JSON.parse(box.querySelector("script").textContent);
    this.silent = false;
    group.covers(this.data.t);
    this.again();
    new ResizeObserver(() => requestAnimationFrame(() => this.plot.setSize(this.size()))).observe(this.box);
    this.box.onkeydown = (event) => this.key(event);
    dark.addEventListener("change", () => this.again());
  }
  size() {
    const legend = this.box.querySelector(".u-legend"), below = legend ? legend.offsetHeight : 0;
    return { width: Math.max(this.box.clientWidth, 120), height: Math.max(this.box.clientHeight - below, LEAST_HEIGHT) };
  }
  again() {
    if (this.plot && this.drawn === dark.matches) return;
    if (this.plot) this.plot.destroy();
    this.ready = false;
    this.drawn = dark.matches;
    const soft = colour("soft"), lines = { stroke: colour("grid"), width: 1 };
    const axis = { stroke: soft, grid: lines, ticks: lines, font: "11px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" };
    this.plot = new uPlot({
      ...this.size(),
      scales: { x: { time: false }, y: { range: (plot, low, high) => this.room(low, high) } },
      axes: [{ ...axis, size: 34, label: "time [ms]", labelSize: 20 }, { ...axis, size: 52, label: this.data.axis, labelSize: 20 }],
      series: [{ label: "ms", value: (plot, t) => (t === null ? "–" : t.toFixed(0)) }, ...this.data.lines.map((one) => this.line(one))],
      cursor: { y: false, drag: { x: true, y: false }, bind: { mouseleave: () => () => null, dblclick: () => () => this.group.closer(0) } },
      hooks: {
        drawClear: [(plot) => this.background(plot)],
        setCursor: [(plot) => this.pointed(plot)],
        setScale: [(plot, key) => key === "x" && this.ready && !this.silent && this.group.zoom(this.range(), this)],
        ready: [() => (this.ready = true)],
      },
    }, [this.data.t, ...this.data.lines.map((one) => one.values)], this.box);
    this.plot.setSize(this.size()); // above its legend
    if (this.group.t !== null) this.show(this.group.t);
  }
  line(one) {
    const value = (plot, v) => (v === null || v === undefined ? "–" : Number(v.toPrecision(3)) + "");
    return { label: one.label, stroke: colour(one.colour), width: 1.6, dash: one.dashed ? [5, 4] : [], points: { show: false }, value };
  }
  room(low, high) {
    if (low === null) return [0, 1];
    const room = 0.06 * (high - low || Math.abs(high) || 1);
    return [this.data.low === null ? low - room : this.data.low, high + room];
  }
  background(plot) {
    const { left, top, width, height } = plot.bbox, place = (t) => Math.min(Math.max(plot.valToPos(t, "x", true), left), left + width);
    if (this.data.moving) {
      plot.ctx.fillStyle = colour("axis") + "28";
      const [first, last] = this.data.moving.map(place);
      plot.ctx.fillRect(first, top, last - first, height);
    }
    const at = this.data.mark === null ? left : place(this.data.mark);
    if (at > left && at < left + width) {
      plot.ctx.fillStyle = colour("target");
      plot.ctx.fillRect(at, top, devicePixelRatio, height);
    }
  }
  range() {
    return [this.plot.scales.x.min, this.plot.scales.x.max];
  }
  quietly(change) {
    this.silent = true;
    this.plot.batch(change);
    this.silent = false;
  }
  pointed(plot) {
    if (!this.silent && plot.cursor.left >= 0) this.group.show(plot.posToVal(plot.cursor.left, "x"), this);
  }
  show(t) {
    const [low, high] = this.range();
    const left = t < low || t > high ? -10 : this.plot.valToPos(t, "x");
    this.quietly(() => this.plot.setCursor({ left, top: 1 }, false));
  }
  zoom([min, max]) {
    this.quietly(() => this.plot.setScale("x", { min, max }));
    if (this.group.t !== null) this.show(this.group.t);
  }
  key(event) {
    const step = (this.range()[1] - this.range()[0]) / 100, now = this.group.t === null ? this.group.whole[0] : this.group.t;
    const deeds = {
      ArrowLeft: () => this.group.show(now - step),
      ArrowRight: () => this.group.show(now + step),
      "+": () => this.group.closer(0.5),
      "-": () => this.group.closer(2),
      0: () => this.group.closer(0),
    };
    if (!deeds[event.key]) return;
    event.preventDefault();
    deeds[event.key]();
  }
}

// Commands contain the current folder of this page, quoted for the shell.
const path = decodeURIComponent(location.pathname).replace(/\/[^/]*$/, "").replace(/^\/(?=[A-Za-z]:)/, "");
const word = /[^\w@%+=:,./-]/.test(path) ? `'${path.replaceAll("'", `'"'"'`)}'` : path;
for (const place of document.querySelectorAll(".here")) place.textContent = word;

// After the first paint, so that it is not delayed.
const groups = [];
requestAnimationFrame(() => setTimeout(() => {
  for (const box of document.querySelectorAll(".explore")) groups.push(new Group(box));
  document.documentElement.dataset.ready = "yes";
}));
dark.addEventListener("change", () => groups.forEach((group) => group.again()));
