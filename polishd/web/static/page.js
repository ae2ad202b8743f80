// The page of a cell. What comes from elsewhere is put on it as text, never as markup.
import { texts } from "./strings.js";
import * as draw from "./draw.js";

const OLD_S = 2.0, LOST_MS = 1200, KEPT = 240;
const $ = (id) => document.getElementById(id);
const known = { session: null, state: null, heard: 0, job: null, cycles: [], plan: null, map: null, alarms: [], lines: { force: [], speed: [] } };
let stream = null;

const put = (id, text) => { if ($(id).textContent !== String(text)) $(id).textContent = text; };
function made(tag, text, kind) {
  const one = document.createElement(tag);
  if (text !== undefined) one.textContent = text;
  if (kind) one.className = kind;
  return one;
}
for (const one of document.querySelectorAll("[data-text]")) one.textContent = texts[one.dataset.text];
for (const [value, text] of Object.entries(texts.kinds)) { const one = made("option", text); one.value = value; $("kind").append(one); }
for (const one of document.querySelectorAll("canvas")) one.setAttribute("aria-label", texts.charts[one.id.replace("-line", "")] ?? texts.map);
for (const text of texts.columns) { const one = made("th", text); one.scope = "col"; $("passes-head").append(one); }

async function ask(method, path, body) {
  const headers = { "content-type": "application/json" };
  if (known.session) headers["x-csrf-token"] = known.session.csrf;
  const answer = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  if (answer.status === 401 && path !== "/api/session") signedOut();
  return { status: answer.status, ...(await answer.json()) };
}
const got = async (path) => { const found = await ask("GET", path); return found.status === 200 ? found : null; };

// who is there
function signedOut() {
  known.session = null;
  if (stream) stream.close();
  stream = null;
  $("main").hidden = $("sign-out").hidden = $("lost").hidden = true;
  $("sign-in").hidden = false;
  put("who", "");
}
function signedIn(session) {
  known.session = session;
  $("sign-in").hidden = true;
  $("main").hidden = $("sign-out").hidden = false;
  put("who", `${session.name} (${session.role})`);
  watch();
}
$("sign-in").addEventListener("submit", async (event) => {
  event.preventDefault();
  const said = await ask("POST", "/api/session", { token: $("token").value });
  $("token").value = "";
  put("sign-in-said", said.status === 200 ? "" : said.status === 429 ? texts.locked : texts.wrongToken);
  if (said.status === 200) signedIn(said);
});
$("sign-out").addEventListener("click", async () => { await ask("DELETE", "/api/session"); signedOut(); });

// what comes
function watch() {
  if (stream) stream.close();
  stream = new EventSource("/api/events");
  known.heard = performance.now();
  stream.addEventListener("state", (event) => {
    known.heard = performance.now();
    known.state = JSON.parse(event.data);
    keepLines();
    show();
  });
  stream.addEventListener("happened", (event) => {
    const { name } = JSON.parse(event.data);
    if (name !== "pass_progressed") refresh();
  });
  stream.addEventListener("error", () => { known.heard = -Infinity; show(); });
  stream.addEventListener("open", refresh);
}
function link() {
  if (performance.now() - known.heard > LOST_MS) return "page";
  return known.state ? known.state.daemon : "page";
}
setInterval(() => known.session && show(), 250);

function keepLines() {
  const readings = known.state.live?.readings ?? {};
  const fresh = (one) => one && one.age_s < OLD_S;
  const add = (name, value) => { const kept = known.lines[name]; kept.push([Date.now() / 1000, value]); if (kept.length > KEPT) kept.shift(); };
  add("force", fresh(readings.force) ? readings.force.force_n : null);
  add("speed", fresh(readings.speed) ? readings.speed.rpm : null);
}

// what is shown at once
function show() {
  const how = link(), live = known.state?.live, up = how === "up";
  const passed = Math.max(0, (performance.now() - known.heard) / 1000);
  const age = known.state?.age_s === null || known.state?.age_s === undefined ? null : known.state.age_s + (Number.isFinite(passed) ? passed : 0);
  document.body.classList.toggle("stale", !up);
  const lost = { page: texts.lostPage, none: texts.lostDaemon, silent: texts.silentDaemon }[how];
  $("lost").hidden = up;
  if (!up) put("lost", how === "none" && known.state.ending?.reason ? `${lost} (${known.state.ending.reason})` : lost);
  put("state", live ? live.state : "");
  put("age", texts.age(age));
  buttons(how, live);
  if (!live) return;
  const phase = live.state === "polishing" ? live.phase : null;
  put("does", live.approval ? texts.waits : (phase && texts.phase[phase]) || texts.does[live.state] || live.state);
  put("why", live.leaving ? texts.leaving(live.leaving) : live.reason);
  put("next", (phase && texts.soon[phase]) || live.next);
  progress(live);
  table(live, Number.isFinite(passed) ? passed : 1e9);
  draw.line($("force-line"), texts.charts.force, known.lines.force);
  draw.line($("speed-line"), texts.charts.speed, known.lines.speed);
  if (known.map) draw.map($("map"), $("map-said").textContent, known.map, known.plan, up && live.pressing ? live.readings.robot?.executed ?? null : null);
}
function buttons(how, live) {
  const may = known.session && known.session.role !== "watch";
  const set = (id, on) => { if ($(id).disabled === on) $(id).disabled = !on; };
  set("hold", how === "silent" || (how === "up" && live && live.state !== "held" && live.state !== "finished"));
  set("stop", how === "silent" || (how === "up" && live && live.state !== "finished"));
  set("resume", may && how === "up" && live && ["held", "changing"].includes(live.state));
  set("approve", may && how === "up" && Boolean(live?.approval));
  set("acknowledge", may && how === "up");
}
function progress(live) {
  const total = known.plan?.block.at(-1), done = live.readings.robot?.executed;
  const running = live.phase === "run" && total && done !== undefined;
  $("done").hidden = !running;
  if (running) $("done").value = Math.min(1, done / total);
  put("done-said", `${texts.part} ${live.part}, ${texts.job} ${live.job}` + (live.cycle === null ? "" : `, ${texts.cycle} ${live.cycle}`)
    + (running ? `, ${texts.block} ${done} / ${total}` : "") + `; ${live.pressing ? texts.touches : texts.off}`);
}
function table(live, passed) {
  const { readings } = live, rows = [];
  const add = (name, value, age) => rows.push([name, value, age === null || age === undefined ? null : age + passed]);
  const { names } = texts;
  const { force, speed, sensed, robot } = readings;
  add(names.force, force ? `${force.force_n.toFixed(2)} N (${force.setpoint_n.toFixed(1)})` : texts.none, force?.age_s);
  add(names.speed, speed ? `${speed.rpm.toFixed(0)} rpm` : texts.none, speed?.age_s);
  if (sensed) add(names.sensed, `${sensed.force_n.toFixed(2)} N`, sensed.age_s);
  add(names.robot, robot ? `${robot.state}, ${texts.block} ${robot.executed}` : texts.none, robot?.age_s);
  if (robot) add(names.buffer, `${robot.buffer_s.toFixed(1)} s`, robot.age_s);
  for (const [name, age] of Object.entries(live.ages_s ?? {})) add(texts.devices(name), "", age);
  for (const [name, one] of Object.entries(live.signals ?? {})) add(name, one.wrong || one.text, 0);
  for (const [name, one] of Object.entries(live.health ?? {})) {
    const [said, unit] = texts.health[name] ?? [name, ""];
    add(said, `${texts.figure(Number(one.value))} ${unit}${one.fits ? "" : `: ${one.advice}`}`, 0);
  }
  $("live").replaceChildren(...rows.map(([name, value, age]) => {
    const row = made("tr", undefined, age === null || age > OLD_S ? "old" : "");
    const head = made("th", name); head.scope = "row";
    row.append(head, made("td", value), made("td", texts.age(age)));
    return row;
  }));
}

// what is read anew when something has happened
let refreshing = false, again = false;
async function refresh() {
  if (refreshing) { again = true; return; }
  refreshing = true;
  try {
    do { again = false; await readAll(); } while (again);
  } catch { known.heard = Math.min(known.heard, performance.now()); } finally { refreshing = false; }
}
async function readAll() {
  const [state, jobs, alarms, queue, journal] = await Promise.all(["/api/state", "/api/jobs", "/api/alarms", "/api/queue", "/api/journal"].map(got));
  if (state) { put("cell", state.cell); document.title = `${state.cell}: polishd`; }
  if (alarms) showAlarms(alarms.alarms);
  if (queue) list("queue", queue.jobs.map((one) => made("li", `${one.name} (${one.part_id}): ${one.state}${one.reason ? `: ${one.reason}` : ""}`)), texts.noQueue);
  if (journal) list("journal", journal.events.slice(0, 40).map((one) => made("li", said(one))), texts.empty);
  known.job = jobs?.jobs.at(-1)?.number ?? null;
  if (known.job === null) return;
  known.cycles = (await got(`/api/jobs/${known.job}/cycles`))?.cycles ?? [];
  showPasses();
  await readPictures();
}
const said = (one) => `${new Date(one.at_s * 1000).toLocaleTimeString()} ${one.name}: ${["order", "by", "state", "reason", "error", "what"].map((key) => one.data[key]).filter(Boolean).join("; ")}`;
function list(id, items, empty) { $(id).replaceChildren(...(items.length ? items : [made("li", empty)])); }

async function readPictures() {
  const last = known.cycles.at(-1), planned = known.cycles.filter((one) => one.run).at(-1);
  if (!last) return;
  const kind = $("kind").value, cycle = kind === "before" ? known.cycles[0].cycle : kind === "measured" ? last.cycle : planned?.cycle;
  const at = `/api/jobs/${known.job}/cycles`;
  if (planned) {
    known.plan = await got(`${at}/${planned.cycle}/plan`);
    const proof = await got(`${at}/${planned.cycle}/certificate`);
    if (proof) put("plan-said", `${proof.solver ?? ""} ${Number(proof.predicted_rms_nm).toFixed(2)} nm, ${(proof.dwell_total_s / 60).toFixed(1)} min`);
  }
  if (cycle !== undefined) known.map = await got(`${at}/${cycle}/map/${kind === "before" ? "measured" : kind}`);
  if (known.map) put("map-said", `${texts.kinds[kind]}: ${texts.range(known.map.low_nm, known.map.high_nm)}; ${texts.tool}`);
  if (known.plan) for (const [id, key] of [["dwell", "dwell_s"], ["compliance", "compliance_um_per_n"], ["gamma", "gamma"]]) {
    draw.line($(id), texts.charts[id], known.plan[key].map((value, k) => [k, value]));
  }
  const psd = await got(`${at}/${last.cycle}/psd`);
  if (psd) draw.line($("psd"), texts.charts.psd, psd.frequency_per_mm.map((f, k) => [f, psd.power_nm2_mm2[k]]), { log: true });
  show();
}
function showPasses() {
  const figure = (value) => (value === null || value === undefined ? "" : Number(value).toFixed(2));
  $("passes").replaceChildren(...known.cycles.map((one) => {
    const row = made("tr"), { measured, run } = one;
    for (const text of [one.cycle, figure(measured.rms_nm), figure(measured.pv_nm), figure(measured.lsf_rms_nm), figure(run?.predicted_rms_nm), run?.how ?? ""]) row.append(made("td", text));
    return row;
  }));
  const marks = known.cycles.filter((one) => one.run?.predicted_rms_nm).map((one) => [one.cycle + 1, one.run.predicted_rms_nm]);
  draw.line($("convergence"), texts.charts.convergence, known.cycles.map((one) => [one.cycle, one.measured.rms_nm]), { marks, dots: true });
}
function showAlarms(alarms) {
  known.alarms = alarms;
  list("alarms", alarms.map((one) => {
    const item = made("li");
    item.append(made("span", `${one.severity.toUpperCase()}${one.first ? ` (${texts.first})` : ""}: `, one.severity),
      made("span", `${new Date(one.at_s * 1000).toLocaleTimeString()} ${one.name}: ${one.what}`), made("p", one.todo, "note"));
    return item;
  }), texts.noAlarm);
  $("acknowledge").hidden = !alarms.length;
}
$("kind").addEventListener("change", () => readPictures());

// orders
async function order(name, path, body) {
  put("said", `${name}: ${texts.sent}`);
  try {
    const answer = await ask("POST", path, body);
    put("said", `${name}: ${answer.ok === false ? `${texts.refused}: ${answer.error}` : answer.obeyed === false ? texts.notYet : texts.obeyed}`);
  } catch { put("said", `${name}: ${texts.lostPage}`); }
  refresh();
}
for (const id of ["hold", "stop", "resume"]) $(id).addEventListener("click", () => order(texts[id], `/api/orders/${id}`, { reason: $("reason").value }));
$("approve").addEventListener("click", () => order(texts.approve, "/api/approve", { program_sha256: known.state.live.approval }));
$("acknowledge").addEventListener("click", () => order(texts.acknowledge, "/api/alarms/acknowledge", { alarms: known.alarms.map((one) => one.number) }));

ask("GET", "/api/session").then((session) => (session.status === 200 ? signedIn(session) : signedOut()));
