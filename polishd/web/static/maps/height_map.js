// A map on a canvas: values between the samples, color bar, axes in mm, edge of the clear aperture, path and tool.
import { bytesOf, css, figure, tableOf, ticks } from "./colormap.js";
import { contextOf, theme } from "./theme.js";

const DECODED = new WeakMap(), PAINTED = new WeakMap();
const LEFT = 48, BOTTOM = 38, TOP = 10, BAR = 16, BAR_SPACE = 76;

const bytesOfText = (text) => Uint8Array.from(atob(text), (one) => one.charCodeAt(0));

// An answer of /map in either encoding as typed arrays: values (with no NaN beside data), known and aperture as 0 or 1.
export function decodeMap(data) {
  if (data.filled) return data;
  if (DECODED.has(data)) return DECODED.get(data);
  const { nx, ny } = data, count = nx * ny;
  const values = new Float32Array(count), known = new Uint8Array(count), aperture = new Uint8Array(count);
  if (data.encoding === "float32") {
    const bytes = bytesOfText(data[data.key]), view = new DataView(bytes.buffer), bits = bytesOfText(data.aperture);
    for (let k = 0; k < count; k++) {
      values[k] = view.getFloat32(4 * k, true);
      aperture[k] = (bits[k >> 3] >> (7 - (k & 7))) & 1;
    }
  } else {
    data[data.key].forEach((row, i) => row.forEach((value, j) => { values[i * nx + j] = value ?? NaN; aperture[i * nx + j] = value === null ? 0 : 1; }));
  }
  for (let k = 0; k < count; k++) known[k] = Number.isFinite(values[k]) ? 1 : 0;
  const filled = values.slice();
  for (let i = 0; i < ny; i++) for (let j = 0; j < nx; j++) {
    if (known[i * nx + j]) continue;
    let sum = 0, number = 0;
    for (let a = Math.max(0, i - 1); a <= Math.min(ny - 1, i + 1); a++) for (let b = Math.max(0, j - 1); b <= Math.min(nx - 1, j + 1); b++) {
      if (known[a * nx + b]) { sum += values[a * nx + b]; number++; }
    }
    filled[i * nx + j] = number ? sum / number : 0;
  }
  const found = { ...data, values, filled, known, aperture };
  found.outline = outlineOf(found);
  DECODED.set(data, found);
  return found;
}

export const xOf = (map, column) => map.x0_mm + column * map.pitch_mm;
export const yOf = (map, row) => map.y0_mm - row * map.pitch_mm;
export const columnOf = (map, x) => (x - map.x0_mm) / map.pitch_mm;
export const rowOf = (map, y) => (map.y0_mm - y) / map.pitch_mm;

// The value between the four samples about a place in mm; null where there are no data.
export function valueAt(map, x, y) {
  const c = columnOf(map, x), r = rowOf(map, y), { nx, ny, filled, known } = map;
  if (!(c > -0.5 && c < nx - 0.5 && r > -0.5 && r < ny - 0.5)) return null;
  const j = Math.min(Math.max(Math.floor(c), 0), Math.max(nx - 2, 0)), i = Math.min(Math.max(Math.floor(r), 0), Math.max(ny - 2, 0));
  const u = Math.min(Math.max(c - j, 0), 1), v = Math.min(Math.max(r - i, 0), 1), k = i * nx + j, right = nx > 1 ? 1 : 0, below = ny > 1 ? nx : 0;
  const mix = (of) => (of[k] * (1 - u) + of[k + right] * u) * (1 - v) + (of[k + below] * (1 - u) + of[k + below + right] * u) * v;
  return mix(known) >= 0.5 ? mix(filled) : null;
}

// Values along a line through a place: [position in mm, value or null, inside the clear aperture].
export function profileOf(map, axis, at) {
  const along = axis === "x", count = along ? map.nx : map.ny, line = [];
  const across = along ? rowOf(map, at) : columnOf(map, at), near = Math.round(across), most = along ? map.ny : map.nx;
  for (let k = 0; k < count; k++) {
    const [x, y] = along ? [xOf(map, k), at] : [at, yOf(map, count - 1 - k)];
    const i = along ? near : count - 1 - k, j = along ? k : near;
    line.push([along ? x : y, valueAt(map, x, y), near >= 0 && near < most && map.aperture[i * map.nx + j] === 1]);
  }
  return line;
}

// The edge of the clear aperture as closed lines [[x, y], ...] in mm, half-way between a sample inside and one outside,
// smoothed by less than half a sample: the edge of the part has no steps.
const SMOOTH = [1, 4, 6, 4, 1], ROUNDS = 8;

function outlineOf(map) {
  const { nx, ny, aperture } = map, next = new Map(), lines = [];
  const inside = (i, j) => i >= 0 && j >= 0 && i < ny && j < nx && aperture[i * nx + j] === 1;
  const name = (i, j) => `${i},${j}`; // of an edge's middle, in half samples
  for (let i = -1; i < ny; i++) for (let j = -1; j < nx; j++) {
    const corners = [inside(i, j), inside(i, j + 1), inside(i + 1, j + 1), inside(i + 1, j)];
    const middles = [[2 * i, 2 * j + 1], [2 * i + 1, 2 * j + 2], [2 * i + 2, 2 * j + 1], [2 * i + 1, 2 * j]];
    // from each edge where the inside begins, clockwise, to the next edge where it ends
    for (let k = 0; k < 4; k++) {
      if (corners[k] || !corners[(k + 1) % 4]) continue;
      let e = (k + 1) % 4;
      while (!corners[e] || corners[(e + 1) % 4]) e = (e + 1) % 4;
      next.set(name(...middles[k]), { at: middles[k], to: middles[e] });
    }
  }
  while (next.size) {
    let [key] = next.keys();
    const line = [];
    for (let one = next.get(key); one; one = next.get(key)) {
      line.push([map.x0_mm + (one.at[1] / 2) * map.pitch_mm, map.y0_mm - (one.at[0] / 2) * map.pitch_mm]);
      next.delete(key);
      key = name(...one.to);
    }
    lines.push(line);
  }
  return lines.map((line) => smoothed(line, map.pitch_mm / 2));
}

function smoothed(line, most) {
  const n = line.length;
  if (n < 24) return line;
  let found = line;
  for (let round = 0; round < ROUNDS; round++) {
    const was = found;
    found = was.map((_, k) => [0, 1].map((c) => SMOOTH.reduce((sum, weight, m) => sum + weight * was[(k + m - 2 + n) % n][c], 0) / 16));
  }
  return found.map((p, k) => {
    const [dx, dy] = [p[0] - line[k][0], p[1] - line[k][1]], away = Math.hypot(dx, dy), by = away > most ? most / away : 1;
    return [line[k][0] + dx * by, line[k][1] + dy * by];
  });
}

// What the whole map takes, in mm: [left, bottom, right, top].
export function extentOf(map) {
  const half = map.pitch_mm / 2;
  return [map.x0_mm - half, yOf(map, map.ny - 1) - half, xOf(map, map.nx - 1) + half, map.y0_mm + half];
}

// The view of a whole map in a plot of that size.
export function wholeView(map, plot) {
  const [left, bottom, right, top] = extentOf(map);
  return { x: (left + right) / 2, y: (bottom + top) / 2, mmPerPx: Math.max((right - left) / plot.w, (top - bottom) / plot.h) * 1.02 };
}

/* Draws a map and returns its geometry: the plot's rectangle, toPx(x, y), toMm(px, py), the view and the scale.
 *
 * data: an answer of /api/jobs/J/cycles/C/map/KIND. options, all optional:
 *   compact    no axes and no color bar: a thumbnail
 *   colors    name of a table of colormap.js; else by the kind of the map
 *   scale      [low, high] where the colors end; else the answer's
 *   smooth     false: the samples themselves
 *   outside    "dim" (default), "hide" or "show" what lies outside the clear aperture
 *   outline    false: no edge of the clear aperture
 *   path       { x_mm, y_mm } as a thin line
 *   tool       [x, y] mm: a ring
 *   view       { x, y, mmPerPx } of the middle; else the whole map
 *   cursor     [x, y] mm: crosshair
 *   label      the canvas' text for screen readers
 */
export function drawHeightMap(canvas, data, options = {}) {
  const map = decodeMap(data), ink = theme(canvas), { g, width, height, dpr } = contextOf(canvas);
  const { compact = false, colors = tableOf(map.signed), scale = map.scale, outside = "dim" } = options;
  const plot = compact ? { x: 0, y: 0, w: width, h: height } : { x: LEFT, y: TOP, w: Math.max(20, width - LEFT - BAR_SPACE), h: Math.max(20, height - TOP - BOTTOM) };
  const view = options.view ?? wholeView(map, plot);
  const toPx = (x, y) => [plot.x + plot.w / 2 + (x - view.x) / view.mmPerPx, plot.y + plot.h / 2 - (y - view.y) / view.mmPerPx];
  const toMm = (px, py) => [view.x + (px - plot.x - plot.w / 2) * view.mmPerPx, view.y - (py - plot.y - plot.h / 2) * view.mmPerPx];
  const picture = painted(canvas, map, { colors, scale, smooth: options.smooth !== false, view, plot, dpr });
  g.save();
  g.beginPath();
  g.rect(plot.x, plot.y, plot.w, plot.h);
  g.clip();
  g.globalAlpha = { hide: 0, dim: 0.28, show: 1 }[outside];
  if (map.outline.length || outside === "show") g.drawImage(picture, plot.x, plot.y, plot.w, plot.h);
  g.globalAlpha = 1;
  const edge = edgeOf(map.outline, toPx);
  g.save();
  g.clip(edge, "evenodd");
  g.drawImage(picture, plot.x, plot.y, plot.w, plot.h);
  g.restore();
  if (options.outline !== false) { g.strokeStyle = ink.text; g.lineWidth = 1.25; g.stroke(edge); }
  if (options.path) strokePath(g, options.path, toPx, view.mmPerPx);
  if (options.cursor) crosshair(g, plot, toPx(...options.cursor));
  if (options.tool) ring(g, toPx(...options.tool));
  g.restore();
  if (!compact) {
    axes(g, plot, toMm, ink);
    colorBar(g, { x: plot.x + plot.w + 14, y: plot.y, w: BAR, h: plot.h }, map, colors, scale, ink);
  }
  if (options.label) canvas.setAttribute("aria-label", options.label);
  return { plot, view, scale, colors, toPx, toMm, map };
}

// The picture of the values alone, kept until something of it changes: a moved cursor paints nothing anew.
function painted(canvas, map, how) {
  const { view, plot, dpr, scale } = how;
  const key = JSON.stringify([how.colors, scale, how.smooth, view, plot, dpr]);
  const cached = PAINTED.get(canvas);
  if (cached?.map === map && cached.key === key) return cached.picture;
  const picture = cached?.picture ?? document.createElement("canvas");
  const w = Math.max(1, Math.round(plot.w * dpr)), h = Math.max(1, Math.round(plot.h * dpr));
  picture.width = w;
  picture.height = h;
  const image = new ImageData(w, h), out = image.data, table = bytesOf(how.colors);
  const { nx, ny, filled, known } = map, per = (view.mmPerPx * (plot.w / w)) / map.pitch_mm;
  const left = columnOf(map, view.x) - (w / 2 - 0.5) * per, top = rowOf(map, view.y) - (h / 2 - 0.5) * per;
  const span = 1023 / (scale[1] - scale[0] || 1);
  for (let py = 0; py < h; py++) {
    const r = top + py * per;
    if (r <= -0.5 || r >= ny - 0.5) continue;
    const i = Math.min(Math.max(Math.floor(r), 0), Math.max(ny - 2, 0)), v = how.smooth ? Math.min(Math.max(r - i, 0), 1) : Math.round(Math.min(Math.max(r - i, 0), 1));
    const below = ny > 1 ? nx : 0;
    for (let px = 0; px < w; px++) {
      const c = left + px * per;
      if (c <= -0.5 || c >= nx - 0.5) continue;
      const j = Math.min(Math.max(Math.floor(c), 0), Math.max(nx - 2, 0)), u = how.smooth ? Math.min(Math.max(c - j, 0), 1) : Math.round(Math.min(Math.max(c - j, 0), 1));
      const k = i * nx + j, right = nx > 1 ? 1 : 0, a = (1 - u) * (1 - v), b = u * (1 - v), d = (1 - u) * v, e = u * v;
      if (known[k] * a + known[k + right] * b + known[k + below] * d + known[k + below + right] * e < 0.5) continue;
      const value = filled[k] * a + filled[k + right] * b + filled[k + below] * d + filled[k + below + right] * e;
      const t = 3 * Math.min(Math.max(Math.round((value - scale[0]) * span), 0), 1023), o = 4 * (py * w + px);
      out[o] = table[t];
      out[o + 1] = table[t + 1];
      out[o + 2] = table[t + 2];
      out[o + 3] = 255;
    }
  }
  picture.getContext("2d").putImageData(image, 0, 0);
  PAINTED.set(canvas, { map, key, picture });
  return picture;
}

function edgeOf(outline, toPx) {
  const edge = new Path2D();
  for (const line of outline) {
    line.forEach(([x, y], k) => (k ? edge.lineTo(...toPx(x, y)) : edge.moveTo(...toPx(x, y))));
    edge.closePath();
  }
  return edge;
}

// Thin beside the distance of its lines, so that the map stays readable under it.
function strokePath(g, path, toPx, mmPerPx) {
  g.beginPath();
  for (let k = 0; k < path.x_mm.length; k++) g.lineTo(...toPx(path.x_mm[k], path.y_mm[k]));
  g.lineJoin = "round";
  const near = mmPerPx < 0.12;
  for (const [color, wide] of near ? [["rgb(255 255 255 / .6)", 2], ["rgb(0 0 0 / .75)", 0.8]] : [["rgb(0 0 0 / .45)", 0.5]]) {
    g.strokeStyle = color;
    g.lineWidth = wide;
    g.stroke();
  }
}

function crosshair(g, plot, [x, y]) {
  const gap = 7, lines = [[plot.x, y, x - gap, y], [x + gap, y, plot.x + plot.w, y], [x, plot.y, x, y - gap], [x, y + gap, x, plot.y + plot.h]];
  for (const [color, wide] of [["rgb(255 255 255 / .75)", 3], ["#111", 1]]) {
    g.strokeStyle = color;
    g.lineWidth = wide;
    g.beginPath();
    for (const [ax, ay, bx, by] of lines) { g.moveTo(ax, ay); g.lineTo(bx, by); }
    g.stroke();
    g.beginPath();
    g.arc(x, y, gap - 3, 0, 7);
    g.stroke();
  }
}

export function ring(g, [x, y], radius = 9) {
  for (const [color, wide] of [["#fff", 5], ["#111", 2.5]]) {
    g.strokeStyle = color;
    g.lineWidth = wide;
    g.beginPath();
    g.arc(x, y, radius, 0, 7);
    g.stroke();
  }
}

function axes(g, plot, toMm, ink) {
  g.strokeStyle = ink.line;
  g.lineWidth = 1;
  g.strokeRect(plot.x + 0.5, plot.y + 0.5, plot.w - 1, plot.h - 1);
  g.fillStyle = ink.muted;
  g.strokeStyle = ink.muted;
  const [left, bottom] = toMm(plot.x, plot.y + plot.h), [right, top] = toMm(plot.x + plot.w, plot.y);
  const xs = ticks(left, right, plot.w / 70), ys = ticks(bottom, top, plot.h / 55);
  g.textAlign = "center";
  g.textBaseline = "top";
  g.beginPath();
  for (const x of xs.values) {
    const px = plot.x + ((x - left) / (right - left)) * plot.w;
    g.moveTo(px, plot.y + plot.h); g.lineTo(px, plot.y + plot.h + 4);
    g.fillText(figure(x, xs.digits), px, plot.y + plot.h + 6);
  }
  g.fillText("x, mm", plot.x + plot.w / 2, plot.y + plot.h + 22);
  g.textAlign = "right";
  g.textBaseline = "middle";
  for (const y of ys.values) {
    const py = plot.y + plot.h - ((y - bottom) / (top - bottom)) * plot.h;
    g.moveTo(plot.x, py); g.lineTo(plot.x - 4, py);
    g.fillText(figure(y, ys.digits), plot.x - 6, py);
  }
  g.stroke();
  g.save();
  g.translate(10, plot.y + plot.h / 2);
  g.rotate(-Math.PI / 2);
  g.textAlign = "center";
  g.fillText("y, mm", 0, 0);
  g.restore();
}

// The color bar with its ticks; an end is pointed where values lie beyond it, as in the reports.
export function colorBar(g, box, map, colors, scale, ink) {
  const tip = 9, over = map.high > scale[1] * (1 + 1e-9) + 1e-12, under = map.low < scale[0] * (1 - Math.sign(scale[0]) * 1e-9) - 1e-12;
  const top = box.y + tip, h = box.h - 2 * tip;
  const shade = g.createLinearGradient(0, top + h, 0, top);
  for (let k = 0; k <= 32; k++) shade.addColorStop(k / 32, css(colors, k / 32));
  g.fillStyle = shade;
  g.fillRect(box.x, top, box.w, h);
  const point = (y, away, t) => {
    g.fillStyle = css(colors, t);
    g.beginPath();
    g.moveTo(box.x, y); g.lineTo(box.x + box.w, y); g.lineTo(box.x + box.w / 2, away);
    g.fill();
  };
  if (over) point(top + 0.5, box.y, 1);
  if (under) point(top + h - 0.5, box.y + box.h, 0);
  g.strokeStyle = ink.line;
  g.lineWidth = 1;
  g.strokeRect(box.x + 0.5, top + 0.5, box.w - 1, h - 1);
  const { values, digits } = ticks(scale[0], scale[1], h / 45);
  g.fillStyle = g.strokeStyle = ink.muted;
  g.textAlign = "left";
  g.textBaseline = "middle";
  g.beginPath();
  for (const value of values) {
    const y = top + h * (1 - (value - scale[0]) / (scale[1] - scale[0]));
    g.moveTo(box.x + box.w, y); g.lineTo(box.x + box.w + 4, y);
    g.fillText(figure(value, digits), box.x + box.w + 7, y);
  }
  g.stroke();
  g.textAlign = "center";
  g.textBaseline = "top";
  if (map.unit) g.fillText(map.unit, box.x + box.w / 2, box.y + box.h + 6);
}
