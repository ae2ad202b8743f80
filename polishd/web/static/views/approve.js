// Approval of a plan: what is approved, beside the last pass, before the button. The dashboard shows this panel while
// a plan waits; #approve is the same. The button works only for the plan whose figures are shown.
import { box, button, card, made, put } from "/dom.js";
import { NONE, duration, figure, percent, withUnit } from "/format.js";
import { hash, maps, problem, styles, tableOf } from "./shop.js";

export { styles };

const AGAIN_MS = 700, TRIES = 6;
const nm = (value) => withUnit(value, "nm");

export function mount(root, ctx) {
  const t = ctx.texts.planApproval;
  let wanted = null, plan = null, ends = [], tries = 0, timer = null, gone = false;
  const body = box("div", "approve-page");
  root.append(body);

  const asked = () => ctx.state()?.live?.approval || "";
  const drop = () => { for (const end of ends) end(); ends = []; clearTimeout(timer); };

  async function read() {
    const program = asked();
    wanted = program;
    if (!program) { drop(); plan = null; body.replaceChildren(made("p", t.none, "empty")); return; }
    const found = await ctx.ask("GET", `/api/plans/${program}`);
    if (gone || wanted !== program) return;
    if (found.status === 200 && found.program_sha256 === program) {
      tries = 0;
      plan = found;
      draw();
      return;
    }
    plan = null;
    // the journal may get the plan's event a moment after the state shows that it waits
    if (found.status === 404 && tries < TRIES) { tries += 1; timer = setTimeout(read, AGAIN_MS); body.replaceChildren(made("p", t.reading, "empty")); return; }
    body.replaceChildren(problem(t.failed, found.error, () => { tries = 0; read(); }, t.tryAgain));
  }

  const ready = () => Boolean(plan?.figures) && plan.program_sha256 === asked() && ctx.link() === "up" && ctx.mayOperate();
  function buttonState() {
    const go = body.querySelector("#approve-run");
    if (!go) return;
    if (go.disabled === ready()) go.disabled = !ready();
    put(body.querySelector("#approve-why"), !ctx.mayOperate() ? t.watchOnly : ctx.link() !== "up" ? t.offline : "");
    put(body.querySelector("#approve-waits"), t.waits(duration(Date.now() / 1000 - plan.at_s)));
  }

  async function approve() {
    const mine = plan;
    if (!ready() || !(await ctx.confirm(...asking(mine), { yes: t.approve }))) return;
    if (mine !== plan || !ready()) return; // another plan waits by now: look at that one first
    const answer = await ctx.order(ctx.texts.approve, "/api/approve", { program_sha256: mine.program_sha256 });
    if (answer.ok && location.hash === "#approve") ctx.go("dashboard");
  }
  const asking = (one) => { const [title, ...lines] = t.ask(one.cycle, duration(one.figures.dwell_s)); return [title, lines]; };

  function draw() {
    drop();
    const job = ctx.jobs().find((one) => one.number === plan.job), go = button(t.approve, "primary big", approve), why = made("p", "", "note"), waits = made("p", "", "note");
    go.id = "approve-run";
    go.disabled = true;
    why.id = "approve-why";
    waits.id = "approve-waits";
    const head = box("div", "approve-head", box("div", "", made("h2", t.title(plan.cycle, job?.part ?? ctx.state()?.live?.part ?? ""), "title"), waits)), foot = box("div", "approve-go", go, why);
    if (!plan.figures) { body.replaceChildren(head, problem(t.noFigures), foot); buttonState(); return; }
    const place = box("div", "");
    body.replaceChildren(head, box("div", "approve-grid",
      card("approve-figures", t.figure, figures(), ...(plan.last ? [] : [made("p", t.noLast, "note")])),
      box("div", "approve-side", warnings(), limits()),
    ), card("approve-maps", t.surface, place), foot); // the button last, as it is read; a wide page shows it at the top, too
    buttonState();
    showMaps(place);
  }
  function figures() {
    const now = plan.figures, last = plan.last?.run, before = last?.plan_figures ?? null, after = plan.last?.after ?? null, first = plan.last?.measured ?? null;
    const span = (pair, show) => (pair ? `${figure(pair[0], 2)} to ${show(pair[1], 2)}` : NONE);
    const nm2 = (value, digits) => withUnit(value, "nm", digits);
    const row = (name, pick, result = "") => [name, [pick(now), "number this"], ...(last ? [[before ? pick(before) : NONE, "number"], [result, "number"]] : [])];
    const rows = [
      row(t.before, (one) => nm(one.before_rms_nm), first ? nm(first.rms_nm) : NONE),
      row(t.predicted, (one) => nm(one.predicted_rms_nm), after ? nm(after.rms_nm) : NONE),
      row(t.expected, (one) => span(one.expected_nm, nm2)),
      row(t.better, (one) => percent(one.better)),
      row(t.pv, (one) => nm(one.predicted_pv_nm), after ? nm(after.pv_nm) : NONE),
      row(t.ripple, (one) => nm(one.ripple_rms_nm)),
      row(t.rippleHigh, (one) => nm(one.ripple_rms_high_nm)),
      row(t.removal, (one) => nm(one.removal_mean_nm)),
      row(t.removalMax, (one) => nm(one.removal_max_nm)),
      row(t.volume, (one) => withUnit(one.removal_mm3, "mm³")),
      row(t.time, (one) => duration(one.dwell_s), last ? duration(last.contact_s) : NONE),
      row(t.force, (one) => withUnit(one.force_n, "N")),
      row(t.speed, (one) => withUnit(one.rpm, "rpm")),
      row(t.points, (one) => Number(one.points).toLocaleString("en").replaceAll(",", "\u202f")),
      [t.program, [box("span", "", now.program ? `${now.program} ` : "", hash(plan.program_sha256)), "number this"], ...(last ? [[hash(last.program_sha256), "number"], ["", "number"]] : [])],
    ];
    const heads = [["", ""], [t.thisPlan, "number this"], ...(last ? [[`${t.lastPass}, ${t.planned}`, "number"], [t.result, "number"]] : [])];
    return tableOf(heads, rows, "figures");
  }
  function warnings() {
    const notes = plan.figures.notes, list = box("ul", "warnings", ...notes.map((one) => made("li", one)));
    return card("approve-warnings", notes.length ? t.warnings(notes.length) : t.noWarnings, notes.length ? list : made("p", t.noWarnings, "note"));
  }
  function limits() {
    const names = t.limitNames, byKey = new Map();
    for (const one of plan.figures.limits) byKey.set(one.key, [...(byKey.get(one.key) ?? []), one]);
    const show = (value, unit) => (unit === "s" ? duration(value) : withUnit(value, unit));
    const rows = [...byKey].map(([key, found]) => {
      const low = found.find((one) => one.least), high = found.find((one) => !one.least);
      const both = low && high, one = high ?? low;
      const text = both ? t.range(figure(low.value), withUnit(high.value, high.unit), figure(low.limit), withUnit(high.limit, high.unit)) : `${show(one.value, one.unit)}, ${one.least ? "≥" : "≤"} ${show(one.limit, one.unit)}`;
      const share = both ? Math.max((high.value - mid(low, high)) / (high.limit - mid(low, high)), (low.value - mid(low, high)) / (low.limit - mid(low, high))) : one.least ? one.limit / one.value : one.value / one.limit;
      const meter = made("meter");
      Object.assign(meter, { min: 0, max: 1, high: 0.9, optimum: 0, value: Math.min(1, Math.max(0, share || 0)) });
      meter.setAttribute("aria-label", `${names[key] ?? key}: ${percent(share)}`);
      return box("div", "limit", made("span", names[key] ?? key), made("span", text, "note"), meter);
    });
    return card("approve-limits", t.limits, ...rows, ...(plan.figures.points_at_least_time ? [made("p", t.slowest(plan.figures.points_at_least_time), "note")] : []));
  }
  async function showMaps(place) {
    const at = `${plan.job}/cycles/${plan.cycle}/map`, mine = plan;
    const surface = [["measured", t.before_map], ...(plan.has_maps ? [["predicted", t.residualMap]] : [])].map(([kind, note]) => ({ path: `${at}/${kind}`, label: note, note }));
    const removal = plan.has_maps ? [{ path: `${at}/removal`, label: t.removalMap, note: t.removalMap }] : [];
    try {
      const found = await Promise.all([surface, removal].filter((one) => one.length).map((one) => maps(ctx, one, { missing: t.mapMissing })));
      if (gone || mine !== plan) { for (const one of found) one.end(); return; }
      ends.push(...found.map((one) => () => one.end()));
      place.replaceChildren(box("div", "map-pair", ...found.map((one) => box("div", "", one.root, ...(one.bar ? [one.bar] : [])))));
    } catch { place.replaceChildren(made("p", t.mapMissing, "empty")); }
  }

  return {
    update() { if (asked() !== wanted) { tries = 0; read(); } else if (plan) buttonState(); },
    refresh: () => { if (asked() !== wanted || !plan) read(); },
    unmount() { gone = true; drop(); },
  };
}

const mid = (low, high) => (low.limit + high.limit) / 2;
