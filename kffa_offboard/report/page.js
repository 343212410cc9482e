"use strict";
// Draws the panels, keeps their time axes linked, and obeys the legend. window.__report_ok says that all is drawn.
(() => {
  const report = JSON.parse(document.getElementById("report-data").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const touch = matchMedia("(pointer: coarse)").matches; // a finger scrolls the page; the buttons zoom
  const narrow = matchMedia("(max-width: 600px)").matches;
  const hidden = { flight: new Set(), signal: new Set() };
  const plots = report.panels.map((panel) => document.getElementById(`plot-${panel.key}`));
  const strokes = report.panels.map((panel) => panel.data.filter((trace) => trace.yaxis !== "y2").map((trace) => {
    trace.x = numbers(trace.x);
    trace.y = numbers(trace.y);
    return trace;
  }));
  let range = report.range.slice();
  let linking = false;

  // Plotly's packed arrays (32-bit floats in base64) as numbers.
  function numbers(packed) {
    if (!packed || packed.bdata === undefined) return packed;
    const bytes = Uint8Array.from(atob(packed.bdata), (letter) => letter.charCodeAt(0));
    return packed.dtype === "f8" ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
  }

  const isHidden = (trace) => hidden.flight.has(String(trace.meta.flight)) || hidden.signal.has(trace.meta.signal);

  // What the visible lines of a panel reach within the time that is shown, with a little room; null if nothing.
  function reach(number) {
    if (report.panels[number].key === "events") return null;
    let low = Infinity, high = -Infinity;
    for (const trace of strokes[number]) {
      if (isHidden(trace)) continue;
      for (let k = 0; k < trace.x.length; k += 1) {
        const value = trace.y[k];
        if (trace.x[k] < range[0] || trace.x[k] > range[1] || !Number.isFinite(value)) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (!(high >= low)) return null;
    const room = high > low ? 0.06 * (high - low) : Math.max(0.05 * Math.abs(high), 1e-3);
    return [low - room, high + room];
  }

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const theme = () => ({
    "font.color": colour("--ink"), "xaxis.gridcolor": colour("--rule"), "yaxis.gridcolor": colour("--rule"),
    "xaxis.linecolor": colour("--faint"), "hoverlabel.bgcolor": colour("--raised"),
    "hoverlabel.font.color": colour("--ink"), "hoverlabel.bordercolor": colour("--rule"),
  });

  function layoutOf(panel) {
    const ink = theme();
    const layout = panel.layout;
    const axis = { gridcolor: ink["xaxis.gridcolor"], zeroline: false, automargin: false };
    Object.assign(layout, {
      margin: { l: 62, r: 10, t: touch || narrow ? 8 : 26, b: 42 }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: 12, color: ink["font.color"] }, dragmode: touch ? false : "zoom",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--faint"), activecolor: ink["font.color"] },
      hoverlabel: { bgcolor: ink["hoverlabel.bgcolor"], bordercolor: ink["hoverlabel.bordercolor"],
        font: { color: ink["font.color"] } },
      xaxis: { ...axis, linecolor: ink["xaxis.linecolor"], range: range.slice(), hoverformat: ".3f",
        title: { text: report.timeTitle, standoff: 4 } },
      yaxis: { ...layout.yaxis, ...axis },
    });
    const values = reach(report.panels.indexOf(panel));
    if (values) layout.yaxis.range = values;
    if (touch) layout.yaxis.fixedrange = true;
    return layout;
  }

  function say() {
    document.getElementById("span").textContent = `${range[0].toFixed(1)} to ${range[1].toFixed(1)} s`;
  }

  // `keeps`: the plot in which a person has just chosen a range of values.
  async function show(wanted, keeps) {
    if (linking || !(wanted[1] > wanted[0])) return;
    linking = true;
    range = wanted.map(Number);
    say();
    try {
      for (const [number, plot] of plots.entries()) {
        const values = plot === keeps ? null : reach(number);
        await Plotly.relayout(plot, { "xaxis.range": range.slice(), ...(values && { "yaxis.range": values }) });
      }
    } finally {
      linking = false;
    }
  }

  function follow(plot, change) {
    if (linking || !Object.keys(change).some((key) => key.startsWith("xaxis"))) return;
    const all = change["xaxis.autorange"];
    const chosen = !all && Object.keys(change).some((key) => key.startsWith("yaxis.range"));
    show(all ? report.range : plot.layout.xaxis.range, chosen ? plot : null);
  }

  async function toggle() {
    for (const plot of plots) {
      const seen = plot.data.map((trace) => !isHidden(trace));
      if (seen.length) await Plotly.restyle(plot, { visible: seen }, seen.map((_, number) => number));
    }
    await show(range);
  }

  for (const kind of ["flight", "signal"]) {
    for (const box of document.querySelectorAll(`input[data-${kind}]`)) {
      box.addEventListener("change", () => {
        hidden[kind][box.checked ? "delete" : "add"](box.dataset[kind]);
        toggle();
      });
    }
  }

  const moves = {
    back: (a, b) => [a - (b - a) / 2, b - (b - a) / 2], on: (a, b) => [a + (b - a) / 2, b + (b - a) / 2],
    in: (a, b) => [a + (b - a) / 4, b - (b - a) / 4], out: (a, b) => [a - (b - a) / 2, b + (b - a) / 2],
    all: () => report.range,
  };
  for (const button of document.querySelectorAll("button[data-time]")) {
    button.addEventListener("click", () => show(moves[button.dataset.time](...range)));
  }
  dark.addEventListener("change", () => plots.forEach((plot) => Plotly.relayout(plot, theme())));

  async function draw() {
    say();
    const config = { responsive: true, displaylogo: false, doubleClick: "reset", displayModeBar: touch || narrow ? false : "hover",
      modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
    for (const [number, panel] of report.panels.entries()) {
      await Plotly.newPlot(plots[number], panel.data, layoutOf(panel), config);
      plots[number].on("plotly_relayout", (change) => follow(plots[number], change));
      await new Promise((resolve) => setTimeout(resolve, 0)); // lets the page scroll meanwhile
    }
    window.__report_ok = plots.every((plot) => plot.querySelector(".main-svg") !== null);
    document.documentElement.dataset.report = window.__report_ok ? "drawn" : "incomplete";
  }

  draw();
})();
