// Figures for people: sensible digits, and always a unit. A missing value is an en dash.
export const NONE = "–";
const missing = (value) => value === null || value === undefined || !Number.isFinite(Number(value));

// `value` with so many significant digits, thousands apart, without exponents.
export function figure(value, significant = 3) {
  if (missing(value)) return NONE;
  const one = Number(value);
  if (one === 0) return "0";
  const decimals = Math.max(0, significant - 1 - Math.floor(Math.log10(Math.abs(one))));
  return one.toLocaleString("en", { minimumFractionDigits: Math.min(decimals, 6), maximumFractionDigits: Math.min(decimals, 6) }).replaceAll(",", "\u202f");
}
export const fixed = (value, decimals) => (missing(value) ? NONE : Number(value).toFixed(decimals));
export const withUnit = (value, unit, significant = 3) => (missing(value) ? NONE : `${figure(value, significant)}\u00a0${unit}`);
export const percent = (share) => (missing(share) ? NONE : `${Number((100 * share).toFixed(share < 0.1 ? 1 : 0))}\u00a0%`);

// A duration: "45 s", "12 min", "3 h 05 min", "2 d 4 h".
export function duration(seconds) {
  if (missing(seconds)) return NONE;
  const s = Math.max(0, Number(seconds));
  if (s < 10) return `${s.toFixed(1)}\u00a0s`;
  if (s < 90) return `${Math.round(s)}\u00a0s`;
  const min = Math.round(s / 60);
  if (min < 60) return `${min}\u00a0min`;
  const h = Math.floor(min / 60);
  if (h < 48) return `${h}\u00a0h\u00a0${String(min % 60).padStart(2, "0")}\u00a0min`;
  return `${Math.floor(h / 24)}\u00a0d\u00a0${h % 24}\u00a0h`;
}

// A time of day; with the date where it is not today's.
export function clock(atS, nowMs = Date.now()) {
  if (missing(atS)) return NONE;
  const at = new Date(1000 * atS), time = at.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
  const today = new Date(nowMs).toDateString() === at.toDateString();
  return today ? time : `${at.toLocaleDateString("en-GB", { day: "numeric", month: "short" })} ${time}`;
}
export const ago = (seconds) => (missing(seconds) ? NONE : seconds < 1 ? "now" : `${duration(seconds)} ago`);
export const megabytes = (mb) => (missing(mb) ? NONE : mb >= 1e6 ? withUnit(mb / 1e6, "TB") : mb >= 1e3 ? withUnit(mb / 1e3, "GB") : withUnit(mb, "MB"));
