// Pictures on canvases, from arrays. Colours are taken from the page, so that dark and light are one.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function begun(canvas, title) {
  const g = canvas.getContext("2d");
  g.clearRect(0, 0, canvas.width, canvas.height);
  g.font = "15px system-ui, sans-serif";
  g.fillStyle = colour("--ink");
  g.fillText(title, 4, 15);
  canvas.setAttribute("aria-label", title);
  return g;
}

// Points [x, y]; y null: no line there. A steady value is a line, too.
export function line(canvas, title, points, { marks = [], log = false, dots = false } = {}) {
  const g = begun(canvas, title);
  const map = (v) => (log ? Math.log10(Math.max(v, 1e-12)) : v);
  const good = [...points, ...marks].filter((p) => p[1] !== null && Number.isFinite(p[1]));
  if (!good.length) return;
  const xs = good.map((p) => p[0]), ys = good.map((p) => map(p[1]));
  const low = (v) => v.reduce((a, b) => Math.min(a, b)), high = (v) => v.reduce((a, b) => Math.max(a, b));
  let [x0, x1, y0, y1] = [low(xs), high(xs), low(ys), high(ys)];
  if (x1 === x0) x1 = x0 + 1;
  if (y1 - y0 < 1e-9) { y0 -= 1; y1 += 1; }
  const w = canvas.width - 80, h = canvas.height - 40;
  const at = (p) => [70 + ((p[0] - x0) / (x1 - x0)) * w, 28 + (1 - (map(p[1]) - y0) / (y1 - y0)) * h];
  g.strokeStyle = colour("--line");
  g.strokeRect(70, 28, w, h);
  const word = (v) => (log ? (10 ** v).toExponential(0) : Math.abs(v) >= 1000 ? v.toFixed(0) : v.toPrecision(3));
  g.fillText(word(y1), 4, 40);
  g.fillText(word(y0), 4, 28 + h);
  g.strokeStyle = colour("--key");
  g.lineWidth = 2;
  g.beginPath();
  let pen = false;
  for (const p of points) {
    if (p[1] === null || !Number.isFinite(p[1])) { pen = false; continue; }
    if (pen) g.lineTo(...at(p)); else g.moveTo(...at(p));
    pen = true;
  }
  g.stroke();
  if (dots) for (const p of points) { g.fillStyle = colour("--key"); g.beginPath(); g.arc(...at(p), 4, 0, 7); g.fill(); }
  g.strokeStyle = colour("--warn");
  for (const p of marks) { g.beginPath(); g.arc(...at(p), 7, 0, 7); g.stroke(); }
}

// Blue is low, yellow is high (as cividis), so that lightness alone shows the height.
function shade(t) {
  const a = [0, 34, 78], b = [124, 123, 120], c = [254, 232, 56], u = t < 0.5 ? t * 2 : t * 2 - 1;
  const [p, q] = t < 0.5 ? [a, b] : [b, c];
  return p.map((v, k) => Math.round(v + (q[k] - v) * u));
}

// A map, the path over it in its frame (mm, y up, centred), and where the tool is.
export function map(canvas, title, data, plan, block) {
  const g = begun(canvas, "");
  canvas.setAttribute("aria-label", title);
  const rows = data.height_nm, ny = rows.length, nx = rows[0].length;
  const image = new ImageData(nx, ny), span = data.high_nm - data.low_nm || 1;
  rows.forEach((row, i) => row.forEach((v, j) => {
    if (v === null) return;
    image.data.set([...shade((v - data.low_nm) / span), 255], 4 * (i * nx + j));
  }));
  const small = document.createElement("canvas");
  small.width = nx; small.height = ny;
  small.getContext("2d").putImageData(image, 0, 0);
  const scale = Math.min(canvas.width / nx, canvas.height / ny);
  const [w, h] = [nx * scale, ny * scale], [ox, oy] = [(canvas.width - w) / 2, (canvas.height - h) / 2];
  g.imageSmoothingEnabled = false;
  g.drawImage(small, ox, oy, w, h);
  if (!plan) return;
  const at = (k) => [canvas.width / 2 + (plan.x_mm[k] / data.pitch_mm) * scale, canvas.height / 2 - (plan.y_mm[k] / data.pitch_mm) * scale];
  g.strokeStyle = "rgba(255,255,255,.45)";
  g.lineWidth = 1;
  g.beginPath();
  plan.x_mm.forEach((_, k) => (k ? g.lineTo(...at(k)) : g.moveTo(...at(k))));
  g.stroke();
  if (block === null) return;
  const k = Math.max(0, plan.block.findIndex((one) => one >= block));
  for (const [radius, ink] of [[11, "#000"], [9, "#fff"]]) {
    g.strokeStyle = ink; g.lineWidth = 3;
    g.beginPath(); g.arc(...at(k), radius, 0, 7); g.stroke();
  }
}
