// Values along a line of a map, below it (along x) or beside it (along y), on the axis of the map.
import { figure, ticks } from "./colormap.js";
import { contextOf, theme } from "./theme.js";

/* line: [position in mm, value or null, inside the aperture]. how:
 *   from, to    position in mm at both ends of the axis
 *   start, size place and length of that axis on the canvas, px; else what fits
 *   upright     the position runs upwards, and the values to the right
 *   range       [low, high] of the values
 *   at          position of the cursor
 *   unit, axis  of the values; name of the position ("x" or "y")
 */
export function drawProfile(canvas, line, how) {
  const ink = theme(canvas), { g, width, height } = contextOf(canvas), { upright = false, unit = "nm" } = how;
  const [low, high] = how.range, room = (high - low) * 0.06 || 1;
  const v0 = low - room, v1 = high + room;
  const box = upright
    ? { x: 10, y: how.start, w: width - 20, h: how.size }
    : { x: how.start ?? 48, y: 8, w: how.size ?? width - 62, h: height - 8 - (how.own ? 36 : 12) };
  const place = (s, v) => {
    const a = (s - how.from) / (how.to - how.from), b = (v - v0) / (v1 - v0);
    return upright ? [box.x + b * box.w, box.y + (1 - a) * box.h] : [box.x + a * box.w, box.y + (1 - b) * box.h];
  };
  g.lineWidth = 1;
  g.strokeStyle = ink.line;
  g.strokeRect(box.x + 0.5, box.y + 0.5, box.w - 1, box.h - 1);
  const { values, digits } = ticks(low, high, upright ? box.w / 62 : box.h / 32);
  g.fillStyle = ink.muted;
  for (const value of values) {
    const [x, y] = place(how.from, value);
    g.beginPath();
    if (upright) { g.moveTo(x, box.y); g.lineTo(x, box.y + box.h); } else { g.moveTo(box.x, y); g.lineTo(box.x + box.w, y); }
    g.globalAlpha = value === 0 ? 1 : 0.5;
    g.stroke();
    g.globalAlpha = 1;
    g.textAlign = upright ? "center" : "right";
    g.textBaseline = upright ? "top" : "middle";
    if (upright) g.fillText(figure(value, digits), x, box.y + box.h + 6); else g.fillText(figure(value, digits), box.x - 6, y);
  }
  g.textAlign = "center";
  g.textBaseline = "top";
  if (upright) g.fillText(unit, box.x + box.w / 2, box.y + box.h + 22);
  if (!upright) {
    g.save();
    g.translate(10, box.y + box.h / 2);
    g.rotate(-Math.PI / 2);
    g.textBaseline = "middle";
    g.fillText(unit, 0, 0);
    g.restore();
  }
  if (how.own) {
    const places = ticks(how.from, how.to, box.w / 70);
    for (const s of places.values) g.fillText(figure(s, places.digits), place(s, v0)[0], box.y + box.h + 5);
    g.fillText(`${how.axis}, mm`, box.x + box.w / 2, box.y + box.h + 20);
  }
  g.save();
  g.beginPath();
  g.rect(box.x, box.y, box.w, box.h);
  g.clip();
  if (how.at !== null && how.at !== undefined) {
    g.strokeStyle = ink.muted;
    g.setLineDash([3, 3]);
    g.beginPath();
    g.moveTo(...place(how.at, v0)); g.lineTo(...place(how.at, v1));
    g.stroke();
    g.setLineDash([]);
  }
  // first all that is known, thin; then what is in the clear aperture
  for (const [inside, wide, alpha] of [[false, 1, 0.55], [true, 1.6, 1]]) {
    g.strokeStyle = ink.accent;
    g.lineWidth = wide;
    g.globalAlpha = alpha;
    g.beginPath();
    let pen = false;
    for (const [s, v, inner] of line) {
      if (v === null || (inside && !inner)) { pen = false; continue; }
      if (pen) g.lineTo(...place(s, v)); else g.moveTo(...place(s, v));
      pen = true;
    }
    g.stroke();
  }
  g.restore();
  g.globalAlpha = 1;
  return box;
}
