// Charts with axes and units, by uPlot. A chart takes its colors when it is made: the shell mounts a view again when the
// theme changes.
import { box, color, made, put } from "./dom.js";
import { figure } from "./format.js";

const FONT = "11px Inter, system-ui, sans-serif";

/* A chart in a card. Options:
 *   title, summary(data) -> text for screen readers
 *   x: { label, time, log }, y: { label, log, range(min, max) -> [low, high] }
 *   series: [{ label, unit, color, dash, width, points, only, digits, hidden }] beside x
 *   bands: [{ series: [upper, lower], fill }]
 * Returns { root, set(data, { lines, marks }), destroy() }; `data` is uPlot's: x, then one array a series.
 *   lines: [{ y, text, color }] across the chart, marks: [{ x, text, color }] from top to bottom.
 */
export function chart(id, options) {
  const readout = made("output", "", "chart-readout"), plot = box("div", "chart-plot"), title = made("h2", options.title);
  title.id = `${id}-h`;
  const root = box("section", "card chart", box("div", "chart-head", title, readout), plot);
  root.id = id;
  root.setAttribute("aria-labelledby", title.id);
  plot.setAttribute("role", "img");
  plot.setAttribute("aria-label", options.title);
  const empty = made("p", options.empty ?? "", "chart-empty note");
  plot.append(empty);
  let drawn = null, overlay = { lines: [], marks: [] }, data = null;

  const axis = (one, extra) => ({
    stroke: color("--muted"), font: FONT, labelFont: FONT, label: one.label, labelSize: 18, labelGap: 2, ticks: { stroke: color("--grid"), size: 4 },
    grid: { stroke: color("--grid"), width: 1 }, gap: 4, ...extra,
  });
  const plain = (u, splits) => splits.map((value) => (value === null ? "" : Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? power(value) : String(Number(value.toPrecision(6)))));
  const whole = (u, splits) => splits.map((value) => (Number.isInteger(value) ? String(value) : ""));
  const logs = (u, splits) => splits.map((value) => (value !== null && Number.isInteger(Math.round(1e6 * Math.log10(value)) / 1e6) ? power(value) : ""));
  const decades = (u, splits) => splits.map((value) => (value !== null && Math.abs(Math.log10(value) - Math.round(Math.log10(value))) < 1e-6 ? value : null));
  const halves = (u, splits) => splits.map((value) => (value !== null && [1, 2, 5].includes(Math.round(value / 10 ** Math.floor(Math.log10(value) + 1e-9))) ? value : null));
  const logAxis = { values: logs, filter: decades, ticks: { stroke: color("--grid"), size: 4, filter: decades }, grid: { stroke: color("--grid"), width: 1, filter: halves } };
  const times = (u, splits) => splits.map((value) => new Date(1000 * value).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" }));

  function make() {
    const { x, y } = options;
    const built = {
      width: Math.max(plot.clientWidth, 60), height: Math.max(plot.clientHeight, 60), padding: [8, 12, 0, 0],
      legend: { show: false }, cursor: { y: false, points: { size: 7 }, drag: { x: false, y: false } },
      scales: {
        x: { time: false, ...(x.log ? { distr: 3 } : {}), ...(x.range ? { range: (u, low, high) => x.range(low, high) } : {}) },
        y: { ...(y.log ? { distr: 3 } : {}), ...(y.range ? { range: (u, low, high) => y.range(low, high, overlay) } : {}) },
      },
      axes: [
        axis(x, { ...(x.log ? logAxis : { values: x.time ? times : x.whole ? whole : plain }), size: 28, space: x.time ? 70 : 44 }),
        axis(y, { ...(y.log ? logAxis : { values: plain }), size: 44, space: y.log ? 18 : 30 }),
      ],
      series: [{}, ...options.series.map((one) => ({
        label: one.label, stroke: color(one.color), width: one.width ?? 1.75, dash: one.dash, spanGaps: Boolean(one.span), show: !one.hidden,
        points: { show: Boolean(one.points), size: 8, fill: one.ring ? color("--card") : color(one.color), stroke: color(one.color), width: 2 },
        ...(one.only ? { paths: () => null } : {}),
      }))],
      bands: (options.bands ?? []).map((one) => ({ series: one.series, fill: color("--band") })),
      hooks: { draw: [over], setCursor: [read] },
    };
    drawn = new window.uPlot(built, data, plot);
  }
  function over(u) {
    const g = u.ctx, { left, top, width, height } = u.bbox, dpr = devicePixelRatio || 1;
    g.save();
    g.font = `${11 * dpr}px Inter, system-ui, sans-serif`;
    g.lineWidth = 1.25 * dpr;
    g.beginPath();
    g.rect(left, top, width, height);
    g.clip();
    for (const one of overlay.lines ?? []) {
      const at = Math.round(u.valToPos(one.y, "y", true)) + 0.5;
      g.strokeStyle = g.fillStyle = color(one.color);
      g.setLineDash(one.dash ? one.dash.map((part) => part * dpr) : []);
      g.beginPath(); g.moveTo(left, at); g.lineTo(left + width, at); g.stroke();
      g.textAlign = "right";
      g.textBaseline = one.below ? "top" : "bottom";
      if (one.text) g.fillText(one.text, left + width - 4 * dpr, at + (one.below ? 3 : -2) * dpr);
    }
    let taken = -Infinity, row = 0;
    for (const one of overlay.marks ?? []) {
      const at = Math.round(u.valToPos(one.x, "x", true)) + 0.5;
      g.strokeStyle = g.fillStyle = color(one.color);
      g.setLineDash([2 * dpr, 3 * dpr]);
      g.beginPath(); g.moveTo(at, top); g.lineTo(at, top + height); g.stroke();
      row = at - taken < 60 * dpr ? row + 1 : 0;
      taken = at;
      const wide = g.measureText(one.text).width, left_ = at + wide + 8 * dpr > left + width;
      g.textAlign = left_ ? "right" : "left";
      g.textBaseline = "top";
      g.fillText(one.text, at + (left_ ? -4 : 4) * dpr, top + (2 + 13 * row) * dpr);
    }
    g.restore();
  }
  function read(u) {
    const k = u.cursor.idx;
    if (k === null || k === undefined || !data) { put(readout, ""); return; }
    const texts = options.series.map((one, n) => [one, data[n + 1]?.[k]]).filter(([one, value]) => !one.quiet && value !== null && value !== undefined)
      .map(([one, value]) => `${one.label} ${figure(value, one.digits ?? 3)}${one.unit ? `\u00a0${one.unit}` : ""}`);
    put(readout, [options.at ? options.at(data[0][k]) : "", ...texts].filter(Boolean).join("  "));
  }
  const size = new ResizeObserver(() => drawn?.setSize({ width: Math.max(plot.clientWidth, 60), height: Math.max(plot.clientHeight, 60) }));
  size.observe(plot);

  return {
    root,
    set(next, more = {}) {
      const has = next && next[0].length > 0 && next.slice(1).some((one) => one.some((value) => value !== null && value !== undefined));
      empty.hidden = Boolean(has);
      overlay = { lines: more.lines ?? [], marks: more.marks ?? [] };
      if (!has) { drawn?.destroy(); drawn = data = null; return; }
      data = next;
      if (!plot.isConnected || plot.clientWidth === 0) return;
      if (drawn) drawn.setData(data); else make();
      const summary = options.summary?.(data);
      if (summary) plot.setAttribute("aria-label", `${options.title}: ${summary}`);
    },
    destroy() { size.disconnect(); drawn?.destroy(); drawn = null; },
  };
}

const UP = { "-": "\u207b", 0: "\u2070", 1: "\u00b9", 2: "\u00b2", 3: "\u00b3", 4: "\u2074", 5: "\u2075", 6: "\u2076", 7: "\u2077", 8: "\u2078", 9: "\u2079" };
function power(value) {
  const exponent = Math.round(Math.log10(Math.abs(value)));
  if (exponent >= -2 && exponent <= 3) return String(Number(value.toPrecision(3)));
  return `10${[...String(exponent)].map((one) => UP[one]).join("")}`;
}
