// A cell on a canvas: floor, part, path colored by dwell, robot as a stick figure, and the tool.
import { css, figure, ticks } from "./colormap.js";
import { ring } from "./height_map.js";
import { contextOf, theme } from "./theme.js";

const WIDE = { base: 2, limb: 5, arm: 8, platform: 2.5, tool: 6 };
const PATH = "viridis", SHADES = 24;

// Points of the base frame in the hall's, z up: the hybrid robot hangs with its z down.
export function intoHall(up) {
  return up[2] < 0 ? (p) => [p[0], -p[1], -p[2]] : (p) => p;
}

// The robot's joints at a block, between the two poses about it.
export function jointsAt(poses, block) {
  const { block: blocks, joints_mm: joints } = poses;
  if (!blocks.length) return null;
  let k = 0, end = blocks.length - 1;
  while (end - k > 1) { const middle = (k + end) >> 1; if (blocks[middle] <= block) k = middle; else end = middle; }
  const t = Math.min(Math.max((block - blocks[k]) / (blocks[end] - blocks[k] || 1), 0), 1);
  return joints[k].map((p, n) => p.map((value, c) => value * (1 - t) + joints[end][n][c] * t));
}

// Middle and radius of what is looked at, "part" or "cell", and the height of the floor.
export function sceneOf(cell, hall, what) {
  const points = (what === "part" ? cell.path.mm : [...cell.path.mm, ...cell.poses.joints_mm.filter((_, k) => k % 40 === 0).flat()]).map(hall);
  const ends = [0, 1, 2].map((c) => points.reduce(([low, high], p) => [Math.min(low, p[c]), Math.max(high, p[c])], [Infinity, -Infinity]));
  const center = ends.map(([low, high]) => (low + high) / 2);
  return { center, radius: Math.max(1, points.reduce((most, p) => Math.max(most, Math.hypot(...p.map((value, c) => value - center[c]))), 0)), floor: ends[2][0] };
}

/* Draws the cell; what is shown: { cell, hall, camera, scene, joints, k, touching, limits }.
 * k: number of the path's point where the tool is. Returns where the tip is, px.
 */
export function drawCell(canvas, shown) {
  const { cell, hall, camera, scene, joints, k, touching } = shown, ink = theme(canvas), { g, width, height } = contextOf(canvas);
  const flat = camera.projector(width, height), project = (p) => flat(hall(p));
  g.lineCap = g.lineJoin = "round";
  floor(g, flat, scene, ink);
  if (cell.part) part(g, project, cell.part, ink);
  path(g, project, cell.path, shown.limits, width);
  const tip = cell.path.mm[k];
  if (joints) robot(g, project, hall, cell, joints, ink);
  tool(g, project, cell, tip, touching, ink, camera, width, height);
  triad(g, camera, height, hall, ink);
  return project(tip);
}

function floor(g, flat, { center, radius, floor: z }, ink) {
  const { step } = ticks(-radius, radius, 8), cells = Math.ceil((radius * 1.1) / step), [x0, y0] = [center[0], center[1]].map((value) => Math.round(value / step) * step);
  g.strokeStyle = ink.line;
  g.lineWidth = 0.75;
  g.globalAlpha = 0.7;
  for (let n = -cells; n <= cells; n++) {
    for (const [a, b] of [[[n, -cells], [n, cells]], [[-cells, n], [cells, n]]]) {
      g.beginPath();
      g.moveTo(...flat([x0 + a[0] * step, y0 + a[1] * step, z]).slice(0, 2));
      g.lineTo(...flat([x0 + b[0] * step, y0 + b[1] * step, z]).slice(0, 2));
      g.stroke();
    }
  }
  g.globalAlpha = 1;
  const at = flat([x0 + cells * step, y0 - cells * step, z]);
  g.fillStyle = ink.muted;
  g.textAlign = "center";
  g.textBaseline = "top";
  g.fillText(`${figure(step, 0)} mm`, Math.min(at[0], g.canvas.clientWidth - 30), at[1] + 4);
}

function polygon(g, points) {
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  g.closePath();
}

function part(g, project, { rim_mm: rim, normal }, ink) {
  const down = rim.map((p) => p.map((value, c) => value - normal[c] * 15));
  g.fillStyle = ink.muted;
  g.globalAlpha = 0.35;
  polygon(g, down.map(project));
  g.fill();
  g.globalAlpha = 1;
  g.strokeStyle = ink.muted;
  g.lineWidth = 1;
  g.stroke();
  polygon(g, rim.map(project));
  g.fillStyle = ink.card;
  g.globalAlpha = 0.85;
  g.fill();
  g.globalAlpha = 1;
  g.strokeStyle = ink.text;
  g.lineWidth = 1.25;
  g.stroke();
}

// Lines of one color are one stroke: a few strokes for some thousand points.
function path(g, project, { mm, dwell_s: dwell }, [low, high], width) {
  const at = mm.map(project), shade = dwell.map((s) => Math.min(SHADES - 1, Math.max(0, Math.floor(((s - low) / (high - low || 1)) * SHADES))));
  g.lineWidth = width < 500 ? 1.2 : 1.6;
  for (let n = 0; n < SHADES; n++) {
    g.strokeStyle = css(PATH, n / (SHADES - 1));
    g.beginPath();
    for (let k = 1; k < at.length; k++) if (shade[k] === n) { g.moveTo(at[k - 1][0], at[k - 1][1]); g.lineTo(at[k][0], at[k][1]); }
    g.stroke();
  }
}

function robot(g, project, hall, cell, joints, ink) {
  const places = joints.map(project);
  const links = cell.links.map(([kind, a, b]) => ({ kind, a: places[a], b: places[b], deep: (places[a][2] + places[b][2]) / 2 })).sort((p, q) => q.deep - p.deep);
  for (const { kind, a, b } of links) {
    for (const [color, more] of [[ink.card, 3], [kind === "tool" ? ink.accent : kind === "limb" ? ink.text : ink.muted, 0]]) {
      g.strokeStyle = color;
      g.lineWidth = WIDE[kind] + more;
      g.beginPath();
      g.moveTo(a[0], a[1]);
      g.lineTo(b[0], b[1]);
      g.stroke();
    }
  }
  places.slice(0, -1).forEach(([x, y]) => {
    g.beginPath();
    g.arc(x, y, 4.5, 0, 7);
    g.fillStyle = ink.card;
    g.fill();
    g.strokeStyle = ink.text;
    g.lineWidth = 2;
    g.stroke();
  });
}

// The bonnet as a ball of its radius on the surface, filled while it touches.
function tool(g, project, cell, tip, touching, ink, camera, width, height) {
  const normal = cell.part?.normal ?? cell.up, radius = cell.tool_radius_mm;
  const [x, y] = project(tip.map((value, c) => value + normal[c] * radius)), r = Math.max(5, radius * camera.lens(width, height).k);
  g.beginPath();
  g.arc(x, y, r, 0, 7);
  g.fillStyle = touching ? ink.warn : ink.accent;
  g.globalAlpha = touching ? 0.5 : 0.2;
  g.fill();
  g.globalAlpha = 1;
  g.strokeStyle = touching ? ink.warn : ink.accent;
  g.lineWidth = 2;
  g.stroke();
  const [tx, ty] = project(tip);
  g.beginPath();
  g.arc(tx, ty, 3, 0, 7);
  g.fillStyle = ink.text;
  g.fill();
}

// Directions of the base frame, in the corner.
function triad(g, camera, height, hall, ink) {
  const [right, up] = camera.axes, at = [46, height - 46];
  g.lineWidth = 2;
  g.textAlign = "center";
  g.textBaseline = "middle";
  [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, k) => {
    const p = hall(axis), x = right[0] * p[0] + right[1] * p[1] + right[2] * p[2], y = up[0] * p[0] + up[1] * p[1] + up[2] * p[2];
    g.strokeStyle = g.fillStyle = ink.muted;
    g.beginPath();
    g.moveTo(...at);
    g.lineTo(at[0] + x * 26, at[1] - y * 26);
    g.stroke();
    g.fillText("xyz"[k], at[0] + x * 36, at[1] - y * 36);
  });
}

// The part from above in a corner of the canvas: the path by dwell, and the tool. The robot is some twenty times larger.
export function drawInset(canvas, { cell, hall, k, touching, limits }) {
  if (!cell.part) return;
  const ink = theme(canvas), g = canvas.getContext("2d"), width = canvas.clientWidth, side = Math.max(96, Math.min(220, width * 0.24));
  const n = hall(cell.part.normal), c = hall(cell.part.center_mm), length = (v) => Math.hypot(...v) || 1;
  const right = [1 - n[0] * n[0], -n[0] * n[1], -n[0] * n[2]].map((value, _, v) => value / length(v));
  const up = [n[1] * right[2] - n[2] * right[1], n[2] * right[0] - n[0] * right[2], n[0] * right[1] - n[1] * right[0]];
  const plane = (p) => { const q = hall(p).map((value, axis) => value - c[axis]); return [right, up].map((row) => row[0] * q[0] + row[1] * q[1] + row[2] * q[2]); };
  const spread = [...cell.path.mm, ...cell.part.rim_mm].reduce((most, p) => Math.max(most, ...plane(p).map(Math.abs)), 1), scale = (0.46 * side) / spread, [x0, y0] = [width - side / 2 - 2, side / 2 + 2];
  const project = (p) => { const [x, y] = plane(p); return [x0 + x * scale, y0 - y * scale]; };
  g.fillStyle = ink.card;
  g.strokeStyle = ink.line;
  g.lineWidth = 1;
  g.fillRect(x0 - side / 2, y0 - side / 2, side, side);
  g.strokeRect(x0 - side / 2, y0 - side / 2, side, side);
  path(g, project, cell.path, limits, side);
  polygon(g, cell.part.rim_mm.map(project));
  g.strokeStyle = ink.text;
  g.lineWidth = 1.25;
  g.stroke();
  ring(g, project(cell.path.mm[k]), touching ? 7 : 5);
}

// The colors of the path as a bar that lies.
export function drawLegend(canvas, [low, high], unit) {
  const ink = theme(canvas), { g, width } = contextOf(canvas), shade = g.createLinearGradient(8, 0, width - 8, 0);
  for (let n = 0; n <= 16; n++) shade.addColorStop(n / 16, css(PATH, n / 16));
  g.fillStyle = shade;
  g.fillRect(8, 2, width - 16, 12);
  const { values, digits } = ticks(low, high, 4);
  g.fillStyle = g.strokeStyle = ink.muted;
  g.textBaseline = "top";
  g.textAlign = "center";
  for (const value of values) {
    const x = 8 + ((value - low) / (high - low || 1)) * (width - 16);
    g.fillRect(x, 14, 1, 4);
    g.fillText(figure(value, digits), Math.min(Math.max(x, 14), width - 26), 20);
  }
  g.textAlign = "right";
  g.fillText(unit, width - 2, 20);
}
