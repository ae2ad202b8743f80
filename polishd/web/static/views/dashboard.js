// The dashboard: how the cell stands, what comes next, what needs a person, and the pictures of the pass.
import { chart } from "/charts.js";
import { box, button, card, made, put } from "/dom.js";
import { clock, duration, figure, fixed, NONE, percent } from "/format.js";
import { drawHeightMap } from "/maps/height_map.js";
import { guideOf, guidePanel } from "./guide.js";

export const styles = ["/views/dashboard.css"];
const OLD_S = 2.0, WINDOW_S = 600, READ_MS = 5000, MOST_EVENTS = 40, MOST_SAMPLES = 1300;

export function mount(root, ctx) {
  const t = ctx.texts.dashboard;
  let overview = null, readMs = -Infinity, overviewMs = 0, reading = false, gone = false, map = null, psd = null, plan = null, shownGuide = "", shownAlarms = "";
  const samples = [[], [], [], []]; // Unix time, force, set point, speed

  // how it stands
  const does = made("p"), why = made("p"), next = made("p", "", "note"), done = made("progress"), doneText = made("p"), facts = box("dl", "of");
  Object.assign(does, { id: "does" }); Object.assign(why, { id: "why" }); Object.assign(next, { id: "next" }); Object.assign(doneText, { id: "done-text" });
  Object.assign(done, { id: "done", max: 1, value: 0, hidden: true });
  done.setAttribute("aria-label", t.progressOf);
  const tiles = Object.fromEntries(["left", "force", "speed", "rms"].map((key) => [key, tile(t.tiles[key], key)]));
  const resume = button(ctx.texts.resume, "primary", () => ctx.resume()), approve = button(t.lookAtPlan, "primary", () => ctx.go("approve"));
  resume.id = "resume"; approve.id = "approve";
  const actions = box("div", "now-actions", resume, approve);
  const guideAt = box("div", "");
  guideAt.style.display = "contents";
  const now = card("now", t.now, guideAt, box("div", "now-words", does, why, next, facts, done, doneText), box("dl", "tiles", ...Object.values(tiles).map((one) => one.root)), actions);

  // beside
  const alarms = box("ol", "scroll"), journal = box("ol", "scroll"), latest = box("dl", "latest");
  alarms.id = "alarms"; journal.id = "journal"; alarms.tabIndex = journal.tabIndex = 0;
  alarms.setAttribute("aria-labelledby", "alarms-card-h"); journal.setAttribute("aria-labelledby", "journal-card-h");
  const acknowledge = button(ctx.texts.acknowledge, "", () => ctx.order(ctx.texts.acknowledge, "/api/alarms/acknowledge", { alarms: ctx.alarms().map((one) => one.number) }));
  acknowledge.id = "acknowledge"; acknowledge.hidden = true;
  const aside = box("div", "aside", card("alarms-card", t.alarms, alarms, acknowledge), card("journal-card", t.journal, latest, journal));

  // pictures
  const canvas = made("canvas"), kind = made("select"), mapSummary = made("p"), mapHead = made("h2", t.map), openMap = box("a", "", canvas);
  canvas.id = "map"; kind.id = "kind"; mapSummary.id = "map-summary"; openMap.id = "map-open"; openMap.href = "#maps"; mapHead.id = "map-card-h";
  openMap.setAttribute("aria-label", t.openMaps);
  canvas.setAttribute("role", "img");
  kind.setAttribute("aria-label", t.kind);
  for (const [value, text] of Object.entries(t.kinds)) { const one = made("option", text); one.value = value; kind.append(one); }
  kind.addEventListener("change", () => readMap());
  const mapCard = box("section", "card", box("div", "map-head", mapHead, kind), openMap, mapSummary);
  mapCard.id = "map-card";
  mapCard.setAttribute("aria-labelledby", mapHead.id);
  const resized = new ResizeObserver(() => drawMap());
  resized.observe(openMap);

  const around = (band) => (low, high, { lines }) => {
    const values = [low, high, ...lines.map((one) => one.y)].filter(Number.isFinite), a = Math.min(...values), b = Math.max(...values);
    const margin = Math.max((b - a) * 0.12, Math.abs(b) * band, 1e-6);
    return [Math.min(a - margin, a), b + margin];
  };
  const window = () => { const end = Date.now() / 1000; return [end - WINDOW_S, end]; };
  const at = (value) => new Date(1000 * value).toLocaleTimeString("en-GB");
  const charts = {
    convergence: chart("convergence", {
      title: t.charts.convergence, empty: t.noMeasurement, x: { label: t.axes.measurement, whole: true, range: (low, high) => [low - 0.35, Math.max(high, low + 1) + 0.35] }, y: { label: t.axes.rms, log: true },
      bands: [{ series: [3, 4] }],
      series: [{ label: t.measured, unit: "nm", color: "--s1", points: true, width: 2.25 }, { label: t.predicted, unit: "nm", color: "--s2", points: true, ring: true, only: true },
        { label: t.high, unit: "nm", color: "--s1", width: 0, quiet: true }, { label: t.low, unit: "nm", color: "--s1", width: 0, quiet: true }],
      at: (value) => (value === 0 ? t.beforePolishing : t.afterPass(value)),
      summary: (data) => data[1].map((value, k) => (value === null ? "" : `${data[0][k]}: ${figure(value)} nm`)).filter(Boolean).join(", "),
    }),
    psd: chart("psd", {
      title: t.charts.psd, empty: t.noMeasurement, x: { label: t.axes.frequency, log: true, range: (low, high) => [low, high] }, y: { label: t.axes.psd, log: true },
      series: [{ label: t.first, color: "--s4", width: 1.25, unit: "nm² mm²" }, { label: t.last, color: "--s1", width: 2, unit: "nm² mm²" }, { label: t.limit, color: "--warn", dash: [6, 4], unit: "nm² mm²" }],
      at: (value) => t.period(figure(1 / value)),
    }),
    force: chart("force-chart", {
      title: t.charts.force, empty: t.noForce, x: { label: t.axes.time, time: true, range: window }, y: { label: "N", range: around(0.02) },
      series: [{ label: t.tiles.force, unit: "N", color: "--s1", digits: 4 }], at, summary: (data) => `${figure(data[1].findLast((one) => one !== null), 3)} N`,
    }),
    speed: chart("speed-chart", {
      title: t.charts.speed, empty: t.noSpeed, x: { label: t.axes.time, time: true, range: window }, y: { label: "rpm", range: around(0.01) },
      series: [{ label: t.tiles.speed, unit: "rpm", color: "--s1", digits: 4 }], at, summary: (data) => `${figure(data[1].findLast((one) => one !== null), 3)} rpm`,
    }),
    progress: chart("progress-chart", {
      title: t.charts.progress, empty: t.noPass, x: { label: t.axes.minutes, range: (low, high) => [0, Math.max(high, 0.1) * 1.02] }, y: { label: t.axes.blocks, range: (low, high) => [0, Math.max(high, 1) * 1.05] },
      series: [{ label: t.planned, color: "--s4", dash: [6, 4], span: true, digits: 4 }, { label: t.executed, color: "--s1", width: 2.5, span: true, digits: 4 }],
      at: (value) => `${value.toFixed(1)} min`, summary: () => doneText.textContent,
    }),
  };
  root.append(now, aside, mapCard, ...Object.values(charts).map((one) => one.root));

  function tile(name, id) {
    const value = box("span", "value"), under = made("span", "", "under"), one = box("div", "tile", made("dt", name), box("dd", "", value), box("dd", "", under));
    one.id = `tile-${id}`;
    return {
      root: one,
      set(text, unit, note, kind_ = "") {
        const key = `${text}|${unit}`;
        if (value.dataset.key !== key) { value.dataset.key = key; value.replaceChildren(text, ...(unit ? [made("small", unit)] : [])); }
        put(under, note);
        one.className = `tile ${kind_}`;
      },
    };
  }

  // what is read
  async function read() {
    if (reading) return;
    reading = true;
    readMs = performance.now();
    try {
      const found = await ctx.got("/api/overview");
      if (found && !gone) { overview = found; overviewMs = performance.now(); showLimits(); }
    } finally { reading = false; }
  }
  async function readSamples() {
    const found = await ctx.got("/api/readings");
    if (!found || gone) return;
    const from = Date.now() / 1000 - WINDOW_S;
    const rows = found.rows.filter((row) => row[0] > from && (samples[0].length === 0 || row[0] < samples[0][0]));
    samples.forEach((column, k) => column.unshift(...rows.map((row) => row[k])));
  }
  async function readMap() {
    const job = ctx.job(), cycles = ctx.cycles(), last = cycles.at(-1), planned = cycles.filter((one) => one.run).at(-1);
    if (job === null || !last) { map = null; drawMap(); return; }
    const wanted = kind.value, cycle = wanted === "before" ? cycles[0].cycle : wanted === "measured" ? last.cycle : planned?.cycle;
    if (cycle === undefined) { map = null; put(mapSummary, t.noPlan); drawMap(); return; }
    map = await ctx.got(`/api/jobs/${job}/cycles/${cycle}/map/${wanted === "before" ? "measured" : wanted}?px=256&encoding=float32`);
    plan = planned ? await ctx.got(`/api/jobs/${job}/cycles/${planned.cycle}/plan`) : null;
    if (gone) return;
    const rms = wanted === "before" ? cycles[0].measured.rms_nm : wanted === "measured" ? last.measured.rms_nm : wanted === "predicted" ? planned?.run.predicted_rms_nm : null;
    put(mapSummary, map ? [rms ? `RMS ${figure(rms)} nm` : "", t.range(figure(map.low), figure(map.high))].filter(Boolean).join(", ") : t.noMap);
    drawMap();
  }
  async function readPsd() {
    const job = ctx.job(), cycles = ctx.cycles();
    if (job === null || !cycles.length) { psd = null; return; }
    const of = (cycle) => ctx.got(`/api/jobs/${job}/cycles/${cycle}/psd`);
    const last = await of(cycles.at(-1).cycle), first = cycles.length > 1 ? await of(cycles[0].cycle) : null;
    psd = last ? { first, last } : null;
    if (!gone) showPsd();
  }

  // pictures
  function drawMap() {
    if (gone || !canvas.clientWidth) return;
    if (!map) { canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height); return; }
    const live = ctx.state()?.live, block = live?.pressing ? live.readings.robot?.executed : null;
    let tool;
    if (plan && block !== null && block !== undefined) {
      const k = plan.block.findIndex((one) => one >= block);
      if (k >= 0) tool = [plan.x_mm[k], plan.y_mm[k]];
    }
    drawHeightMap(canvas, map, { tool, path: plan && ["predicted", "removal"].includes(kind.value) ? plan : undefined, label: `${t.kinds[kind.value]}: ${mapSummary.textContent}` });
  }
  function showPsd() {
    if (!psd) { charts.psd.set(null); return; }
    const keep = psd.last.frequency_per_mm.map((f, k) => [f, k]).filter(([f, k]) => f > 0 && psd.last.power_nm2_mm2[k] > 0);
    const x = keep.map(([f]) => f), lines = (overview?.tolerance ?? []).filter((one) => one.figure === "psd");
    const first = psd.first && psd.first.frequency_per_mm.length === psd.last.frequency_per_mm.length ? keep.map(([, k]) => (psd.first.power_nm2_mm2[k] > 0 ? psd.first.power_nm2_mm2[k] : null)) : x.map(() => null);
    const limit = x.map((f) => {
      const one = lines.find((each) => 1 / f >= each.above_mm && (each.below_mm === null || 1 / f <= each.below_mm));
      return one ? one.limit / f ** one.exponent : null;
    });
    const ripple = ctx.cycles().filter((one) => one.run).at(-1)?.run.forecast?.ripple?.lines ?? [];
    const shown = [...ripple].sort((a, b) => b.rms_nm - a.rms_nm).slice(0, 3).sort((a, b) => b.period_mm - a.period_mm);
    const marks = shown.map((one) => ({ x: 1 / one.period_mm, text: t.ripple(figure(one.period_mm, 2)), color: "--s3" })).filter((one) => one.x >= x[0] && one.x <= x.at(-1));
    for (const one of lines) for (const edge of [one.below_mm, one.above_mm]) if (edge) marks.push({ x: 1 / edge, text: "", color: "--warn" });
    charts.psd.set([x, first, keep.map(([, k]) => psd.last.power_nm2_mm2[k]), limit], { marks });
  }
  function showConvergence() {
    const cycles = ctx.cycles();
    if (!cycles.length) { charts.convergence.set(null); return; }
    const count = Math.max(...cycles.map((one) => one.cycle + (one.run ? 1 : 0))) + 1, x = [...Array(count).keys()];
    const by = (of) => x.map((k) => of(k) ?? null), at_ = (k) => cycles.find((one) => one.cycle === k), before = (k) => cycles.find((one) => one.cycle === k - 1)?.run;
    const expected = (k, key) => before(k)?.forecast?.[key] ?? (before(k + 1)?.forecast ? at_(k)?.measured.rms_nm : null);
    const tolerance = (overview?.tolerance ?? []).filter((one) => one.figure === "rms").map((one) => ({ y: one.limit, text: t.toleranceOf(figure(one.limit)), color: "--warn", dash: [6, 4] }));
    charts.convergence.set([x, by((k) => at_(k)?.measured.rms_nm), by((k) => before(k)?.predicted_rms_nm), by((k) => expected(k, "high_nm")), by((k) => expected(k, "low_nm"))], { lines: tolerance });
  }
  function showLive() {
    const limits = overview?.limits, set = limits?.force_n, contact = samples[2].some((one) => one > 0);
    const band = limits && contact ? [{ y: set, text: t.setPoint, color: "--s4" }, { y: set * (1 + limits.force_band), text: t.limitOf(percent(limits.force_band)), color: "--warn", dash: [6, 4], below: true }, { y: set * (1 - limits.force_band), text: `−${percent(limits.force_band)}`, color: "--warn", dash: [6, 4] }] : [];
    charts.force.set([samples[0], samples[1]], { lines: band });
    const rpm = limits?.rpm, turns = samples[3].some((one) => one > rpm / 2);
    const speeds = limits && turns ? [{ y: rpm, text: t.setPoint, color: "--s4" }, { y: rpm * (1 + limits.speed_band), text: t.limitOf(percent(limits.speed_band)), color: "--warn", dash: [6, 4], below: true }, { y: rpm * (1 - limits.speed_band), text: `−${percent(limits.speed_band)}`, color: "--warn", dash: [6, 4] }] : [];
    charts.speed.set([samples[0], samples[3]], { lines: speeds });
  }
  function showProgress() {
    const pass = overview?.pass;
    if (!pass || !pass.planned.length) { charts.progress.set(null); return; }
    const x = [...new Set([0, ...pass.planned.map((one) => one[0]), ...pass.executed.map((one) => one[0])])].sort((a, b) => a - b);
    const planned = new Map(pass.planned), executed = new Map(pass.executed);
    charts.progress.set([x.map((s) => s / 60), x.map((s) => planned.get(s) ?? null), x.map((s) => executed.get(s) ?? null)], {});
  }
  function showLimits() { showConvergence(); showPsd(); showProgress(); showLive(); showNow(); }

  // how it stands, in words and figures
  function showNow() {
    const state = ctx.state(), live = state?.live, key = guideOf(ctx), up = ctx.link() === "up";
    const guideKey = JSON.stringify([key, live?.reason, state?.ending?.reason, live?.unsafe]);
    now.classList.toggle("guided", Boolean(key));
    for (const one of aside.children) one.classList.toggle("current", ctx.link() !== "page"); // the page's server reads them from the disk
    if (guideKey !== shownGuide) { shownGuide = guideKey; guideAt.replaceChildren(...(key ? [guidePanel(ctx, key)] : [])); }
    const may = ctx.mayOperate() && up;
    resume.hidden = !(may && ["held", "changing"].includes(live?.state));
    approve.hidden = !(may && live?.approval);
    resume.disabled = resume.hidden; approve.disabled = approve.hidden;
    acknowledge.disabled = !may;
    if (!live) return;
    const phase = live.state === "polishing" ? live.phase : null, pass = phase === "run" ? overview?.pass : null;
    put(does, live.approval ? t.waits : (phase && t.phase[phase]) || t.does[live.state] || live.state);
    put(why, live.leaving ? t.leaving(live.leaving) : live.reason);
    why.className = live.leaving ? "alarm" : "";
    put(next, phase && t.soon[phase] ? t.soon[phase] : "");
    showFacts(live);
    showDone(live, pass);
    showTiles(live, phase, pass);
  }
  function showFacts(live) {
    const pairs = [[t.part, live.part], [t.job, live.job], [t.pass, live.cycle === null || live.cycle === undefined ? null : overview?.passes ? t.passOf(live.cycle + 1, overview.passes) : String(live.cycle + 1)], [t.tool, live.pressing ? t.on : t.off]];
    const text = JSON.stringify(pairs);
    if (facts.dataset.key === text) return;
    facts.dataset.key = text;
    facts.replaceChildren(...pairs.flatMap(([name, value]) => [made("dt", name), made("dd", value ?? NONE)]));
  }
  function showDone(live, pass) {
    const block = live.readings?.robot?.executed, total = pass?.blocks;
    done.hidden = !(total && block !== undefined && block !== null);
    if (done.hidden) { put(doneText, ""); return; }
    done.value = Math.min(1, block / total);
    const late = pass.behind_s, lag = late === null || late === undefined || Math.abs(late) < 1 ? "" : late > 0 ? t.behind(duration(late)) : t.ahead(duration(-late));
    put(doneText, [t.blockOf(Math.min(block, total), total, percent(done.value)), lag].filter(Boolean).join(", "));
  }
  function showTiles(live, phase, pass) {
    const { force, speed } = live.readings ?? {}, limits = overview?.limits;
    const left = (phase === "run" ? pass : overview?.phase?.phase === phase ? overview?.phase : null)?.left;
    const passedS = overview ? Math.max(0, (performance.now() - overviewMs) / 1000) : 0; // the clocks may differ
    if (live.approval || live.state === "held" || live.state === "changing") tiles.left.set(t.waiting, "", t.forYou);
    else if (left) {
      const s = Math.max(0, left.s - passedS), [value, unit] = split(duration(s));
      tiles.left.set(value, unit, `${t.plusMinus(duration(left.error_s))}, ${t.until(clock(Date.now() / 1000 + s))}\n${t.basis(left.basis, left.earlier ?? overview.phase?.earlier)}`);
    } else tiles.left.set(NONE, "", phase ? t.timeUnknown : "");
    const age = (one) => one && one.age_s < OLD_S;
    if (force && age(force)) {
      const out = limits && live.pressing && force.setpoint_n > 0 && Math.abs(force.force_n - force.setpoint_n) > limits.force_band * force.setpoint_n;
      tiles.force.set(fixed(force.force_n, 2), "N", force.setpoint_n > 0 ? out ? t.outside(percent(limits.force_band)) : t.setTo(`${figure(force.setpoint_n)} N`) : t.noContact, out ? "attend" : "");
    } else tiles.force.set(force ? fixed(force.force_n, 2) : NONE, force ? "N" : "", force ? t.oldBy(duration(force.age_s)) : t.notRead, "old");
    if (speed && age(speed)) tiles.speed.set(fixed(speed.rpm, 0), "rpm", limits ? t.setTo(`${figure(limits.rpm)} rpm`) : "");
    else tiles.speed.set(speed ? fixed(speed.rpm, 0) : NONE, speed ? "rpm" : "", speed ? t.oldBy(duration(speed.age_s)) : t.notRead, "old");
    const last = ctx.cycles().at(-1), run = last?.run, rms = overview?.tolerance?.find((one) => one.figure === "rms" && !one.above_mm && one.below_mm === null);
    tiles.rms.set(last ? figure(last.measured.rms_nm) : NONE, last ? "nm" : "", [run?.predicted_rms_nm ? t.then(figure(run.predicted_rms_nm)) : "", rms ? t.allowed(figure(rms.limit)) : ""].filter(Boolean).join("\n"));
  }
  const split = (text) => { const [value, ...rest] = text.split("\u00a0"); return rest.length === 1 ? [value, rest[0]] : [text, ""]; };

  // what happened
  function showAlarms() {
    const found = ctx.alarms(), key = JSON.stringify(found.map((one) => one.number));
    acknowledge.hidden = !found.length;
    if (key === shownAlarms) return;
    shownAlarms = key;
    alarms.replaceChildren(...(found.length ? found.map((one) => box("li", `sev-${one.severity}`,
      made("p", `${t.severity[one.severity]}${one.first && found.length > 1 ? ` ${t.cameFirst}` : ""}, ${clock(one.at_s)}`, "head"),
      made("p", ctx.alarmText(one)), made("p", `${t.toDo}: ${one.todo}`, "todo note"))) : [made("li", t.noAlarm, "none")]));
  }
  function showJournal() {
    const events = ctx.journal(), order = ctx.lastOrder(), notice = events.find((one) => t.notices[one.name]?.(one.data));
    const who = overview?.notifiers?.length ? t.sentBy(overview.notifiers.map((one) => one.name).join(", ")) : overview ? t.noNotifier : "";
    latest.replaceChildren(made("dt", t.lastNotice), made("dd", notice ? `${clock(notice.at_s)} ${t.notices[notice.name](notice.data)}${who ? ` (${who})` : ""}` : `${t.none}${who ? ` (${who})` : ""}`),
      made("dt", t.lastOrder), made("dd", order ? `${clock(order.at_s)} ${t.ordered(ctx.texts.orders[order.data.order] ?? order.data.order, order.data.by || ctx.texts.byUnknown)}${order.data.reason ? `: ${order.data.reason}` : ""}` : t.none));
    journal.replaceChildren(...events.slice(0, MOST_EVENTS).map((one) => {
      const at_ = made("time", clock(one.at_s)), text = t.events[one.name]?.(one.data, ctx.texts) ?? one.name.replaceAll("_", " ");
      at_.dateTime = new Date(1000 * one.at_s).toISOString();
      return box("li", "", at_, made("span", text));
    }));
  }

  readSamples();
  return {
    update(state) {
      const readings = state.live?.readings ?? {}, fresh = (one, key) => (one && one.age_s < OLD_S ? one[key] : null);
      samples[0].push(Date.now() / 1000); samples[1].push(fresh(readings.force, "force_n")); samples[2].push(fresh(readings.force, "setpoint_n")); samples[3].push(fresh(readings.speed, "rpm"));
      while (samples[0].length > MOST_SAMPLES || (samples[0].length && samples[0][0] < Date.now() / 1000 - WINDOW_S)) for (const one of samples) one.shift();
      if (performance.now() - readMs > READ_MS) read();
      showNow();
      showLive();
      drawMap();
    },
    refresh() { read(); showNow(); showAlarms(); showJournal(); showConvergence(); readMap(); readPsd(); },
    tick: showNow,
    unmount() { gone = true; resized.disconnect(); for (const one of Object.values(charts)) one.destroy(); },
  };
}
