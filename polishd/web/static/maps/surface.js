/* A map as a lit surface, in plain WebGL 2: one mesh, one light, one table of colors. A scene library adds
 * several hundred kB and would still need the axes, the walls and the keys that are written here. */
import { bytesOf, figure, ticks } from "./colormap.js";
import { colorBar } from "./height_map.js";
import { contextOf, rgbOf, theme } from "./theme.js";

const MOST = 256, RELIEF = 0.24;
const UNIFORMS = ["axes", "lens", "frame", "relief", "scale", "body"];
const VERTEX = `#version 300 es
in vec2 place; in float value; in vec2 slope; in float wall;
uniform mat3 axes; uniform vec2 lens; uniform vec4 frame; uniform vec3 relief; uniform vec2 scale;
out float shade; out vec3 normal; out float side;
void main() {
  float z = wall > 1.5 ? relief.z : (value - relief.x) * relief.y;
  vec3 seen = axes * vec3(place, z);
  float w = 1.0 + seen.z / lens.y;
  gl_Position = vec4(seen.x * lens.x * frame.x + frame.z * w, seen.y * lens.x * frame.y + frame.w * w, seen.z / lens.y * w * 0.9, w);
  shade = (value - scale.x) / (scale.y - scale.x);
  normal = axes * normalize(vec3(-slope * relief.y, 1.0));
  side = wall;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in float shade; in vec3 normal; in float side;
uniform sampler2D table; uniform vec3 body;
out vec4 color;
void main() {
  vec3 n = normalize(normal), sun = normalize(vec3(-0.5, 0.75, -0.65)), half_way = normalize(sun + vec3(0.0, 0.0, -1.0));
  float light = 0.5 + 0.55 * max(dot(n, sun), 0.0), gloss = 0.16 * pow(max(dot(n, half_way), 0.0), 24.0);
  vec3 paint = texture(table, vec2(clamp(shade, 0.001, 0.999), 0.5)).rgb;
  color = side > 0.5 ? vec4(body * 0.92, 1.0) : vec4(paint * light + gloss, 1.0);
}`;

export class Surface {
  // Throws where the browser has no WebGL 2. ``labels``: a canvas above the other one, for axes and color bar.
  constructor(canvas, labels, camera) {
    this.canvas = canvas;
    this.labels = labels;
    this.camera = camera;
    this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, alpha: true });
    if (!this.gl) throw new Error("no WebGL 2");
    this.program = programOf(this.gl);
    this.places = Object.fromEntries(UNIFORMS.map((name) => [name, this.gl.getUniformLocation(this.program, name)]));
    this.count = 0;
  }

  // The mesh of a decoded map: of its clear aperture, or of all data.
  set(map, { whole = false, colors, scale }) {
    const { gl } = this, mesh = meshOf(map, whole);
    Object.assign(this, { map, colors, scale, box: mesh.box, count: mesh.indices.length });
    for (const [name, size, data] of [["place", 2, mesh.place], ["value", 1, mesh.value], ["slope", 2, mesh.slope], ["wall", 1, mesh.wall]]) {
      const at = gl.getAttribLocation(this.program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, (this[name] ??= gl.createBuffer()));
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, (this.indices ??= gl.createBuffer()));
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.indices, gl.STATIC_DRAW);
    gl.bindTexture(gl.TEXTURE_2D, (this.texture ??= gl.createTexture()));
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 1024, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(bytesOf(colors)));
    for (const [name, value] of [["TEXTURE_MIN_FILTER", "LINEAR"], ["TEXTURE_MAG_FILTER", "LINEAR"], ["TEXTURE_WRAP_S", "CLAMP_TO_EDGE"], ["TEXTURE_WRAP_T", "CLAMP_TO_EDGE"]]) {
      gl.texParameteri(gl.TEXTURE_2D, gl[name], gl[value]);
    }
  }

  // Height over width as drawn, over height over width as it is, of heights in nm.
  exaggeration(factor) {
    const { low, high, size } = this.box;
    return ((2 * RELIEF * factor) / ((high - low) || 1)) * size * 1e6;
  }

  draw(factor) {
    if (!this.count || this.gl.isContextLost()) return;
    const { gl, canvas, camera, box, program } = this, ink = theme(canvas);
    const dpr = Math.min(window.devicePixelRatio || 1, 2), width = canvas.clientWidth, height = canvas.clientHeight;
    const [w, h] = [Math.max(1, Math.round(width * dpr)), Math.max(1, Math.round(height * dpr))];
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const shown = width - 84, middle = (box.low + box.high) / 2, rise = (2 * RELIEF * factor) / ((box.high - box.low) || 1);
    const bottom = -RELIEF * factor - 0.06, { k, far } = camera.lens(shown, height), set = (name) => this.places[name];
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(program);
    gl.uniformMatrix3fv(set("axes"), true, camera.axes.flat());
    gl.uniform2f(set("lens"), k, far);
    gl.uniform4f(set("frame"), 2 / width, 2 / height, (2 * (shown / 2 + camera.panX)) / width - 1, (-2 * camera.panY) / height);
    gl.uniform3f(set("relief"), middle, rise, bottom);
    gl.uniform2f(set("scale"), ...this.scale);
    gl.uniform3f(set("body"), ...rgbOf(ink.line));
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    this.label(ink, camera.projector(shown, height), bottom, (value) => (value - middle) * rise);
  }

  // Axes along the edges of the box that do not hide the surface, and the color bar.
  label(ink, project, bottom, rise) {
    const { g, width, height } = contextOf(this.labels), { box, map } = this, [hx, hy] = box.half, middle = project([0, 0, bottom]);
    const away = this.camera.axes[2], sx = away[0] > 0 ? -1 : 1, sy = away[1] > 0 ? -1 : 1;
    g.strokeStyle = ink.muted;
    g.fillStyle = ink.muted;
    g.lineWidth = 1;
    const line = (a, b) => { g.beginPath(); g.moveTo(...project(a).slice(0, 2)); g.lineTo(...project(b).slice(0, 2)); g.stroke(); };
    const write = (label, [x, y], from) => {
      const d = Math.hypot(x - from[0], y - from[1]) || 1, dx = (x - from[0]) / d, dy = (y - from[1]) / d;
      g.textAlign = dx > 0.4 ? "left" : dx < -0.4 ? "right" : "center";
      g.textBaseline = dy > 0.4 ? "top" : dy < -0.4 ? "bottom" : "middle";
      g.fillText(label, x + dx * 8, y + dy * 8);
    };
    const axis = (from, to, scale, name, at) => {
      const { values, digits } = ticks(...scale, 5), names = [];
      line(from, to);
      for (const value of values) names.push([figure(value, digits), project(at(value))]);
      const [a, b] = [project(from), project(to)], [x, y] = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
      for (const [label, place] of names) write(label, place, middle);
      const d = Math.hypot(x - middle[0], y - middle[1]) || 1;
      write(name, [x + ((x - middle[0]) / d) * 26, y + ((y - middle[1]) / d) * 22], middle);
    };
    const unit = (k) => (mm) => (mm - box.middle[k]) / box.size, ends = (k) => [-1, 1].map((sign) => box.middle[k] + sign * box.half[k] * box.size);
    axis([-hx, sy * hy, bottom], [hx, sy * hy, bottom], ends(0), "x, mm", (x) => [unit(0)(x), sy * hy, bottom]);
    axis([sx * hx, -hy, bottom], [sx * hx, hy, bottom], ends(1), "y, mm", (y) => [sx * hx, unit(1)(y), bottom]);
    if (Math.abs(this.camera.pitch) < 1.35) {
      const corners = [[-hx, -hy], [-hx, hy], [hx, -hy], [hx, hy]], [left] = corners.sort((a, b) => project([...a, 0])[0] - project([...b, 0])[0]);
      const { values, digits } = ticks(box.low, box.high, Math.min(5, (project([...left, rise(box.low)])[1] - project([...left, rise(box.high)])[1]) / 24));
      line([...left, bottom], [...left, rise(box.high)]);
      const top = project([...left, rise(box.high)]);
      if (map.unit) write(map.unit, [top[0], top[1] - 4], [top[0], top[1] + 9]);
      for (const value of values) {
        const at = project([...left, rise(value)]);
        write(figure(value, digits), at, [at[0] + 9, at[1]]);
      }
    }
    colorBar(g, { x: width - 74, y: 12, w: 16, h: height - 44 }, map, this.colors, this.scale, ink);
  }

  end() {
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

function programOf(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no WebGL program");
  return program;
}

// Each quad of four samples that are inside is two triangles; where it has no neighbour a wall goes down.
export function meshOf(map, whole) {
  const step = Math.max(1, Math.ceil(Math.max(map.nx, map.ny) / MOST)), inside = whole ? map.known : map.aperture;
  const columns = Math.floor((map.nx - 1) / step) + 1, rows = Math.floor((map.ny - 1) / step) + 1;
  const source = (i, j) => i * step * map.nx + j * step, at = (i, j) => i * columns + j;
  const quad = (i, j) => i >= 0 && j >= 0 && i < rows - 1 && j < columns - 1
    && [[0, 0], [0, 1], [1, 0], [1, 1]].every(([a, b]) => inside[source(i + a, j + b)] && map.known[source(i + a, j + b)]);
  let [low, high, left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity, Infinity, -Infinity];
  for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
    const k = source(i, j);
    if (!inside[k] || !map.known[k]) continue;
    low = Math.min(low, map.values[k]); high = Math.max(high, map.values[k]);
    left = Math.min(left, j); right = Math.max(right, j); top = Math.min(top, i); bottom = Math.max(bottom, i);
  }
  if (!(high >= low)) [low, high, left, right, top, bottom] = [0, 1, 0, columns - 1, 0, rows - 1];
  const mm = map.pitch_mm * step, x = (j) => map.x0_mm + j * mm, y = (i) => map.y0_mm - i * mm;
  const size = (Math.max(right - left, bottom - top) / 2) * mm || 1, middle = [(x(left) + x(right)) / 2, (y(top) + y(bottom)) / 2];
  const place = [], value = [], slope = [], wall = [], indices = [];
  for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
    const k = source(i, j), f = map.filled, [a, b] = [Math.max(j - 1, 0), Math.min(j + 1, columns - 1)], [c, d] = [Math.max(i - 1, 0), Math.min(i + 1, rows - 1)];
    place.push((x(j) - middle[0]) / size, (y(i) - middle[1]) / size);
    value.push(f[k]);
    slope.push(((f[source(i, b)] - f[source(i, a)]) / ((b - a) * mm || 1)) * size, ((f[source(c, j)] - f[source(d, j)]) / ((d - c) * mm || 1)) * size);
    wall.push(0);
  }
  const wallAt = (i, j, p, q) => {
    const first = wall.length;
    for (const [r, s] of [p, q]) for (const kind of [1, 2]) {
      place.push((x(j + s) - middle[0]) / size, (y(i + r) - middle[1]) / size);
      value.push(map.filled[source(i + r, j + s)]);
      slope.push(0, 0);
      wall.push(kind);
    }
    indices.push(first, first + 1, first + 2, first + 1, first + 3, first + 2);
  };
  for (let i = 0; i < rows - 1; i++) for (let j = 0; j < columns - 1; j++) {
    if (!quad(i, j)) continue;
    indices.push(at(i, j), at(i + 1, j), at(i, j + 1), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1));
    if (!quad(i - 1, j)) wallAt(i, j, [0, 0], [0, 1]);
    if (!quad(i + 1, j)) wallAt(i, j, [1, 0], [1, 1]);
    if (!quad(i, j - 1)) wallAt(i, j, [0, 0], [1, 0]);
    if (!quad(i, j + 1)) wallAt(i, j, [0, 1], [1, 1]);
  }
  const half = [((right - left) / 2) * mm / size || 1, ((bottom - top) / 2) * mm / size || 1];
  return {
    place: new Float32Array(place), value: new Float32Array(value), slope: new Float32Array(slope), wall: new Float32Array(wall),
    indices: new Uint32Array(indices), box: { low, high, size, middle, half },
  };
}
