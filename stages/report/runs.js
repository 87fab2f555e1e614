"use strict";
// The list of runs: click on a heading to sort, filter by words; charts compare the casts.

const list = document.querySelector(".runs"), body = list.querySelector("tbody");
const rows = [...body.rows], wanted = list.querySelector("input[type=search]"), count = list.querySelector("output");
const SVG = "http://www.w3.org/2000/svg", WIDTH = 520, HEIGHT = 240, LEFT = 52, BOTTOM = 34, MOST = 12;

// The number or text of a cell.
function key(row, column) {
  const words = row.cells[column].textContent.trim();
  return words !== "" && isFinite(words) ? Number(words) : words.toLowerCase();
}

function compare(a, b) {
  if (a === "" || b === "") return (a === "") - (b === ""); // unknown values come last
  return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
}

list.querySelectorAll("thead th").forEach((heading, column) => {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "sort";
  button.textContent = heading.textContent;
  heading.replaceChildren(button);
  button.onclick = () => {
    const down = heading.getAttribute("aria-sort") === "ascending";
    list.querySelectorAll("thead th").forEach((other) => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    const known = (row) => key(row, column) !== "";
    rows.sort((a, b) => (down && known(a) && known(b) ? -1 : 1) * compare(key(a, column), key(b, column)));
    body.append(...rows);
    draw();
  };
});

// All words must be in the row; a word such as E>0.9 or casts<3 compares a number.
function fits(row, word) {
  const bound = /^(\w+)([<>])([\d.]+)$/.exec(word);
  if (!bound) return row.textContent.toLowerCase().includes(word.toLowerCase());
  const named = (heading) => heading.textContent.toLowerCase().split(" ").includes(bound[1].toLowerCase());
  const column = [...list.querySelectorAll("thead th")].findIndex(named);
  const value = column < 0 ? "" : key(row, column);
  return typeof value === "number" && (bound[2] === "<" ? value < Number(bound[3]) : value > Number(bound[3]));
}

function shown() {
  return rows.filter((row) => !row.hidden);
}

function filter() {
  const words = wanted.value.split(/\s+/).filter(Boolean);
  for (const row of rows) row.hidden = !words.every((word) => fits(row, word));
  count.textContent = `${shown().length} of ${rows.length} runs`;
  draw();
}

function add(parent, name, attributes, words = "") {
  const made = document.createElementNS(SVG, name);
  for (const [attribute, value] of Object.entries(attributes)) made.setAttribute(attribute, value);
  made.textContent = words;
  parent.append(made);
  return made;
}

// Closest approach and matching rate over the casts of the visible runs.
function draw() {
  const casts = JSON.parse(list.querySelector("script").textContent);
  const runs = shown().map((row) => row.cells[1].textContent.trim()).filter((run) => casts[run]).slice(0, MOST);
  const [approaches, rates] = list.querySelectorAll("svg");
  curves(approaches, runs, (run) => casts[run].miss_mm, "closest approach [mm]");
  curves(rates, runs, (run) => casts[run].E, "matching rate E", 1);
  list.querySelector(".overlay").hidden = !runs.length;
}

function curves(svg, runs, values, title, top = 0) {
  svg.replaceChildren();
  svg.setAttribute("aria-label", `${title} over the casts of ${runs.join(", ")}`);
  const known = runs.flatMap(values).filter((value) => value !== null);
  const high = Math.max(top, ...known, 1e-9), length = Math.max(2, ...runs.map((run) => values(run).length));
  const x = (cast) => LEFT + ((WIDTH - LEFT - 12) * cast) / (length - 1);
  const y = (value) => 10 + (HEIGHT - BOTTOM - 10) * (1 - value / high);
  for (const value of [0, high / 2, high]) {
    add(svg, "line", { x1: LEFT, x2: WIDTH - 12, y1: y(value), y2: y(value), stroke: "var(--grid)" });
    add(svg, "text", { x: LEFT - 6, y: y(value) + 4, "text-anchor": "end" }, value.toPrecision(2).replace(/\.0$/, ""));
  }
  for (let cast = 0; cast < length; cast += Math.ceil(length / 10))
    add(svg, "text", { x: x(cast), y: HEIGHT - BOTTOM + 16, "text-anchor": "middle" }, cast + 1);
  add(svg, "text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 3, "text-anchor": "middle" }, `${title} by cast`);
  runs.forEach((run, number) => {
    const stroke = `hsl(${(number * 137) % 360} 65% 50%)`, points = [];
    values(run).forEach((value, cast) => value !== null && points.push(`${x(cast)},${y(value)}`));
    const line = add(svg, "polyline", { points: points.join(" "), fill: "none", stroke, "stroke-width": 2 });
    add(line, "title", {}, run);
    for (const point of points) {
      const [cx, cy] = point.split(",");
      add(add(svg, "circle", { cx, cy, r: 3.5, fill: stroke }), "title", {}, run);
    }
  });
}

wanted.oninput = filter;
filter();
document.documentElement.dataset.ready = "yes";
