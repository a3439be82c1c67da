// One time for each run: the slider, the 3-D view, the cursor over the charts and the numbers beside them follow it.
const content = JSON.parse(document.getElementById("content").textContent);

function nearest(times, time) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  return time - times[low] <= times[high] - time ? low : high;
}

class Replay {
  constructor(section, run) {
    const find = selector => section.querySelector(selector);
    this.times = decode(run.time_s);
    this.steps = decode(run.steps);
    this.readouts = run.readouts.map(({ key, digits, values }) => ({ key, digits, values: decode(values) }));
    this.phases = run.phases;
    this.slider = find(".time-slider");
    this.clock = find(".clock");
    this.button = find(".play");
    this.speed = find(".speed");
    this.cells = Object.fromEntries(run.readouts.map(({ key }) => [key, find(`.readouts [data-key="${key}"]`)]));
    this.playing = false;
    if (sharedRenderer()) {
      this.view = new View(find(".view canvas"), run.poses, content.hands[run.hand], content.objects[run.object],
        run.first, run.force_mm_per_n);
    } else {
      find(".view").classList.add("without-webgl");
    }
    this.charts = new Charts(find(".charts"), run.panels, run.phases, time => this.goTo(time));
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value), true));
    this.button.addEventListener("click", () => this.play(!this.playing));
    find(".look").addEventListener("click", () => this.view?.look());
    section.querySelectorAll("[data-toggle]").forEach(box => {
      box.addEventListener("change", () => this.view?.toggle(box.dataset.toggle, box.checked));
    });
    find(".colour").addEventListener("change", event => {
      const what = event.target.value, end = this.view?.depthEnd[what];
      this.view?.colour(what);
      find(".depth-scale").hidden = end === undefined;
      find(".depth-text").textContent = what === "graphic"
        ? `0 to ${end} mm: each link of the graphic hand in the true mesh, and the object's surface in that hand`
        : `0 to ${end} mm: the object's surface in the haptic hand`;
    });
    section.querySelectorAll("[data-step]").forEach(button => {
      button.addEventListener("click", () => this.show(this.steps.indexOf(Number(button.dataset.step))));
    });
    this.show(run.first);
  }

  goTo(time) {
    this.show(nearest(this.times, time));
  }

  // A moment of play, which may be between two frames.
  pass(time) {
    const frame = nearest(this.times, time), toward = Math.min(Math.max(frame + Math.sign(time - this.times[frame]), 0), this.times.length - 1);
    const span = this.times[toward] - this.times[frame];
    this.show(frame, true, toward, span ? (time - this.times[frame]) / span : 0);
  }

  show(frame, moving = false, toward = frame, share = 0) {
    this.frame = frame;
    this.slider.value = frame;
    this.view?.show(frame, moving, toward, share);
    this.charts.moveCursor(this.times[frame]);
    const time = this.times[frame];
    const phase = this.phases.find(p => time >= p.start_s && time < p.end_s);
    this.clock.textContent = `${time.toFixed(3)} s · step ${this.steps[frame]}${phase ? " · " + phase.name : ""}`;
    for (const { key, digits, values } of this.readouts) {
      const value = values[frame];
      this.cells[key].textContent = Number.isNaN(value) ? "–" : value.toFixed(digits);
    }
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (this.frame === this.times.length - 1) this.show(0);
    let started = null, from = this.times[this.frame];
    const tick = now => {
      if (!this.playing) return;
      started ??= now;
      const time = from + (now - started) / 1000 * Number(this.speed.value);
      if (time >= this.times[this.times.length - 1]) {
        this.show(this.times.length - 1);
        this.play(false);
        return;
      }
      this.pass(time);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    this.speed.onchange = () => { from = this.times[this.frame]; started = null; };
    this.slider.onpointerdown = () => this.play(false);
  }
}

// A run is set up when its section comes near the window, so a page of many runs opens at once.
const replays = new Map();
function setUp(section) {
  const at = Number(section.dataset.run);
  if (!replays.has(at)) replays.set(at, new Replay(section, content.runs[at]));
}
const watcher = new IntersectionObserver(entries => {
  for (const entry of entries) if (entry.isIntersecting) setUp(entry.target);
}, { rootMargin: "400px" });
document.querySelectorAll("section[data-run]").forEach(section => watcher.observe(section));

// Paper is narrower than most windows, and nothing is drawn later while a page is being printed.
window.addEventListener("beforeprint", () => {
  document.querySelectorAll("section[data-run]").forEach(setUp);
  for (const { view, charts } of replays.values()) {
    view?.draw();
    Plotly.relayout(charts.plot, { width: 660 });
  }
});
window.addEventListener("afterprint", () => {
  for (const { charts } of replays.values()) Plotly.relayout(charts.plot, { width: null, autosize: true });
});
