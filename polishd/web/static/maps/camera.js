// A camera about a scene: turned, shifted and zoomed by mouse, touch and keys. The scene's z points up.
const TURN = 0.008, KEY_TURN = Math.PI / 36, KEY_SHIFT = 24, NEAR = 0.3, FAR = 12;
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export class Camera {
  // yaw and pitch in rad (pitch 90 deg: from above), radius: of the scene; onMove: called after each change.
  constructor(element, { yaw, pitch, radius, onMove, scale = 0.46 }) {
    this.element = element;
    this.radius = radius;
    this.scale = scale;
    this.onMove = onMove;
    this.home = { yaw, pitch, zoom: 1, panX: 0, panY: 0 };
    this.center = [0, 0, 0];
    Object.assign(this, this.home);
    this.pointers = new Map();
    const listen = (name, does, how) => element.addEventListener(name, does, how);
    listen("pointerdown", (event) => this.down(event));
    listen("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) listen(name, (event) => this.pointers.delete(event.pointerId));
    listen("wheel", (event) => { event.preventDefault(); this.zoomBy(Math.exp(-event.deltaY * 0.0015)); }, { passive: false });
    listen("contextmenu", (event) => event.preventDefault());
    listen("keydown", (event) => this.key(event));
  }

  down(event) {
    this.element.focus({ preventScroll: true });
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], dx = now[0] - before[0], dy = now[1] - before[1];
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]), is = Math.hypot(now[0] - other[0], now[1] - other[1]);
      this.pointers.set(event.pointerId, now);
      this.panX += dx / 2;
      this.panY += dy / 2;
      this.zoomBy(is / Math.max(was, 1));
      return;
    }
    this.pointers.set(event.pointerId, now);
    if (event.shiftKey || event.buttons === 2 || event.buttons === 4) { this.panX += dx; this.panY += dy; } else this.turn(-dx * TURN, dy * TURN);
    this.onMove();
  }

  key(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (way && event.shiftKey) { this.panX -= way[0] * KEY_SHIFT; this.panY -= way[1] * KEY_SHIFT; this.onMove(); } else if (way) { this.turn(-way[0] * KEY_TURN, way[1] * KEY_TURN); this.onMove(); } else if (event.key === "+" || event.key === "=") this.zoomBy(1.2);
    else if (event.key === "-") this.zoomBy(1 / 1.2);
    else if (event.key === "0" || event.key === "Home") this.reset();
    else return;
    event.preventDefault();
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = clamp(this.pitch + pitch, -Math.PI / 2, Math.PI / 2);
  }

  zoomBy(factor) {
    const zoom = clamp(this.zoom * factor, NEAR, FAR), by = zoom / this.zoom;
    this.zoom = zoom;
    this.panX *= by;
    this.panY *= by;
    this.onMove();
  }

  look(yaw, pitch) {
    Object.assign(this, { yaw, pitch, panX: 0, panY: 0, zoom: 1 });
    this.onMove();
  }

  reset() {
    Object.assign(this, this.home);
    this.onMove();
  }

  // Rows: to the right, up, and away from the eye.
  get axes() {
    const [c, s, ce, se] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    return [[c, s, 0], [-s * se, c * se, ce], [-s * ce, c * ce, -se]];
  }

  // px per unit of the scene at its center, and the distance of the eye in units.
  lens(width, height) {
    return { k: (this.scale * Math.min(width, height) * this.zoom) / this.radius, far: 5 * this.radius };
  }

  // A function from a point of the scene to [px, py, distance behind the center].
  projector(width, height) {
    const [right, up, away] = this.axes, { k, far } = this.lens(width, height), c = this.center;
    return (p) => {
      const q = [p[0] - c[0], p[1] - c[1], p[2] - c[2]], dot = (row) => row[0] * q[0] + row[1] * q[1] + row[2] * q[2];
      const depth = dot(away), w = 1 + depth / far;
      return [width / 2 + this.panX + (dot(right) * k) / w, height / 2 + this.panY - (dot(up) * k) / w, depth];
    };
  }
}
