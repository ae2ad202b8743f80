// What the views of queue, history and approval share: result chips, terms, charts over uPlot, maps of a job.
import { box, button, color, made } from "/dom.js";
import { NONE } from "/format.js";

export const styles = ["/views/shop.css"];

// A word in a colored chip; the word alone says it, too.
const LOOKS = { rejected: "bad", "set aside": "aside", held: "attend", "under way": "busy", stopped: "aside" };
export const chip = (key, word) => made("span", word, `chip ${LOOKS[key] ?? ""}`);

// A list of terms: [name, value, note?]; empty values are left out.
export function terms(rows) {
  const list = box("dl", "terms");
  for (const [name, value, note] of rows) {
    if (value === null || value === undefined || value === "") continue;
    const shown = made("dd", typeof value === "object" ? undefined : value);
    if (typeof value === "object") shown.append(value);
    if (note) shown.append(made("span", note, "note"));
    list.append(box("div", "", made("dt", name), shown));
  }
  return list;
}

// A figure of a tile: label above, value large, note below.
export const tile = (label, value, note) => box("div", "tile", made("span", label, "label"), made("span", value, "value"), note ? made("span", note, "note") : null);

// A table: heads [text, class?], rows of cells (texts, elements, or [text, class]).
export function tableOf(heads, rows, kind = "") {
  const head = box("tr", ""), body = document.createElement("tbody");
  for (const one of heads) {
    const [text, style] = [one].flat();
    const cell = made(text ? "th" : "td", text, style);
    if (text) cell.scope = "col";
    head.append(cell);
  }
  for (const row of rows) {
    body.append(box("tr", "", ...row.map((one, n) => {
      const [content, style] = Array.isArray(one) ? one : [one];
      const cell = made(n ? "td" : "th", content instanceof Node ? undefined : content, style);
      if (!n) cell.scope = "row";
      if (content instanceof Node) cell.append(content);
      return cell;
    })));
  }
  return box("div", "scroll", box("table", kind, box("thead", "", head), body));
}

export const day = (atS) => (atS === null || atS === undefined ? NONE : new Date(1000 * atS).toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric" }));
export const shortDay = (atS) => new Date(1000 * atS).toLocaleDateString("en-GB", { day: "numeric", month: "short" });
export const hash = (sha256) => {
  const one = made("code", sha256 ? `${sha256.slice(0, 12)}…` : NONE, "hash");
  if (sha256) one.title = sha256;
  return one;
};

// An error as a sentence, with a button to try again.
export const problem = (text, why, again, label) => box("div", "problem", made("p", text), why ? made("p", why, "note") : null, again ? button(label, "", again) : null);

/* A chart of uPlot that follows the width of its place. `series`: { label, values, kind: "line" | "points" | "bars" |
 * "hidden", stroke, fill? }; `bands`: pairs of series numbers. Returns { root, chart, end() }. */
export function chart({ label, height = 170, x, series, bands = [], time = true, log = false, hover, level, xText, yText, range }) {
  const root = box("div", "plot"), U = window.uPlot, muted = color("--muted"), grid = { stroke: color("--grid"), width: 1 };
  root.setAttribute("role", "img");
  root.setAttribute("aria-label", label);
  if (!U) { root.append(made("p", label, "empty")); return { root, end() {} }; }
  const axis = { stroke: muted, grid, ticks: { show: false }, font: "12px Inter, sans-serif", labelFont: "12px Inter, sans-serif", labelGap: 2 };
  const options = {
    width: 300, height, legend: { show: false }, cursor: { y: false, drag: { x: false, y: false }, points: { size: 8 } },
    scales: { x: { time, ...(time ? { range: (_, low, high) => [low - WEEK_S / 2, high + WEEK_S / 2] } : { range: (_, low, high) => [low - 0.25, high + 0.25] }) }, y: { distr: log ? 3 : 1, range: range ?? ((_, low, high) => (log ? [low / 1.4, high * 1.4] : [Math.min(0, low), (high || 1) * 1.12])) } },
    axes: [
      { ...axis, size: 26, label: xText, labelSize: xText ? 20 : 0, space: 58, ...(time ? { values: (_, splits) => splits.map((at) => shortDay(at)) } : { incrs: [1, 2, 5, 10], values: (_, splits) => splits.map((one) => (Number.isInteger(one) ? String(one) : "")) }) },
      { ...axis, size: 46, label: yText, labelSize: yText ? 20 : 0, space: 28, ...(log ? { values: (_, splits) => splits.map((one) => (isRound(one) ? String(Number(one.toPrecision(2))) : "")) } : {}) },
    ],
    series: [{}, ...series.map((one) => ({
      label: one.label, stroke: one.stroke, fill: one.fill, width: one.kind === "bars" ? 0 : 2, spanGaps: true, show: true,
      ...(one.kind === "bars" ? { paths: U.paths.bars({ size: [0.78, 26], align: 0 }), points: { show: false } } : {}),
      ...(one.kind === "points" ? { paths: () => null, points: { show: true, size: 9, width: 2, fill: color("--card"), stroke: one.stroke } } : {}),
      ...(one.kind === "dots" ? { points: { show: true, size: 7, fill: one.stroke } } : {}),
      ...(one.kind === "line" ? { points: { show: x.length < 2 } } : {}),
      ...(one.kind === "hidden" ? { stroke: "transparent", width: 0, points: { show: false } } : {}),
    }))],
    bands,
    hooks: {
      ...(hover ? { setCursor: [(one) => hover(one.cursor.idx)] } : {}),
      ...(level ? { draw: [(one) => drawLevel(one, level)] } : {}),
    },
  };
  const made_ = new U(options, [x, ...series.map((one) => one.values)], root);
  const fit = () => { if (root.clientWidth) made_.setSize({ width: root.clientWidth, height }); };
  const sizes = new ResizeObserver(fit);
  sizes.observe(root);
  return { root, end() { sizes.disconnect(); made_.destroy(); } };
}

const WEEK_S = 604_800;
// 1, 2 or 5 times a power of ten: the labels of a logarithmic axis.
function isRound(value) {
  if (value === null || !(value > 0)) return false;
  const digit = value / 10 ** Math.floor(Math.log10(value) + 1e-9);
  return [1, 2, 5].some((one) => Math.abs(digit - one) < 1e-6);
}

// A dashed line across the chart, with its word.
function drawLevel(one, { value, text }) {
  const { ctx: g, bbox } = one, y = one.valToPos(value, "y", true), dpr = devicePixelRatio || 1;
  if (!(y >= bbox.top && y <= bbox.top + bbox.height)) return;
  g.save();
  g.strokeStyle = color("--text");
  g.fillStyle = color("--text");
  g.setLineDash([5 * dpr, 4 * dpr]);
  g.lineWidth = 1.5 * dpr;
  g.beginPath();
  g.moveTo(bbox.left, y);
  g.lineTo(bbox.left + bbox.width, y);
  g.stroke();
  g.font = `${12 * dpr}px Inter, sans-serif`;
  g.textAlign = "right";
  g.textBaseline = "bottom";
  g.fillText(text, bbox.left + bbox.width - 4 * dpr, y - 3 * dpr);
  g.restore();
}

// Maps of jobs on canvases with one range of colors. `wanted`: [{ path, label, note }], path below /api/jobs.
export async function maps(ctx, wanted, { missing, signed = true }) {
  const { drawHeightMap } = await import("/maps/height_map.js");
  const datas = await Promise.all(wanted.map((one) => ctx.got(`/api/jobs/${one.path}?px=160&encoding=float32`)));
  const ends = datas.filter((one) => one?.scale).map((one) => one.scale);
  const scale = ends.length ? [Math.min(...ends.map((one) => one[0])), Math.max(...ends.map((one) => one[1]))] : [0, 1];
  const figures = wanted.map((one, n) => {
    const canvas = made("canvas", undefined, "thumb"), figure = box("figure", "map", datas[n] ? canvas : made("p", missing, "empty"), made("figcaption", one.note));
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", one.label);
    return figure;
  });
  const bar = ends.length ? await colorBar(scale, signed && datas.some((one) => one?.signed), datas.find((one) => one)?.unit ?? "nm") : null;
  let together = true; // one range of colors; false: of each its own
  const draw = (one = together) => {
    together = one;
    figures.forEach((figure, n) => {
      const canvas = figure.querySelector("canvas");
      if (canvas?.clientWidth) drawHeightMap(canvas, datas[n], { compact: true, scale: together ? scale : undefined, label: wanted[n].label, outside: "hide" });
    });
  };
  const root = box("div", "maps", ...figures), sizes = new ResizeObserver(() => draw());
  sizes.observe(root);
  return { root, bar, draw, end() { sizes.disconnect(); } };
}

// A horizontal color bar with its ends and middle.
async function colorBar([low, high], signed, unit) {
  const { css, tableOf: table } = await import("/maps/colormap.js");
  const canvas = made("canvas"), g = canvas.getContext("2d");
  canvas.width = 128;
  canvas.height = 1;
  for (let n = 0; n < 128; n++) { g.fillStyle = css(table(signed), n / 127); g.fillRect(n, 0, 1, 1); }
  canvas.setAttribute("aria-hidden", "true");
  const label = (value) => `${Math.abs(value) >= 100 ? value.toFixed(0) : value.toFixed(1)}`;
  return box("div", "color-bar", made("span", label(low)), canvas, made("span", `${label(high)}\u00a0${unit}`));
}
