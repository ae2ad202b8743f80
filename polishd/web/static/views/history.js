// Parts over months: a table with filter and order, figures by week, one part in detail, two parts side by side.
import { box, button, card, color, made, put } from "/dom.js";
import { NONE, clock, duration, figure, percent, withUnit } from "/format.js";
import { chart, chip, day, hash, maps, problem, shortDay, styles, tableOf, tile } from "./shop.js";

export { styles };

const PAGE = 50, DAY_S = 86_400, SEARCH_MS = 250;
const nm = (value) => withUnit(value, "nm");

export function mount(root, ctx) {
  const t = ctx.texts.history;
  const filter = { text: "", result: "", days: 91, sort: "", offset: 0 };
  const chosen = new Map(); // job number -> name
  let shownKey = null, ends = [], reads = 0, drawn = "";
  // Draw only what has changed: events come often, and a chart that is made again flickers.
  const same = (found) => { const now = JSON.stringify(found); const was = drawn === now; drawn = now; return was; };

  const drop = () => { for (const end of ends) end(); ends = []; };
  const keep = (one) => { ends.push(() => one.end()); return one; };

  // which of the three the address names
  async function route(again) {
    const args = ctx.args(), job = Number(args.get("job")), pair = (args.get("compare") ?? "").split(",").map(Number).filter(Boolean);
    const key = pair.length === 2 ? `compare ${pair}` : job ? `job ${job}` : "table";
    if (key !== shownKey) { drop(); root.replaceChildren(); shownKey = key; drawn = ""; } else if (!again) return;
    if (pair.length === 2) await compare(pair, key);
    else if (job) await part(job, key);
    else await table(key);
  }

  // the table
  let page = null, controls = null;
  const query = (paged) => {
    const asked = new URLSearchParams();
    if (filter.text) asked.set("text", filter.text);
    if (filter.result) asked.set("result", filter.result);
    if (filter.days) asked.set("since", String(Math.max(0, Math.floor(Date.now() / 1000) - filter.days * DAY_S)));
    if (paged) { asked.set("limit", String(PAGE)); asked.set("offset", String(filter.offset)); if (filter.sort) asked.set("sort", filter.sort); }
    return asked;
  };
  async function table(key) {
    const mine = ++reads;
    if (!controls || !root.contains(controls.root)) { controls = makeControls(); root.replaceChildren(controls.root); }
    const [found, weeks] = await Promise.all([ctx.ask("GET", `/api/history?${query(true)}`), ctx.got(`/api/history/weeks?${query(false)}`)]);
    if (mine !== reads || shownKey !== key) return;
    if (found.status !== 200) { controls.table.replaceChildren(problem(t.notLoaded, found.error)); return; }
    if (same([filter, found, weeks])) return;
    page = found;
    drawTable();
    if (weeks) drawWeeks(weeks.weeks);
  }
  function makeControls() {
    const search = made("input"), result = made("select"), periods = box("div", "choice");
    Object.assign(search, { type: "search", id: "history-search", placeholder: t.search, value: filter.text, maxLength: 200, autocomplete: "off" });
    search.setAttribute("aria-label", t.search);
    let waits = null;
    search.addEventListener("input", () => { clearTimeout(waits); waits = setTimeout(() => change({ text: search.value.trim() }), SEARCH_MS); });
    result.setAttribute("aria-label", t.result);
    result.id = "history-result";
    for (const [value, text] of [["", t.all], ...Object.entries(t.results)]) { const one = made("option", text); one.value = value; result.append(one); }
    result.value = filter.result;
    result.addEventListener("change", () => change({ result: result.value }));
    const draw = () => periods.replaceChildren(...Object.entries(t.periods).sort(([a], [b]) => (Number(a) || 1e9) - (Number(b) || 1e9)).map(([days, text]) => {
      const one = button(text, "", () => { change({ days: Number(days) }); draw(); });
      one.setAttribute("aria-pressed", String(filter.days === Number(days)));
      return one;
    }));
    draw();
    periods.setAttribute("role", "group");
    periods.setAttribute("aria-label", t.period);
    const weeks = box("div", "weeks"), rows = box("div", ""), below = box("div", "pager"), picked = box("div", "picked");
    weeks.tabIndex = 0; // on a phone it scrolls sideways
    weeks.setAttribute("role", "region");
    weeks.setAttribute("aria-label", t.weeks);
    const bar = box("div", "filters", search, result, periods);
    return { root: box("div", "history-page", bar, weeks, card("history-parts", t.title, picked, rows, below)), weeks, table: rows, below, picked };
  }
  function change(values) {
    Object.assign(filter, { offset: 0 }, values);
    table(shownKey);
  }
  function drawTable() {
    const head = box("tr", ""), body = document.createElement("tbody"), compareHead = made("th", undefined);
    compareHead.append(made("span", t.compareTwo, "unseen"));
    compareHead.scope = "col";
    head.append(compareHead);
    for (const [key, text] of Object.entries(t.columns)) {
      const active = filter.sort.replace("-", "") === key || (!filter.sort && key === "date"), down = filter.sort ? filter.sort.startsWith("-") : true;
      const cell = made("th", undefined, NUMBERS.has(key) ? "number" : ""), sorter = button(text, "sorter", () => change({ sort: active && down ? key : `-${key}` }));
      sorter.title = t.sortBy(text);
      sorter.dataset.sort = key;
      if (active) { cell.setAttribute("aria-sort", down ? "descending" : "ascending"); sorter.append(made("span", down ? "↓" : "↑", "arrow")); }
      cell.scope = "col";
      cell.append(sorter);
      head.append(cell);
    }
    for (const one of page.parts) body.append(rowOf(one));
    const focused = document.activeElement?.dataset?.sort;
    controls.table.replaceChildren(page.matched ? box("div", "scroll", box("table", "parts", box("thead", "", head), body)) : made("p", page.total ? t.count(0, 0, 0, page.total) : t.empty, "empty"));
    if (focused) controls.table.querySelector(`[data-sort="${focused}"]`)?.focus({ preventScroll: true });
    const back = button(t.newer, "", () => turn(-PAGE)), on = button(t.older, "", () => turn(PAGE));
    back.disabled = page.offset === 0;
    on.disabled = page.offset + page.parts.length >= page.matched;
    controls.below.replaceChildren(made("span", page.matched ? t.count(page.offset + 1, page.offset + page.parts.length, page.matched, page.total) : "", "note"), ...(page.matched > PAGE ? [back, on] : []));
    drawPicked();
  }
  function turn(by) {
    filter.offset = Math.max(0, filter.offset + by);
    table(shownKey).then(() => controls.root.querySelector("#history-parts").scrollIntoView({ block: "start" }));
  }
  function rowOf(one) {
    const row = box("tr", ""), tick = made("input"), link = made("a", one.part), name = box("th", "", link, made("span", one.job, "note"));
    Object.assign(tick, { type: "checkbox", checked: chosen.has(one.number) });
    tick.setAttribute("aria-label", t.choose(one.part));
    tick.addEventListener("change", () => {
      if (tick.checked) chosen.set(one.number, one.part); else chosen.delete(one.number);
      while (chosen.size > 2) chosen.delete(chosen.keys().next().value);
      drawTable();
      controls.table.querySelector(`[data-number="${one.number}"] input`)?.focus();
    });
    link.href = `#history?job=${one.number}`;
    name.scope = "row";
    row.dataset.number = one.number;
    row.append(box("td", "tick", tick), name, made("td", day(one.began_s)), box("td", "", chip(one.result, t.results[one.result])), made("td", one.interrupted ? `${one.passes} + ${one.interrupted}` : one.passes, "number"),
      made("td", nm(one.first_rms_nm), "number"), made("td", nm(one.last_rms_nm), "number"), made("td", one.hours === null ? NONE : duration(3600 * one.hours), "number"), metOf(one));
    row.addEventListener("click", (event) => { if (!event.target.closest("a, input, .tick")) ctx.go(link.href.split("#")[1]); });
    return row;
  }
  function metOf(one) {
    const cell = made("td", one.met === null ? t.metUnknown : one.met ? t.met : t.notMet, one.met === false && one.ended_s !== null ? "miss" : "");
    if (one.worst) cell.title = `${one.worst.what}: ${figure(one.worst.value)} ${one.worst.unit}, ${figure(one.worst.limit)} ${one.worst.unit} allowed`;
    return cell;
  }
  function drawPicked() {
    const numbers = [...chosen.keys()];
    controls.picked.hidden = !numbers.length;
    const go = button(t.compareTwo, "primary", () => ctx.go(`history?compare=${numbers.join(",")}`));
    go.id = "history-compare";
    go.disabled = numbers.length !== 2;
    const summary = made("span", `${[...chosen.values()].join(", ")}. ${numbers.length === 1 ? t.chosen(1) : ""}`);
    summary.setAttribute("role", "status");
    controls.picked.replaceChildren(summary, go, button(t.clear, "", () => { chosen.clear(); drawTable(); }));
  }

  // figures by week
  function drawWeeks(weeks) {
    drop();
    if (!weeks.length) { controls.weeks.replaceChildren(); return; }
    const x = weeks.map((one) => one.at_s), plain = color("--s1"), soft = color("--line"), band = color("--band");
    const middle = (key, by = 1) => [0, 1, 2].map((n) => weeks.map((one) => (one[key] ? by * one[key][n] : null)));
    const cards = [["parts", (one) => t.partsOf(one.parts, one.accepted), [
      { label: t.charts.parts, values: weeks.map((one) => one.parts), kind: "bars", fill: soft },
      { label: t.results.accepted, values: weeks.map((one) => one.accepted), kind: "bars", fill: plain },
    ], [], {}]];
    for (const [key, by, asText, more] of [
      ["hours", 1, (value) => duration(3600 * value), {}],
      ["gain", 100, (value) => `${Math.round(value)}\u00a0%`, { range: (_, low, high) => [Math.min(0, low), Math.max(100, high)] }],
      ["over_predicted", 1, (value) => figure(value, 3), { level: { value: 1, text: "" }, range: (_, low, high) => [Math.min(0.5, low), Math.max(1.5, high) * 1.05] }],
    ]) {
      const [low, median, high] = middle(key, by);
      cards.push([key === "over_predicted" ? "over" : key, (one) => (one[key] ? t.quartiles(...[1, 0, 2].map((n) => asText(by * one[key][n]))) : NONE), [
        { label: "", values: low, kind: "hidden" }, { label: "", values: high, kind: "hidden" }, { label: t.charts[key], values: median, kind: "line", stroke: plain },
      ], [{ series: [2, 1], fill: band }], more]);
    }
    controls.weeks.replaceChildren(...cards.map(([key, describe, series, bands, more]) => {
      const readout = made("p", "", "readout"), last = weeks.at(-1);
      const show = (n) => { const one = weeks[n ?? weeks.length - 1] ?? last; put(readout, `${t.week(shortDay(one.at_s))}: ${describe(one)}`); };
      show();
      const one = keep(chart({ label: `${t.charts[key]}, ${t.notes[key]}. ${t.week(day(last.at_s))}: ${describe(last)}`, height: 128, x, series, bands, hover: show, ...more }));
      return card(`weeks-${key}`, t.charts[key], made("p", t.notes[key], "note"), one.root, readout);
    }));
  }

  // one part
  async function load(number) {
    const found = await ctx.ask("GET", `/api/jobs/${number}`);
    return found.status === 200 ? [found, ""] : [null, found.error];
  }
  const backLink = () => { const one = made("a", `← ${t.back}`, "back"); one.href = "#history"; return one; };
  async function part(number, key) {
    const mine = ++reads, [one, why] = await load(number);
    if (mine !== reads || shownKey !== key || same(one ?? why)) return;
    drop();
    if (!one) { root.replaceChildren(backLink(), problem(t.noPart, why)); return; }
    const head = box("div", "part-head", made("h2", one.part), chip(one.result, t.results[one.result]), made("span", `${t.job} ${one.job}`, "note"));
    const worst = one.worst;
    const tiles = box("div", "tiles",
      tile(t.firstRms, nm(one.first_rms_nm)), tile(t.lastRms, nm(one.last_rms_nm), worst ? `${worst.what}: ${figure(worst.value)} of ${figure(worst.limit)} ${worst.unit}` : ""),
      tile(t.passes, one.passes, one.interrupted ? t.interrupted(one.interrupted) : ""), tile(t.took, one.hours === null ? NONE : duration(3600 * one.hours), `${t.contact}: ${duration(one.contact_s)}`),
      tile(t.began, clock(one.began_s), one.ended_s ? `${t.ended} ${clock(one.ended_s)}` : ""), tile(t.faults, one.faults));
    const converge = one.cycles.length ? keep(convergence([one], 250)) : null;
    const places = { maps: box("div", ""), bar: box("div", "") };
    root.replaceChildren(box("div", "part-page", backLink(), head, ...(one.reason && one.result !== "accepted" ? [made("p", one.reason, "job-why attend")] : []), tiles,
      box("div", "part-grid", card("part-convergence", t.convergence, converge ? converge.root : made("p", t.noPasses, "empty")), card("part-maps", t.mapsTitle, places.maps, places.bar)),
      card("part-passes", t.passTable, passTable(one)), box("div", "part-grid", linesCard(one), filesCard(one)), picturesCard(one)));
    await showMaps(places, one.cycles.map((cycle) => wantedMap(one, cycle)), key);
  }
  const wantedMap = (one, cycle, name = "") => {
    const cycleText = t.mapOf(cycle.cycle, nm(cycle.measured.rms_nm));
    return { path: `${one.number}/cycles/${cycle.cycle}/map/measured`, label: `${name || one.part}, ${cycleText}`, note: name ? `${name}, ${cycleText}` : cycleText };
  };
  async function showMaps(places, wanted, key) {
    if (!wanted.length) { places.maps.replaceChildren(made("p", t.mapMissing, "empty")); return; }
    try {
      const found = await maps(ctx, wanted, { missing: t.mapMissing });
      if (shownKey !== key) { found.end(); return; }
      keep(found);
      places.maps.replaceChildren(found.root);
      const draw = (one) => {
        found.draw(one);
        const choice = box("div", "choice", ...[[true, t.oneScale], [false, t.ownScales]].map(([value, text]) => {
          const each = button(text, "small", () => { draw(value); choice.parentElement?.querySelector("[aria-pressed=true]")?.focus(); });
          each.setAttribute("aria-pressed", String(value === one));
          return each;
        }));
        places.bar.replaceChildren(box("div", "bar-line", ...(one && found.bar ? [found.bar] : [made("span")]), ...(wanted.length > 1 ? [choice] : [])));
      };
      if (found.bar) draw(true);
    } catch { places.maps.replaceChildren(made("p", t.mapMissing, "empty")); }
  }
  function convergence(parts, height) {
    const most = Math.max(...parts.map((one) => one.cycles.at(-1)?.cycle ?? 0)), x = Array.from({ length: most + 1 }, (_, n) => n);
    const of = (one, pick) => x.map((n) => { const cycle = one.cycles.find((each) => each.cycle === n); return (cycle && pick(cycle)) ?? null; });
    const series = [], bands = [], inks = [color("--s1"), color("--s2")];
    parts.forEach((one, k) => {
      const before = x.map((n) => one.cycles.find((each) => each.cycle === n - 1)?.run ?? null);
      if (parts.length === 1) {
        series.push({ label: "", values: before.map((run) => run?.forecast?.low_nm ?? null), kind: "hidden" }, { label: "", values: before.map((run) => run?.forecast?.high_nm ?? null), kind: "hidden" });
        bands.push({ series: [2, 1], fill: color("--band") });
      }
      series.push({ label: one.part, values: of(one, (cycle) => cycle.measured.rms_nm), kind: "dots", stroke: inks[k] }, { label: t.predicted, values: before.map((run) => run?.predicted_rms_nm ?? null), kind: "points", stroke: parts.length === 1 ? color("--s2") : inks[k] });
    });
    const limits = parts[0].cycles.at(-1)?.measured.judged?.filter((line) => line.what === "RMS") ?? [];
    const level = limits.length ? { value: limits[0].limit, text: `${t.limit} ${figure(limits[0].limit)} nm` } : undefined;
    const listed = parts.map((one) => `${one.part}: ${one.cycles.map((cycle) => nm(cycle.measured.rms_nm)).join(", ")}`).join(". ");
    const range = (_, low, high) => [Math.min(low, level?.value ?? low) / 1.5, high * 1.3];
    const made_ = chart({ label: `${t.convergence}. ${listed}`, height, x, series, bands, time: false, log: true, level, xText: t.measurement, yText: t.rms, range });
    const key = box("p", "key note", ...(parts.length === 1 ? [mark("line", inks[0]), t.measured, mark("ring", color("--s2")), t.predicted, mark("area", color("--band")), t.expected] : parts.flatMap((one, k) => [mark("line", inks[k]), one.part]).concat([mark("ring", color("--muted")), t.predicted])));
    return { root: box("div", "", made_.root, key), end: () => made_.end() };
  }
  function passTable(one) {
    if (!one.cycles.some((cycle) => cycle.run)) return made("p", t.noPasses, "empty");
    const after = new Map(one.cycles.map((cycle) => [cycle.cycle, cycle.measured.rms_nm]));
    return tableOf(t.passColumns.map((text, n) => [text, n && n < 9 ? "number" : ""]), one.cycles.filter((cycle) => cycle.run).map(({ cycle, measured, run }) => {
      const reached = after.get(cycle + 1), figures = run.plan_figures, allowed = one.approvals.filter((each) => each.program_sha256 === run.program_sha256).at(-1);
      return [`${cycle + 1}${run.tool ? `, ${run.tool}` : ""}${run.program ? `, ${run.program.name}` : ""}${run.how === "done" ? "" : ` (${run.how})`}`, [nm(measured.rms_nm), "number"], [nm(run.predicted_rms_nm), "number"],
        [run.forecast ? `${figure(run.forecast.low_nm, 2)} to ${figure(run.forecast.high_nm, 2)}\u00a0nm` : NONE, "number"], [nm(reached), "number"],
        [reached && run.predicted_rms_nm ? figure(reached / run.predicted_rms_nm) : NONE, "number"], [nm(figures?.removal_mean_nm), "number"], [nm(figures?.ripple_rms_nm), "number"], [duration(run.contact_s ?? run.dwell_s), "number"],
        hash(run.program_sha256), allowed ? `${allowed.by}, ${clock(allowed.at_s)}` : NONE];
    }));
  }
  function linesCard(one) {
    const judged = one.cycles.at(-1)?.measured.judged ?? [];
    const rows = judged.map((line) => [line.what, [withUnit(line.bound ?? line.value, line.unit), "number"], [withUnit(line.limit, line.unit), "number"], [line.holds ? t.within : t.beyond, line.holds ? "" : "miss"]]);
    return card("part-lines", t.lines, rows.length ? tableOf([t.line, [t.value, "number"], [t.limit, "number"], t.holds], rows) : made("p", t.metUnknown, "note"));
  }
  function filesCard(one) {
    const files = one.files, body = [];
    const download = (name, text) => { const link = made("a", text, "download"); link.href = `/api/jobs/${one.number}/files/${encodeURIComponent(name)}`; link.download = name; return link; };
    if (files && !files.present) body.push(made("p", t.noFolder(files.folder), "note"));
    for (const each of files?.certificates ?? []) {
      body.push(box("div", "certificate", box("div", "", made("strong", t.certificate(each.number)), made("p", each.verdict), made("p", `${day(Date.parse(each.issued) / 1000)}, ${each.signed ? t.signed(each.signed.slice(0, 16)) : t.notSigned}`, "note")), box("div", "buttons", download(each.pdf, t.pdf), download(each.json, t.json))));
    }
    if (!files?.certificates.length) body.push(made("p", t.noCertificate.replace("JOB", one.job), "note"));
    if (files?.report) body.push(box("div", "buttons", download(files.report, t.report)));
    return card("part-files", t.files, ...body);
  }
  function picturesCard(one) {
    const names = one.files?.pictures ?? [];
    if (!names.length) return "";
    return card("part-pictures", t.pictures, box("div", "pictures", ...names.map((name) => {
      const link = made("a"), image = made("img"), text = name.replace(/\.png$/, "").replaceAll(/[-_]/g, " ");
      link.href = image.src = `/api/jobs/${one.number}/files/${encodeURIComponent(name)}`;
      link.target = "_blank";
      Object.assign(image, { alt: text, loading: "lazy" });
      link.append(image, made("span", text, "note"));
      return link;
    })));
  }

  // two parts
  async function compare(numbers, key) {
    const mine = ++reads, found = await Promise.all(numbers.map(load));
    if (mine !== reads || shownKey !== key) return;
    drop();
    const wrong = found.filter(([one]) => !one);
    if (wrong.length) { root.replaceChildren(backLink(), ...wrong.map(([, why]) => problem(t.noPart, why))); return; }
    const [a, b] = found.map(([one]) => one), sum = (one) => one.hours === null ? null : 3600 * one.hours;
    const ratio = (one) => (one.first_rms_nm ? one.last_rms_nm / one.first_rms_nm : null);
    const row = (name, pick, show) => {
      const [left, right] = [pick(a), pick(b)], known = left !== null && right !== null && Number.isFinite(right - left);
      return [name, [show(left), "number"], [show(right), "number"], [known ? `${right > left ? "+" : right < left ? "−" : ""}${show(Math.abs(right - left))}` : NONE, "number"]];
    };
    const count = (value) => String(value ?? NONE);
    const plan = (pick) => (one) => one.cycles.find((cycle) => cycle.run)?.run.plan_figures?.[pick] ?? null;
    const names = box("div", "part-head", ...[a, b].flatMap((one, k) => {
      const link = made("a", one.part, `name-${k}`);
      link.href = `#history?job=${one.number}`;
      return [link, chip(one.result, t.results[one.result]), made("span", day(one.began_s), "note")];
    }), button(t.swap, "", () => ctx.go(`history?compare=${numbers[1]},${numbers[0]}`)));
    const figures = tableOf([t.figure, [a.part, "number"], [b.part, "number"], [t.difference, "number"]], [
      row(t.firstRms, (one) => one.first_rms_nm, nm), row(t.lastRms, (one) => one.last_rms_nm, nm), row(t.ratio, ratio, percent), row(t.gain, (one) => one.gain, percent),
      row(t.passes, (one) => one.passes, count), row(t.took, sum, duration), row(t.contact, (one) => one.contact_s, duration), row(t.faults, (one) => one.faults, count),
      row(`${ctx.texts.planApproval.removal} (1)`, plan("removal_mean_nm"), nm), row(`${ctx.texts.planApproval.ripple} (1)`, plan("ripple_rms_nm"), nm),
    ], "figures");
    const converge = a.cycles.length && b.cycles.length ? keep(convergence([a, b], 300)) : null;
    const groups = [[t.firstMap, 0], [t.lastMap, -1]].map(([text, at]) => ({ text, maps: box("div", ""), bar: box("div", ""), wanted: [a, b].filter((one) => one.cycles.length).map((one) => wantedMap(one, one.cycles.at(at), one.part)) }));
    root.replaceChildren(box("div", "part-page", backLink(), names, box("div", "part-grid", card("compare-figures", t.comparing, figures), card("compare-convergence", t.convergence, converge ? converge.root : made("p", t.noPasses, "empty"))), box("div", "part-grid", ...groups.map((one, n) => card(`compare-maps-${n}`, one.text, one.maps, one.bar)))));
    for (const one of groups) await showMaps(one, one.wanted, key);
  }

  return {
    refresh() { route(shownKey === "table" || shownKey === `job ${ctx.job()}`); },
    unmount: drop,
  };
}

const NUMBERS = new Set(["passes", "first", "last", "hours"]);
function mark(kind, ink) {
  const one = made("i", undefined, `mark-${kind}`);
  one.style.setProperty("--ink", ink);
  return one;
}
