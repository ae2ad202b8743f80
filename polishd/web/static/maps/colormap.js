// Colors of maps and ticks of scales. The tables are samples of matplotlib's, as in the reports: a test compares them.
const TABLES = {
  diverging: "0530610e41791752901f63a82a71b23480b93f8ec0529dc86bacd184bcd99bc9e0aed3e6c2ddecd4e6f1e0ecf3ecf2f5f7f6f6" +
    "f9eee7fbe5d8fddcc9fbccb4f8bb9ef5aa89ee9677e48066db6b55d05548c53e3dba2832ab162a930e267c072267001f",
  cividis: "00224e00285b002e6a0533711a386f273e6e32436d3b496c434e6c4b546c535a6d5a5f6e61656f686a716f70737676767d7c78" +
    "8482798c8878938e789b9476a39a74aba072b4a76fbcae6cc4b468cdbb63d5c25edec958e7d150f0d846f9e03afee838",
  viridis: "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d2f6b8e2c728e297a8e26828e23898e21918c" +
    "1f988b1fa08822a78528ae8032b67a3fbc734ec36b5ec96270cf5784d44b98d83eaddc30c2df23d8e219ece51bfde725",
  gray: "000000080808101010181818202020282828303030383838404040484848505050585858606060686868707070787878808080" +
    "888888909090989898a0a0a0a8a8a8b0b0b0b8b8b8c0c0c0c8c8c8d0d0d0d8d8d8e0e0e0e8e8e8f0f0f0f8f8f8ffffff",
};
const CACHE = new Map();
export const NAMES = Object.keys(TABLES);

// Heights about 0 have the diverging table, values without a sign the sequential one: polishd/rendering/scales.py.
export const tableOf = (signed) => (signed ? "diverging" : "cividis");

// [r, g, b] of 0 to 255 at t of 0 to 1.
export function colorAt(name, t) {
  const table = TABLES[name], last = table.length / 6 - 1;
  const at = Math.min(Math.max(t, 0), 1) * last, k = Math.min(Math.floor(at), last - 1);
  const value = (index, channel) => parseInt(table.slice(6 * index + 2 * channel, 6 * index + 2 * channel + 2), 16);
  return [0, 1, 2].map((c) => value(k, c) * (k + 1 - at) + value(k + 1, c) * (at - k));
}

export const css = (name, t) => `rgb(${colorAt(name, t).map(Math.round).join(" ")})`;

// 1024 colors as bytes r, g, b, r, g, b, ...
export function bytesOf(name) {
  if (!CACHE.has(name)) CACHE.set(name, Uint8ClampedArray.from(Array.from({ length: 1024 }, (_, k) => colorAt(name, k / 1023)).flat()));
  return CACHE.get(name);
}

// About `count` round numbers from low to high, and their number of decimals.
export function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  if (!(raw > 0) || !Number.isFinite(raw)) return { values: [low], digits: 1, step: 1 };
  const power = 10 ** Math.floor(Math.log10(raw)), unit = raw / power;
  const step = power * (unit < 1.5 ? 1 : unit < 3.5 ? 2 : unit < 7.5 ? 5 : 10);
  const values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) values.push(k * step);
  return { values, digits: Math.min(6, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))), step };
}

// A number with a real minus sign, and never -0.
export function figure(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
}
