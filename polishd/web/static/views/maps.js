// Maps of a job: the 2-D map with its profiles, or the 3-D surface, of one measurement and the pass after it.
import { figure, tableOf } from "../maps/colormap.js";
import { Camera } from "../maps/camera.js";
import { box, button, made } from "../dom.js";
import { canvas, choice, facts, select, sign, toggle } from "../maps/elements.js";
import { columnOf, decodeMap, drawHeightMap, profileOf, rowOf, valueAt, wholeView, xOf, yOf } from "../maps/height_map.js";
import { drawProfile } from "../maps/profile.js";
import { Surface } from "../maps/surface.js";
import { oncePerFrame, onChange } from "../maps/theme.js";

const LATEST = "latest", CLOSEST = 40, DRAG = 4, QUIET_MS = 700;
const DIGITS = { height_nm: 2, dwell_s: 4, gamma: 4 };

export const styles = ["/maps/maps.css"];

// What was chosen, also after another tab was shown.
const choices = { kind: "measured", cycle: null, chosen: false, look: "flat", colors: "auto", ends: "auto", outside: "dim", path: false, smooth: true, outline: true, view: null, cursor: [0, 0], relief: 1 };

// What a link to this view chooses: #maps?kind=residual&cycle=2&look=solid
function asked(args, texts) {
  const found = {}, cycle = Number.parseInt(args?.get("cycle"), 10);
  if (args?.get("kind") in texts.kinds) found.kind = args.get("kind");
  if (["flat", "solid"].includes(args?.get("look"))) found.look = args.get("look");
  if (cycle >= 0) Object.assign(found, { cycle, chosen: true });
  return found;
}

export function mount(root, ctx) {
  const texts = ctx.texts.maps;
  const now = Object.assign(choices, asked(ctx.args?.(), texts));
  const known = { map: null, path: null, first: null, why: "", asked: 0 };
  let drawn = null, surface = null, ended = false;

  // elements
  const view = box("div", "m-view"), main = box("div", "m-main"), side = box("div", "m-side"), head = box("div", "m-head"), readout = box("output", "m-read");
  const message = box("p", "m-message"), note = box("p", "m-note"), spoken = box("p", "unseen");
  const map = canvas("", "m-map"), flat = canvas("", "m-flat"), upright = canvas("", "m-upright"), corner = box("div", "m-corner"), stage = box("div", "m-stage");
  const mesh = canvas("", ""), labels = canvas("", "");
  message.setAttribute("role", "status");
  readout.setAttribute("aria-live", "off"); // it changes with each move; `spoken` follows once it rests
  spoken.setAttribute("aria-live", "polite");
  map.tabIndex = labels.tabIndex = 0;
  for (const one of [map, labels]) one.setAttribute("role", "application");
  mesh.setAttribute("aria-hidden", "true");
  mesh.addEventListener("webglcontextlost", (event) => event.preventDefault()); // then it may be restored
  mesh.addEventListener("webglcontextrestored", () => { surface = null; known.meshed = null; show(); });
  stage.append(mesh, labels);
  corner.append(sign("+", texts.zoomIn, () => zoom(1.5)), sign("\u2212", texts.zoomOut, () => zoom(1 / 1.5)), button(texts.whole, "m-button", whole));
  const kinds = choice(texts.show, texts.kinds, now.kind, (kind) => { now.kind = kind; load(); });
  const looks = choice(texts.look, { flat: texts.flat, solid: texts.solid }, now.look, (look) => { now.look = look; arrange(); });
  const cycles = select(texts.pass, {}, "", (cycle) => { Object.assign(now, { cycle: Number(cycle), chosen: cycle !== LATEST }); load(); });
  const redraw = (key) => (value) => { now[key] = value; if (key === "ends" && value === "first") load(); else show(); };
  const card = box("section", "m-card"), options = box("section", "m-card"), numbers = facts(texts.figures);
  const relief = box("label", "m-field"), slider = made("input"), times = made("span");
  Object.assign(slider, { type: "range", min: "0.1", max: "3", step: "0.05", value: "1" });
  relief.append(times, slider);
  slider.addEventListener("input", () => { now.relief = Number(slider.value); show(); });
  const flatOnly = [select(texts.outside, texts.hide, now.outside, redraw("outside")), toggle(texts.outline, now.outline, redraw("outline")),
    toggle(texts.path, now.path, async (on) => { now.path = on; await loadPath(); show(); }), toggle(texts.smooth, now.smooth, redraw("smooth"))];
  card.append(cycles, relief);
  options.append(select(texts.colors, texts.tables, now.colors, redraw("colors")), select(texts.ends, texts.scales, now.ends, redraw("ends")), ...flatOnly);
  head.append(kinds, looks, readout);
  main.append(head, message, map, upright, flat, corner, stage, note);
  side.append(card, numbers, options, spoken);
  view.append(main, side);
  root.replaceChildren(view);
  const camera = new Camera(labels, { yaw: -0.6, pitch: 0.62, radius: 1.4, scale: 0.5, onMove: oncePerFrame(() => show()) });

  // data
  const at = (cycle) => `/api/jobs/${ctx.job()}/cycles/${cycle}`;
  async function load() {
    const turn = ++known.asked, list = ctx.cycles() ?? [];
    if (!list.length) { known.map = null; known.why = texts.noJob; arrange(); return; }
    if (!now.chosen || !list.some((one) => one.cycle === now.cycle)) Object.assign(now, { cycle: latest(list).cycle, chosen: false });
    const named = (one) => `${one.cycle ? texts.after(one.cycle) : texts.first}, ${figure(one.measured.rms_nm, 2)} nm`;
    const shown = list.find((one) => one.cycle === now.cycle);
    cycles.fill({ ...Object.fromEntries(list.map((one) => [one.cycle, named(one)])), [LATEST]: `${texts.latest}: ${named(shown)}` }, now.chosen ? now.cycle : LATEST);
    const key = JSON.stringify([ctx.job(), now.cycle, now.kind, now.ends === "first", list.filter((one) => one.cycle === now.cycle || one.cycle === now.cycle + 1).map((one) => [one.taken_s, one.run?.began_s])]);
    if (known.map && known.key === key) return;
    const found = await ctx.ask("GET", `${at(now.cycle)}/map/${now.kind}?encoding=float32`);
    if (now.ends === "first" && known.first?.job !== ctx.job()) known.first = { job: ctx.job(), scale: (await ctx.got(`${at(list[0].cycle)}/map/measured?px=8`))?.scale };
    if (ended || turn !== known.asked || !found.status) return;
    const other = known.map && (known.map.nx !== found.nx || known.map.pitch_mm !== found.pitch_mm);
    known.key = key;
    known.map = found.status === 200 ? decodeMap(found) : null;
    delete view.dataset.ready;
    known.why = found.status === 200 ? "" : `${texts.none}: ${found.error}. ${now.kind === "measured" ? "" : texts.oldPlan}`;
    if (other) now.view = null;
    arrange();
    if (now.path) { await loadPath(); if (!ended) show(); }
  }
  // The last measurement that has a map of this kind: a plan, and for the residual a measurement after its pass.
  function latest(list) {
    const waits = Boolean(ctx.state()?.live?.approval), last = list.length - 1;
    const has = (one, k) => now.kind === "measured" || (one.run && (now.kind !== "residual" || k < last)) || (waits && k === last && now.kind !== "residual");
    return list.filter(has).at(-1) ?? list[last];
  }
  async function loadPath() {
    const key = `${ctx.job()} ${now.cycle}`;
    if (now.path && known.path?.key !== key) known.path = { key, plan: await ctx.got(`${at(now.cycle)}/plan?points=20000`) };
  }

  // drawing
  const scale = () => {
    const { low, high, signed } = known.map, far = Math.max(Math.abs(low), Math.abs(high)) || 1;
    if (now.ends === "full") return signed ? [-far, far] : [low, high > low ? high : low + 1e-9];
    return now.ends === "first" && signed && known.first?.scale ? known.first.scale : known.map.scale;
  };
  const colors = () => (now.colors === "auto" ? tableOf(known.map.signed) : now.colors);
  const digits = () => DIGITS[known.map.key] ?? 2;
  const unit = () => (known.map.unit ? ` ${known.map.unit}` : "");
  const toolNow = () => {
    const live = ctx.state()?.live, plan = known.path?.plan, block = live?.readings?.robot?.executed;
    if (!now.path || !plan || !live?.pressing || live.cycle !== now.cycle || block === undefined) return null;
    const k = plan.block.findIndex((one) => one >= block);
    return k < 0 ? null : [plan.x_mm[k], plan.y_mm[k]];
  };

  function arrange() {
    const is = known.map ? now.look : "none", solid = is === "solid";
    for (const one of [map, flat, upright, corner]) one.hidden = is !== "flat";
    stage.hidden = !solid;
    relief.hidden = !solid;
    readout.hidden = solid;
    for (const one of flatOnly) one.hidden = solid;
    numbers.hidden = note.hidden = is === "none";
    message.hidden = Boolean(known.map);
    message.textContent = known.why;
    note.textContent = `${texts.about[now.kind]} ${solid ? texts.solidKeys : texts.keys}`;
    map.setAttribute("aria-label", texts.canvas(texts.kinds[now.kind], known.map?.unit));
    labels.setAttribute("aria-label", texts.solidCanvas(texts.kinds[now.kind]));
    known.meshed = null;
    show();
  }

  function show() {
    if (ended || !known.map) return;
    if (now.look === "solid") showSolid(); else showFlat();
    view.dataset.ready = `${now.kind} ${now.look}`; // for tests and screenshots
    const m = known.map, row = (ctx.cycles() ?? []).find((one) => one.cycle === now.cycle), measured = now.kind === "measured" && row?.measured;
    const value = (v) => `${figure(v, digits())}${unit()}`;
    numbers.show([
      [texts.names.pv, value(measured ? measured.pv_nm : m.high - m.low)], [texts.names.rms, value(measured ? measured.rms_nm : m.rms)],
      [texts.names.low, value(m.low)], [texts.names.high, value(m.high)], ...(m.signed ? [] : [[texts.names.mean, value(m.mean)]]),
      [texts.names.size, `${m.nx} × ${m.ny}`], [texts.names.pitch, `${figure(m.pitch_mm, 2)} mm`],
      ...(now.look === "flat" && drawn ? [[texts.names.zoom, `${figure(wholeView(m, drawn.plot).mmPerPx / drawn.view.mmPerPx, 1)} ×`]] : []),
    ]);
  }

  function showFlat() {
    const how = { colors: colors(), scale: scale(), outside: now.outside, smooth: now.smooth, outline: now.outline, view: now.view, cursor: now.cursor,
      path: now.path ? known.path?.plan : null, tool: toolNow() };
    drawn = drawHeightMap(map, known.map, how);
    const { plot, toMm } = drawn, [x, y] = now.cursor, [left, top] = toMm(plot.x, plot.y), [right, bottom] = toMm(plot.x + plot.w, plot.y + plot.h);
    const narrow = getComputedStyle(upright).gridColumnStart === "1", common = { unit: known.map.unit };
    const lines = [profileOf(known.map, "x", y), profileOf(known.map, "y", x)];
    const heights = lines.flat().filter((p) => p[1] !== null && (p[2] || now.outside === "show")).map((p) => p[1]);
    const range = heights.length ? [Math.min(...heights), Math.max(...heights)] : scale();
    drawProfile(flat, lines[0], { ...common, range, from: left, to: right, start: plot.x, size: plot.w, at: x, axis: "x", own: narrow });
    drawProfile(upright, lines[1], narrow ? { ...common, range, from: bottom, to: top, start: plot.x, size: plot.w, at: y, axis: "y", own: true }
      : { ...common, range, from: bottom, to: top, start: plot.y, size: plot.h, at: y, upright: true });
    flat.setAttribute("aria-label", texts.profile("x", "y", figure(y, 2)));
    upright.setAttribute("aria-label", texts.profile("y", "x", figure(x, 2)));
    read();
  }

  let speaks = 0;
  function read() {
    const [x, y] = now.cursor, z = valueAt(known.map, x, y), j = Math.round(columnOf(known.map, x)), i = Math.round(rowOf(known.map, y));
    const inner = known.map.aperture[i * known.map.nx + j] === 1, text = z === null ? texts.noData : `${figure(z, digits())}${unit()}`;
    readout.textContent = `x ${figure(x, 2)}   y ${figure(y, 2)} mm   z ${text}${z === null || inner ? "" : ` (${texts.beyond})`}`;
    clearTimeout(speaks);
    speaks = setTimeout(() => { if (document.activeElement === map) spoken.textContent = readout.textContent; }, QUIET_MS);
  }

  function showSolid() {
    try {
      surface ??= new Surface(mesh, labels, camera);
      const key = [now.colors, now.ends].join();
      if (known.meshed !== key) { surface.set(known.map, { colors: colors(), scale: scale() }); known.meshed = key; }
      camera.radius = stage.clientWidth < 520 ? 1.75 : 1.4;
      surface.draw(now.relief);
    } catch (error) {
      stage.hidden = relief.hidden = note.hidden = true;
      message.hidden = false;
      message.textContent = texts.noWebgl;
      console.warn(error);
      return;
    }
    const nm = known.map.unit === "nm", factor = nm ? Number(surface.exaggeration(now.relief).toPrecision(2)).toLocaleString("en") : figure(now.relief, 2);
    times.textContent = `${texts.height}: ${nm ? texts.times(factor) : texts.relief(factor)}`;
    slider.setAttribute("aria-valuetext", times.textContent);
  }

  // cursor, zoom and pan of the 2-D map
  const pointers = new Map();
  let begun = null;
  const local = (event) => { const box = map.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  const clamped = ([x, y]) => {
    const m = known.map, [left, right] = [xOf(m, 0), xOf(m, m.nx - 1)], [top, bottom] = [yOf(m, 0), yOf(m, m.ny - 1)];
    return [Math.min(Math.max(x, left), right), Math.min(Math.max(y, bottom), top)];
  };
  const point = (event) => { now.cursor = clamped(drawn.toMm(...local(event))); show(); };

  function zoom(factor, about = now.cursor) {
    if (!drawn || !known.map) return;
    const { view: was, plot } = drawn, fit = wholeView(known.map, plot).mmPerPx;
    const mmPerPx = Math.min(Math.max(was.mmPerPx / factor, fit / CLOSEST), fit), by = mmPerPx / was.mmPerPx;
    now.view = mmPerPx >= fit * 0.999 ? null : { x: about[0] + (was.x - about[0]) * by, y: about[1] + (was.y - about[1]) * by, mmPerPx };
    show();
  }
  function whole() { now.view = null; show(); }
  map.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.002), drawn.toMm(...local(event))); }, { passive: false });
  map.addEventListener("pointerdown", (event) => {
    if (!drawn) return;
    map.focus({ preventScroll: true });
    map.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, local(event));
    begun = { at: local(event), view: drawn.view, moved: false };
    if (event.pointerType === "touch" && pointers.size === 1) point(event);
  });
  map.addEventListener("pointermove", (event) => {
    if (!drawn) return;
    const before = pointers.get(event.pointerId), here = local(event);
    if (!before) { if (event.pointerType === "mouse" && !now.pinned) point(event); return; }
    pointers.set(event.pointerId, here);
    if (pointers.size === 2) {
      const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
      const spread = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      zoom(spread(here) / spread(before), drawn.toMm((here[0] + other[0]) / 2, (here[1] + other[1]) / 2));
      return;
    }
    if (event.pointerType === "touch") { point(event); return; }
    const [dx, dy] = [here[0] - begun.at[0], here[1] - begun.at[1]];
    begun.moved ||= Math.hypot(dx, dy) > DRAG;
    if (begun.moved && now.view) {
      map.classList.add("dragging");
      now.view = { ...begun.view, x: begun.view.x - dx * begun.view.mmPerPx, y: begun.view.y + dy * begun.view.mmPerPx };
      show();
    }
  });
  for (const name of ["pointerup", "pointercancel"]) map.addEventListener(name, (event) => {
    pointers.delete(event.pointerId);
    map.classList.remove("dragging");
    if (name === "pointerup" && event.pointerType === "mouse" && begun && !begun.moved) { now.pinned = false; point(event); now.pinned = true; }
  });
  map.addEventListener("pointerleave", () => { now.pinned = pointers.size > 0 || now.pinned; });
  map.addEventListener("pointerenter", () => { now.pinned = false; });
  map.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!drawn || event.ctrlKey || event.metaKey || event.altKey) return;
    if (way) {
      const step = known.map.pitch_mm * (event.shiftKey ? 10 : 1);
      now.cursor = clamped([now.cursor[0] + way[0] * step, now.cursor[1] + way[1] * step]);
      follow();
      show();
    } else if (event.key === "+" || event.key === "=") zoom(1.25);
    else if (event.key === "-") zoom(1 / 1.25);
    else if (event.key === "0") whole();
    else if (event.key === "Home") { now.cursor = clamped([0, 0]); follow(); show(); } else return;
    event.preventDefault();
  });
  // A cursor that leaves a zoomed plot takes the view along.
  function follow() {
    if (!now.view) return;
    const { plot, view: was } = drawn, half = [(plot.w / 2) * was.mmPerPx, (plot.h / 2) * was.mmPerPx];
    const shift = (at, middle, room) => middle + Math.max(at - middle - room, 0) + Math.min(at - middle + room, 0);
    now.view = { ...was, x: shift(now.cursor[0], was.x, half[0]), y: shift(now.cursor[1], was.y, half[1]) };
  }

  arrange(); // what has no content yet has no label either
  const end = onChange([map, flat, upright, stage], show);
  return {
    update() { if (now.look === "flat" && now.path) show(); },
    refresh: load,
    unmount() { ended = true; end(); clearTimeout(speaks); surface?.end(); root.replaceChildren(); },
  };
}
