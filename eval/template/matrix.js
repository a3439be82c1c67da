// A click on a cell loads what it shows, from the folder beside the page, and opens it at its worst step.
const palmar = { cells: {}, shapes: {} };
window.palmar = palmar;
const box = document.getElementById("moment"), find = selector => box.querySelector(selector);
const loaded = new Map();
function load(name) {
  if (!loaded.has(name)) {
    loaded.set(name, new Promise((done, fail) => {
      const script = document.createElement("script");
      script.src = `cells/${name}.js`;
      script.onload = done;
      script.onerror = () => fail(new Error(`cells/${name}.js is not beside this page`));
      document.head.append(script);
    }));
  }
  return loaded.get(name);
}

let view = null, shown = null;
async function open(name) {
  const link = document.querySelector(`a[href="#${CSS.escape(name)}"]`);
  if (!link) return;
  document.querySelectorAll("a.open").forEach(other => other.classList.remove("open"));
  link.classList.add("open");
  box.hidden = false;
  find("h2").textContent = name.replace("-", ", ");
  find(".facts").textContent = "loading";
  try {
    await load(name);
    const cell = palmar.cells[name];
    await Promise.all([load(`hand-${cell.hand}`), load(`object-${cell.object}`)]);
    show(name, cell);
  } catch (error) {
    find(".facts").textContent = error.message;
  }
}

function show(name, cell) {
  shown = { first: cell.first, unit: cell.unit, metric: cell.metric };
  for (const key of ["steps", "time_s", "palm_offset_mm", "force_n", "contacts", "values"]) shown[key] = cell[key] && decode(cell[key]);
  const hard = Object.entries(cell.hard).map(([key, count]) => `${count} ${key}`).join(", ");
  find(".facts").textContent = `${cell.count.toLocaleString("en")} steps${hard ? "; " + hard : ""}`;
  find(".view canvas")?.remove();
  if (sharedRenderer()) {
    const canvas = document.createElement("canvas");
    find(".view").prepend(canvas);
    view = new View(canvas, cell.poses, palmar.shapes[cell.hand], palmar.shapes[cell.object], cell.first, cell.force_mm_per_n);
    box.querySelectorAll("[data-toggle]").forEach(toggle => view.toggle(toggle.dataset.toggle, toggle.checked));
  } else {
    find(".view").classList.add("without-webgl");
  }
  const slider = find(".time-slider");
  slider.max = shown.steps.length - 1;
  go(cell.first);
  slider.focus();
}

function go(frame) {
  find(".time-slider").value = frame;
  view?.show(frame);
  const value = shown.values ? `${shown.metric} ${Number.isNaN(shown.values[frame]) ? "–" : +shown.values[frame].toPrecision(4)} ${shown.unit} · ` : "";
  find(".clock").textContent = `${shown.time_s[frame].toFixed(3)} s · step ${shown.steps[frame]}${frame === shown.first ? " (worst)" : ""} · ${value}palm off ${shown.palm_offset_mm[frame].toFixed(2)} mm · force ${shown.force_n[frame].toFixed(2)} N · ${shown.contacts[frame]} contacts`;
}

find(".time-slider").addEventListener("input", event => go(Number(event.target.value)));
find(".worst-step").addEventListener("click", () => go(shown.first));
find(".look").addEventListener("click", () => view?.look());
find(".close").addEventListener("click", close);
function close() {
  box.hidden = true;
  document.querySelectorAll("a.open").forEach(other => other.classList.remove("open"));
  history.replaceState(null, "", location.pathname);
}
document.addEventListener("keydown", event => { if (event.key === "Escape") close(); });
box.querySelectorAll("[data-toggle]").forEach(toggle => toggle.addEventListener("change", () => view?.toggle(toggle.dataset.toggle, toggle.checked)));
const named = () => location.hash && open(decodeURIComponent(location.hash.slice(1)));
window.addEventListener("hashchange", named);
named();
