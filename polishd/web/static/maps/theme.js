// Colors of the page's theme on canvases, canvases of the screen's resolution, and what both have to be drawn anew for.
const FALLBACK = {
  light: { text: "#1b2026", muted: "#5b636b", line: "#c9d0d6", card: "#ffffff", accent: "#005a9c", focus: "#005a9c", alarm: "#b00020", warn: "#8a4b00", ok: "#006d4e" },
  dark: { text: "#eef1f3", muted: "#a3adb5", line: "#3a434a", card: "#1d2327", accent: "#7cc4ff", focus: "#7cc4ff", alarm: "#ff8a8a", warn: "#ffb454", ok: "#4fd1a5" },
};
const DARK = matchMedia("(prefers-color-scheme: dark)");

export function theme(element) {
  const style = getComputedStyle(element), defaults = FALLBACK[DARK.matches ? "dark" : "light"];
  return Object.fromEntries(Object.entries(defaults).map(([name, value]) => [name, style.getPropertyValue(`--${name}`).trim() || value]));
}

// Calls back when an element changes its size, or the page its colors; returns what ends it.
export function onChange(elements, callback) {
  let waits = 0;
  const soon = () => { cancelAnimationFrame(waits); waits = requestAnimationFrame(callback); };
  const size = new ResizeObserver(soon), look = new MutationObserver(soon);
  for (const one of elements) size.observe(one);
  for (const one of [document.documentElement, document.body]) look.observe(one, { attributes: true, attributeFilter: ["class", "data-theme", "style"] });
  DARK.addEventListener("change", soon);
  return () => { cancelAnimationFrame(waits); size.disconnect(); look.disconnect(); DARK.removeEventListener("change", soon); };
}

// The 2-D context of a canvas that is as sharp as the screen; lengths are in CSS pixels.
export function contextOf(canvas) {
  const dpr = Math.min(window.devicePixelRatio || 1, 3), width = canvas.clientWidth, height = canvas.clientHeight;
  const [w, h] = [Math.max(1, Math.round(width * dpr)), Math.max(1, Math.round(height * dpr))];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const g = canvas.getContext("2d");
  g.setTransform(dpr, 0, 0, dpr, 0, 0);
  g.clearRect(0, 0, width, height);
  g.font = "12px Inter, system-ui, sans-serif";
  return { g, width, height, dpr };
}

// A CSS color as [r, g, b] of 0 to 1.
const PARSED = new Map();
export function rgbOf(color) {
  if (!PARSED.has(color)) {
    const g = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    g.fillStyle = color;
    g.fillRect(0, 0, 1, 1);
    PARSED.set(color, [...g.getImageData(0, 0, 1, 1).data.slice(0, 3)].map((value) => value / 255));
  }
  return PARSED.get(color);
}

// Calls once before the next frame, however often it is called.
export function oncePerFrame(callback) {
  let waits = false;
  return () => {
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => { waits = false; callback(); });
  };
}
