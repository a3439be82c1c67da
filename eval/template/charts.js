// The charts of one run: panels above each other over one time axis, drawn by plotly, with a cursor laid over them.
const MARGIN = { l: 62, r: 12, t: 64, b: 40 };
const PANEL_PX = 150;
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];

function ink(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

// A fresh object each time: plotly writes into what it is given.
function axisStyle() {
  return { gridcolor: ink("--line"), zerolinecolor: ink("--line-strong"), linecolor: ink("--line-strong"), fixedrange: true };
}

class Charts {
  constructor(element, panels, phases, onTime) {
    this.element = element;
    this.plot = element.querySelector(".plot");
    this.cursor = element.querySelector(".cursor");
    this.panels = panels;
    this.phases = phases;
    this.time = 0;
    Plotly.newPlot(this.plot, this.traces(), this.layout(), {
      displaylogo: false, responsive: true,
      modeBarButtons: [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]],
    });
    this.plot.on("plotly_click", event => onTime(event.points[0].x));
    this.plot.on("plotly_relayout", () => this.moveCursor(this.time));
    new ResizeObserver(() => this.moveCursor(this.time)).observe(this.plot);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      Plotly.react(this.plot, this.traces(), this.layout());
    });
  }

  traces() {
    return this.panels.flatMap((panel, row) => {
      const time = decode(panel.time_s);
      return Object.entries(panel.lines).map(([name, line], i) => ({
        type: "scatter", mode: "lines", name, x: time, y: decode(line),
        xaxis: "x", yaxis: row ? `y${row + 1}` : "y", legend: row ? `legend${row + 1}` : "legend",
        line: { width: 1.3, color: COLOURS[i % COLOURS.length], shape: panel.key === "contacts" ? "hv" : "linear" },
        visible: panel.hidden.includes(name) ? "legendonly" : true, showlegend: Object.keys(panel.lines).length > 1,
        hovertemplate: `%{y:.4~g} ${panel.unit}<extra>${name}</extra>`,
      }));
    });
  }

  layout() {
    const count = this.panels.length, height = count * PANEL_PX + MARGIN.t + MARGIN.b;
    const share = 1 / count, gap = 34 / (height - MARGIN.t - MARGIN.b);
    const layout = {
      height, margin: { ...MARGIN }, hovermode: "x", dragmode: "zoom",
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: 11.5, color: ink("--ink") },
      hoverlabel: { font: { size: 11 } },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: ink("--line-strong"), activecolor: ink("--quiet") },
      xaxis: { ...axisStyle(), fixedrange: false, anchor: count > 1 ? `y${count}` : "y", title: { text: "time, s" } },
      annotations: [], shapes: [],
    };
    this.panels.forEach((panel, row) => {
      const top = 1 - row * share, bottom = top - share + (row < count - 1 ? gap : 0), suffix = row ? row + 1 : "";
      layout[`yaxis${suffix}`] = {
        ...axisStyle(), domain: [bottom, top], rangemode: "tozero", title: { text: panel.axis, standoff: 4 }, automargin: false,
      };
      layout[`legend${suffix}`] = {
        orientation: "h", x: 1, xanchor: "right", y: top, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)", font: { size: 10.5 },
      };
      layout.annotations.push({
        text: `<b>${panel.title}</b>`, xref: "paper", yref: "paper", x: 0, xanchor: "left", y: top, yanchor: "bottom",
        showarrow: false, font: { size: 12 },
      });
    });
    this.phases.forEach((phase, i) => {
      if (i % 2) {
        layout.shapes.push({
          type: "rect", xref: "x", yref: "paper", x0: phase.start_s, x1: phase.end_s, y0: 0, y1: 1,
          fillcolor: ink("--band"), line: { width: 0 }, layer: "below",
        });
      }
      layout.annotations.push({
        text: phase.name, xref: "x", yref: "paper", x: (phase.start_s + phase.end_s) / 2, y: 1, yanchor: "bottom", yshift: 19,
        showarrow: false, font: { size: 10, color: ink("--quiet") },
      });
    });
    return layout;
  }

  moveCursor(time) {
    this.time = time;
    const [start, end] = this.plot.layout.xaxis.range;
    const width = this.plot.clientWidth - MARGIN.l - MARGIN.r;
    const x = (time - start) / (end - start);
    this.cursor.hidden = x < 0 || x > 1;
    this.cursor.style.transform = `translate(${MARGIN.l + x * width}px, ${MARGIN.t}px)`;
    this.cursor.style.height = `${this.plot.clientHeight - MARGIN.t - MARGIN.b}px`;
  }
}
