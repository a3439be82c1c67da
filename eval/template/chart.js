// The chart: dots over a logarithmic time, and under the least power of ten a linear lane that keeps zero in sight.
const content = JSON.parse(document.getElementById("content").textContent);
const dark = matchMedia("(prefers-color-scheme: dark)").matches;
// Okabe and Ito's colours: told apart by colour-blind readers. The product's first.
const COLOURS = dark
  ? ["#56b4e9", "#ee8a3a", "#2fc49a", "#e49ac6", "#f0e442", "#b9c1cb"]
  : ["#0060a8", "#d55e00", "#009e73", "#b8568f", "#b07c00", "#5a6470"];
const solvers = [...new Set(content.dots.map(dot => dot.solver))];
solvers.sort((a, b) => (b === content.product) - (a === content.product));
const colour = solver => COLOURS[solvers.indexOf(solver) % COLOURS.length];
const levels = [...new Set(content.dots.map(dot => dot.level))].sort((a, b) => a - b);
const hidden = new Set();
const WIDTH = 640, HEIGHT = 430, LEFT = 62, RIGHT = 14, TOP = 12, BOTTOM = 46, LANE = 34;
const short = n => n >= 1e3 ? `${n / 1e3}k` : `${n}`;
const figure = x => x === null ? "not measured" : x === 0 ? "0" : Math.abs(x) < 1e-4 ? x.toExponential(1) : `${+x.toPrecision(3)}`;

function make(name, attributes, parent) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  parent.append(node);
  return node;
}
function write(parent, text, x, y, attributes = {}) {
  const node = make("text", { x, y, ...attributes }, parent);
  node.textContent = text;
  return node;
}
function board(host, title, label) {
  const box = document.createElement("figure"), head = document.createElement("h3");
  head.textContent = title;
  box.append(head);
  host.append(box);
  return make("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label }, box);
}

function logScale(low, high, from, to) {
  const span = Math.log(high / low);
  const at = value => from + (to - from) * Math.log(value / low) / span;
  at.ticks = [];
  for (let power = Math.ceil(Math.log10(low) - 1e-9); 10 ** power <= high * 1.0001; power++) at.ticks.push(10 ** power);
  at.between = [];
  for (let power = Math.floor(Math.log10(low)); 10 ** power < high; power++)
    for (let k = 2; k < 10; k++) if (k * 10 ** power > low && k * 10 ** power < high) at.between.push(k * 10 ** power);
  return at;
}
function extent(values, low, high) {
  return [Math.min(low, ...values) / 1.25, Math.max(high, ...values) * 1.35];
}
function say(value) {
  if (value >= 1) return `${+value.toPrecision(6)}`;
  return value >= 1e-3 ? `${+value.toPrecision(2)}` : value.toExponential(0).replace("e-", "e−");
}

// Axes of a panel with the lines to hold; y may have the lane of zero.
function axes(svg, x, y, xName, yName, lane) {
  const right = WIDTH - RIGHT, bottom = HEIGHT - BOTTOM;
  if (lane) {
    make("rect", { class: "lane", x: LEFT, y: bottom - LANE, width: right - LEFT, height: LANE }, svg);
    write(svg, "0", LEFT - 8, bottom + 1, { "text-anchor": "end", class: "axis" });
  }
  for (const value of x.ticks) {
    make("line", { class: "grid", x1: x(value), x2: x(value), y1: TOP, y2: bottom }, svg);
    write(svg, say(value), x(value), bottom + 17, { "text-anchor": "middle" });
  }
  for (const value of y.ticks) {
    make("line", { class: "grid", x1: LEFT, x2: right, y1: y(value), y2: y(value) }, svg);
    write(svg, say(value), LEFT - 8, y(value) + 4, { "text-anchor": "end" });
  }
  for (const value of x.between) make("line", { class: "frame", x1: x(value), x2: x(value), y1: bottom, y2: bottom - 3 }, svg);
  for (const value of y.between) make("line", { class: "frame", x1: LEFT, x2: LEFT + 3, y1: y(value), y2: y(value) }, svg);
  make("rect", { class: "frame", x: LEFT, y: TOP, width: right - LEFT, height: bottom - TOP }, svg);
  write(svg, xName, (LEFT + right) / 2, HEIGHT - 8, { "text-anchor": "middle", class: "axis" });
  write(svg, yName, 0, 0, { "text-anchor": "middle", class: "axis", transform: `translate(14 ${(TOP + bottom) / 2}) rotate(-90)` });
}
function limit(svg, x, y, value, text) {
  const right = WIDTH - RIGHT, bottom = HEIGHT - BOTTOM;
  if (x) {
    make("line", { class: "limit", x1: x(value), x2: x(value), y1: TOP, y2: bottom }, svg);
    write(svg, text, x(value) - 5, TOP + 13, { class: "hold", "text-anchor": "end" });
  } else {
    make("line", { class: "limit", x1: LEFT, x2: right, y1: y(value), y2: y(value) }, svg);
    write(svg, text, right - 5, y(value) - 5, { class: "hold", "text-anchor": "end" });
  }
}

const tip = document.getElementById("tip");
function point(node, html) {
  node.addEventListener("pointermove", event => {
    tip.innerHTML = html;
    tip.hidden = false;
    const box = tip.getBoundingClientRect();
    tip.style.left = `${Math.min(event.clientX + 14, innerWidth - box.width - 8)}px`;
    tip.style.top = `${event.clientY + box.height + 24 > innerHeight ? event.clientY - box.height - 12 : event.clientY + 16}px`;
  });
  node.addEventListener("pointerleave", () => { tip.hidden = true; });
}
function tell(dot) {
  const n = dot.numbers, failures = Object.entries(dot.failures);
  return `<b>${dot.solver}${dot.quality ? " · " + dot.quality : ""}, ${dot.spheres.toLocaleString("en")} spheres</b>
    cost p50 ${figure(dot.cost_us.p50)}, p99 ${figure(dot.cost_us.p99)} µs<br>
    tail p99 ${figure(dot.tail_us.p99)}, p99.9 ${figure(dot.tail_us["p99.9"])}, max ${figure(dot.tail_us.max)} µs<br>
    deepest in spheres ${figure(n.penetration_spheres_mm)}, in mesh ${figure(n.penetration_mesh_mm)} mm<br>
    hover p99 ${figure(n.hover_mm)} mm, palm off by ${figure(n.palm_offset_mm)} mm (mean)<br>
    force above 20 Hz ${figure(n.force_above_20hz_n)} N, excess step ${figure(n.excess_force_step_n)} N<br>
    ${failures.length ? `<span class="bad">failed ${dot.failed.toLocaleString("en")} of ${dot.steps.toLocaleString("en")} steps</span>: ` +
      failures.map(([how, count]) => `${count.toLocaleString("en")} ${how}`).join(", ") : `no failed step of ${dot.steps.toLocaleString("en")}`}`;
}

function scatter(host, panel, clock) {
  const svg = board(host, panel.title, `${panel.title}: step time against ${panel.axis}`);
  const dots = content.dots.filter(dot => dot.numbers[panel.number] !== null);
  const bottom = HEIGHT - BOTTOM;
  const times = dots.map(dot => dot[clock].p99), values = dots.map(dot => dot.numbers[panel.number]);
  const x = logScale(...extent(times, 20, 1000), LEFT, WIDTH - RIGHT);
  const above = logScale(panel.least, Math.max(1, ...values) * 1.8, bottom - LANE, TOP);
  const y = value => value >= panel.least ? above(value) : bottom - LANE * value / panel.least;
  Object.assign(y, { ticks: above.ticks, between: above.between });
  axes(svg, x, y, clock === "cost_us" ? "step, p99 of least CPU times, µs" : "step, p99 of all CPU times, µs", panel.axis, true);
  limit(svg, x, null, 100, "0.1 ms");
  limit(svg, x, null, 1000, "1 ms");
  limit(svg, null, y, panel.hold, panel.number.endsWith("_n") ? "0.1 N" : "0.1 mm");
  const at = dot => [x(dot[clock].p99), y(dot.numbers[panel.number])];

  if (clock === "cost_us" && panel.pareto.length) {
    const front = panel.pareto.map(i => at(content.dots[i]));
    const way = `M${front[0][0]} ${TOP}` + front.map(([fx, fy]) => `H${fx}V${fy}`).join("") + `H${WIDTH - RIGHT}`;
    make("path", { class: "front", d: way }, svg);
  }
  for (const solver of [...solvers].reverse()) {
    const group = make("g", { "data-solver": solver }, svg), ours = solver === content.product ? " product" : "";
    const plain = dots.filter(dot => dot.solver === solver && !dot.quality).sort((a, b) => a.level - b.level);
    make("polyline", { class: `link${ours}`, stroke: colour(solver), points: plain.map(dot => at(dot).join(",")).join(" ") }, group);
    for (const dot of dots.filter(dot => dot.solver === solver)) {
      const [cx, cy] = at(dot), size = 4 + 1.7 * levels.indexOf(dot.level), failed = dot.failed > 0;
      const look = { class: `dot${failed ? " failed" : ""}`, stroke: colour(solver), ...(failed ? {} : { fill: colour(solver) }) };
      if (dot.quality) make("path", { ...look, d: `M${cx} ${cy - size - 1}L${cx + size + 1} ${cy}L${cx} ${cy + size + 1}L${cx - size - 1} ${cy}Z` }, group);
      else make("circle", { ...look, cx, cy, r: size }, group);
      if (failed) write(group, dot.failed.toLocaleString("en"), cx + size + 4, cy + 3.5, { class: "count", style: `fill:${colour(solver)}` });
      point(make("circle", { class: "hit", cx, cy, r: size + 5 }, group), tell(dot));
    }
  }
  return svg;
}

// Lines of p50 (full) and p99 (dashed) against something that costs.
function curves(host, title, xName, xs, of) {
  const svg = board(host, title, title);
  const rows = solvers.flatMap(solver => of(solver));
  if (!rows.length) return;
  const x = logScale(...extent(xs, Infinity, 0), LEFT, WIDTH - RIGHT);
  const y = logScale(...extent(rows.flatMap(row => [row.p50, row.p99]), 10, 1000), HEIGHT - BOTTOM, TOP);
  axes(svg, x, y, xName, "step, least CPU time, µs: p50, dashed p99", false);
  limit(svg, null, y, 1000, "1 ms");
  for (const solver of [...solvers].reverse()) {
    const line = of(solver);
    if (!line.length) continue;
    const group = make("g", { "data-solver": solver }, svg), ours = solver === content.product ? " product" : "";
    for (const [stat, dash] of [["p99", "4 4"], ["p50", "none"]])
      make("polyline", { class: `link${ours}`, stroke: colour(solver), "stroke-dasharray": dash, points: line.map(row => `${x(row.x)},${y(row[stat])}`).join(" ") }, group);
    for (const row of line) {
      make("circle", { class: "dot", stroke: colour(solver), fill: colour(solver), cx: x(row.x), cy: y(row.p50), r: ours ? 3.5 : 2.2 }, group);
      point(make("circle", { class: "hit", cx: x(row.x), cy: y(row.p50), r: 9 }, group), `<b>${solver}</b>${row.what}<br>p50 ${figure(row.p50)}, p99 ${figure(row.p99)} µs`);
    }
  }
}

function bars(host) {
  if (!content.fingers.length) return;
  const groups = [...new Set(content.fingers.map(row => row.in_use))];
  const width = 1240, height = 330, left = 62, bottom = height - 40, each = (width - left - 14) / groups.length;
  const most = 1.12 * Math.max(...content.fingers.map(row => row.total_us));
  const y = value => bottom - (bottom - 14) * value / most;
  const box = document.createElement("figure");
  host.append(box);
  const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "step time by fingers in use" }, box);
  const unit = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find(step => most / step <= 6) || 1e4;
  for (let value = 0; value <= most; value += unit) {
    make("line", { class: "grid", x1: left, x2: width - 14, y1: y(value), y2: y(value) }, svg);
    write(svg, value, left - 8, y(value) + 4, { "text-anchor": "end" });
  }
  write(svg, "step, mean, µs", 0, 0, { "text-anchor": "middle", class: "axis", transform: `translate(14 ${bottom / 2}) rotate(-90)` });
  groups.forEach((name, k) => {
    write(svg, name, left + each * (k + .5), height - 12, { "text-anchor": "middle", class: "axis" });
    solvers.forEach((solver, s) => {
      const row = content.fingers.find(row => row.in_use === name && row.solver === solver);
      if (!row) return;
      const bar = Math.min(34, .8 * each / solvers.length), x = left + each * (k + .5) + (s - solvers.length / 2) * bar * 1.08;
      const group = make("g", { "data-solver": solver }, svg);
      let base = 0;
      for (const [part, opacity] of [[row.detection_us, 1], [row.response_us, .62], [Math.max(0, row.total_us - row.detection_us - row.response_us), .26]]) {
        make("rect", { x, width: bar, y: y(base + part), height: Math.max(0, y(base) - y(base + part)), fill: colour(solver), "fill-opacity": opacity }, group);
        base += part;
      }
      write(group, Math.round(row.contacts), x + bar / 2, y(base) - 4, { "text-anchor": "middle", class: "count" });
      point(make("rect", { class: "hit", x, width: bar, y: y(base), height: bottom - y(base) }, group),
        `<b>${solver}, ${name}</b>detection ${figure(row.detection_us)}, response ${figure(row.response_us)}, total ${figure(row.total_us)} µs<br>${figure(row.contacts)} contacts, ${row.steps.toLocaleString("en")} steps`);
    });
  });
  const key = make("g", {}, svg);
  [["detection", 1], ["response", .62], ["rest", .26]].forEach(([name, opacity], k) => {
    make("rect", { x: left + 12 + 92 * k, y: 16, width: 12, height: 12, fill: colour(content.product), "fill-opacity": opacity }, key);
    write(key, name, left + 29 + 92 * k, 26.5);
  });
}

function fade() {
  document.querySelectorAll("[data-solver]").forEach(node => node.style.display = hidden.has(node.dataset.solver) ? "none" : "");
}
function draw(clock) {
  const host = document.getElementById("panels");
  host.replaceChildren();
  for (const panel of content.panels) scatter(host, panel, clock);
  fade();
}

const legend = document.getElementById("legend");
for (const solver of solvers) {
  const button = document.createElement("button"), mark = document.createElement("i");
  mark.style.background = colour(solver);
  button.append(mark, solver);
  button.className = solver === content.product ? "product" : "";
  button.setAttribute("aria-pressed", "true");
  button.addEventListener("click", () => {
    if (!hidden.delete(solver)) hidden.add(solver);
    button.setAttribute("aria-pressed", String(!hidden.has(solver)));
    fade();
  });
  legend.append(button);
}
document.querySelectorAll("[name=clock]").forEach(box => box.addEventListener("change", () => draw(box.value)));
draw("cost_us");
const costs = document.getElementById("costs");
curves(costs, "Against contacts", "contacts handled in the step", Object.values(content.contacts).flat().map(row => row.contacts),
  solver => (content.contacts[solver] || []).map(row => ({ ...row, x: row.contacts, what: `about ${Math.round(row.contacts)} contacts, ${row.steps.toLocaleString("en")} steps` })));
curves(costs, "Against spheres", "spheres of the level", content.dots.map(dot => dot.spheres),
  solver => content.dots.filter(dot => dot.solver === solver && !dot.quality).sort((a, b) => a.spheres - b.spheres)
    .map(dot => ({ ...dot.cost_us, x: dot.spheres, what: `${dot.spheres.toLocaleString("en")} spheres` })));
bars(document.getElementById("fingers"));
