// The shell of the page: who is signed in, the stream of states, orders, alarms, and the view that the address names.
//
// A view is a module views/NAME.js that exports `mount(root, ctx)`, and optionally `styles`: paths of its style sheets.
// `mount` returns { update(state)?, refresh()?, tick()?, unmount()? }: `update` at each state (twice a second), `refresh`
// when something has happened, `tick` four times a second, also without a connection; all only while it is shown. `ctx` is described at its definition below.
import { $, box, button, icon, made, put } from "./dom.js";
import { clock } from "./format.js";
import { sound } from "./sound.js";
import { texts } from "./strings.js";

const VIEWS = ["dashboard", "maps", "cell", "queue", "history", "host"], PANELS = ["approve"]; // panels have no tab
const LOST_MS = 1200, MESSAGE_MS = 15_000;
const known = { session: null, state: null, stateMs: 0, cell: "", jobs: [], cycles: [], alarms: [], journal: [], lastAlarm: null };
let stream = null;

for (const one of document.querySelectorAll("[data-text]")) one.textContent = texts[one.dataset.text];

// The answer with its status; status 0 and an error where the server is not reached, or the page is being left.
async function ask(method, path, body) {
  const headers = { "content-type": "application/json" };
  if (known.session) headers["x-csrf-token"] = known.session.csrf;
  try {
    const answer = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
    if (answer.status === 401 && path !== "/api/session") signedOut();
    return { status: answer.status, ...(await answer.json()) };
  } catch { return { status: 0, ok: false, error: texts.lostPage }; }
}
const got = async (path) => { const found = await ask("GET", path); return found.status === 200 ? found : null; };

// what a view may use
const ctx = {
  ask, // (method, path, body) -> its answer with `status`, which is 0 where the server is not reached
  got, // (path) -> the answer, or null
  session: () => known.session, // { name, role, csrf }
  state: () => known.state, // the last state: { daemon, age_s, live, ending? }
  link, // "up", "silent", "none" or "page" (no connection to the page's server)
  cell: () => known.cell, // name of the cell
  job: () => known.jobs.at(-1)?.number ?? null, // number of the last job
  jobs: () => known.jobs, // rows of /api/jobs
  cycles: () => known.cycles, // rows of /api/jobs/JOB/cycles of the last job
  alarms: () => known.alarms, // rows of /api/alarms
  journal: () => known.journal, // the last events, newest first
  lastOrder, // () -> the last order's event, or null
  alarmText, // (row of /api/alarms) -> what it is, in words
  mayOperate, // () -> whether the role may resume, approve, acknowledge and change the queue
  order, // (name, path, body) -> the answer; shows what became of it
  resume, // () asks, then resumes
  confirm: async (title, lines, options) => (await confirmed(title, lines, options)) !== null,
  confirmWithReason: (title, lines, options) => confirmed(title, lines, { ...options, reason: true }), // -> text, or null
  texts,
  go: (hash) => { location.hash = hash; },
  args: () => new URLSearchParams(location.hash.split("?")[1] ?? ""), // of #NAME?key=value
};

// who is there
function signedOut() {
  $("loading").hidden = true;
  known.session = null;
  stream?.close();
  stream = null;
  leave();
  sound.silence();
  for (const id of ["main", "top", "tabs", "bar"]) $(id).hidden = true;
  $("sign-in").hidden = false;
}
function signedIn(session) {
  known.session = session;
  $("loading").hidden = $("sign-in").hidden = true;
  for (const id of ["main", "top", "tabs"]) $(id).hidden = false;
  put("who", `${session.name} (${session.role})`);
  watch();
  show();
  route();
}
$("sign-in").addEventListener("submit", async (event) => {
  event.preventDefault();
  sound.unlock();
  const answer = await ask("POST", "/api/session", { token: $("token").value });
  $("token").value = "";
  put("sign-in-message", answer.status === 200 ? "" : answer.status === 0 ? answer.error : answer.status === 429 ? texts.locked : texts.wrongToken);
  if (answer.status === 200) signedIn(answer);
});
$("sign-out").addEventListener("click", async () => { $("settings").hidePopover(); const answer = await ask("DELETE", "/api/session"); if (answer.status) signedOut(); else say(answer.error); });

// the view
let view = null, viewName = "", entering = 0;
function leave() {
  entering += 1;
  view?.unmount?.();
  view = null;
  viewName = "";
  $("view").replaceChildren();
}
async function route(again = false) {
  if (!known.session) return;
  const name = location.hash.slice(1).split("?")[0] || "dashboard";
  if (![...VIEWS, ...PANELS].includes(name)) { location.replace("#dashboard"); return; }
  if (name === viewName && !again) { view?.refresh?.(); return; }
  const moved = viewName !== "";
  leave();
  viewName = name;
  for (const one of $("tabs").children) {
    if (one.hash === `#${name}`) one.setAttribute("aria-current", "page"); else one.removeAttribute("aria-current");
  }
  const mine = entering, root = made("div", undefined, `view-${name}`);
  let module;
  try {
    module = await import(`/views/${name}.js`);
    await Promise.all((module.styles ?? []).map(styled));
  } catch (error) {
    console.error(error);
    module = { mount: (at) => { at.append(made("p", texts.noView, "empty")); return {}; } };
  }
  if (mine !== entering) return;
  $("view").replaceChildren(root);
  view = module.mount(root, ctx) ?? {};
  if (known.state) view.update?.(known.state);
  view.refresh?.();
  if (moved) { scrollTo(0, 0); if (!again) $("view").focus({ preventScroll: true }); }
}
function styled(href) {
  if (document.querySelector(`link[href="${href}"]`)) return null;
  return new Promise((done, failed) => {
    const link = document.createElement("link");
    Object.assign(link, { rel: "stylesheet", href, onload: done, onerror: failed });
    document.head.append(link);
  });
}
for (const name of VIEWS) {
  const tab = box("a", "", icon(name), made("span", texts.tabs[name]));
  tab.href = `#${name}`;
  $("tabs").append(tab);
}
$("tabs").setAttribute("aria-label", "polishd");
document.querySelector(".skip").addEventListener("click", (event) => { event.preventDefault(); $("view").focus(); });
addEventListener("hashchange", () => route());
addEventListener("polishd-theme", () => route(true)); // canvases take their colors anew

// what comes
function watch() {
  stream?.close();
  stream = new EventSource("/api/events");
  known.stateMs = performance.now();
  stream.addEventListener("state", (event) => {
    known.stateMs = performance.now();
    known.state = JSON.parse(event.data);
    show();
    view?.update?.(known.state);
  });
  stream.addEventListener("happened", (event) => {
    if (JSON.parse(event.data).name !== "pass_progressed") refresh();
  });
  stream.addEventListener("error", () => {
    known.stateMs = -Infinity;
    show();
    got("/api/state"); // signs out where the session has ended
  });
  stream.addEventListener("open", refresh);
}
// A page that is left, or kept by the browser for "back", must hold no connection: there are six for all of its pages.
addEventListener("pagehide", () => stream?.close());
addEventListener("pageshow", (event) => { if (event.persisted && known.session) watch(); });
function link() {
  if (performance.now() - known.stateMs > LOST_MS) return "page";
  return known.state ? known.state.daemon : "page";
}
function mayOperate() { return Boolean(known.session) && known.session.role !== "watch"; }
setInterval(() => known.session && show(), 250);

// what is read again when something has happened
let refreshing = false, again = false;
async function refresh() {
  if (refreshing) { again = true; return; }
  refreshing = true;
  try {
    do { again = false; await readAll(); } while (again);
  } finally { refreshing = false; }
}
async function readAll() {
  const [state, jobs, alarms, journal] = await Promise.all(["/api/state", "/api/jobs", "/api/alarms", "/api/journal"].map(got));
  if (!(state || jobs || alarms || journal)) return; // lost: the shell shows that
  if (state) { known.cell = state.cell; put("cell", state.cell); }
  if (jobs) known.jobs = jobs.jobs;
  if (journal) known.journal = journal.events;
  if (alarms) { known.alarms = alarms.alarms; soundNew(); }
  const job = ctx.job();
  if (job !== null) known.cycles = (await got(`/api/jobs/${job}/cycles`))?.cycles ?? known.cycles;
  show();
  view?.refresh?.();
}
function lastOrder() { return known.journal.find((one) => one.name === "command_received") ?? null; }

// what is shown on every view
function show() {
  const how = link(), live = known.state?.live, up = how === "up";
  const passedS = Math.max(0, (performance.now() - known.stateMs) / 1000);
  const age = known.state?.age_s ?? null;
  document.body.classList.toggle("stale", !up);
  $("lost").hidden = up;
  if (!up) {
    const lost = { page: texts.lostPage, none: texts.lostDaemon, silent: texts.silentDaemon }[how];
    put("lost", how === "none" && known.state.ending?.reason ? `${lost} (${known.state.ending.reason})` : lost);
  }
  put("age", age === null ? texts.age(null) : texts.age(age + (Number.isFinite(passedS) ? passedS : 0)));
  const needs = Boolean(live) && (live.state === "held" || Boolean(live.approval));
  put("state", !up ? texts.links[how] : !live ? "" : live.approval ? texts.waitsForApproval : texts.states[live.state] ?? live.state);
  $("state").className = `state${!up || live?.unsafe?.length ? " is-alarm" : needs ? " attend" : ""}`;
  $("state").dataset.state = live?.state ?? "";
  const set = (id, on) => { if ($(id).disabled === on) $(id).disabled = !on; };
  set("hold", how === "silent" || (up && Boolean(live) && !["held", "finished"].includes(live.state)));
  set("stop", how === "silent" || (up && Boolean(live) && live.state !== "finished"));
  const order = lastOrder();
  put("ordered", order ? texts.lastOrder(texts.orders[order.data.order] ?? order.data.order, order.data.by || texts.byUnknown, clock(order.at_s)) : "");
  showAlarms();
  soundLost(how);
  const marks = !up || known.alarms.length ? "\u26a0 " : "";
  view?.tick?.();
  const title = `${marks}${$("state").textContent || "polishd"} - ${known.cell || "polishd"}`;
  if (document.title !== title) document.title = title;
}
function alarmText(one) { return texts.alarmTexts[one.name]?.(one.what) ?? (one.what || one.name.replaceAll("_", " ")); }
let shownAlarms = "";
function showAlarms() {
  const worst = known.alarms.find((one) => one.severity === "alarm") ?? known.alarms[0];
  const key = JSON.stringify([worst?.number, known.alarms.length, sound.sounding]);
  $("bar").hidden = $("lost").hidden && !worst && !sound.sounding;
  if (key === shownAlarms) return;
  shownAlarms = key;
  const line = $("alarm-line");
  line.hidden = !worst && !sound.sounding;
  line.className = `alarm-line sev-${worst?.severity ?? "warning"}`;
  const what = worst ? `${alarmText(worst)}${texts.moreAlarms(known.alarms.length - 1)}` : "";
  line.replaceChildren(icon("alarm"), made("span", what, "what"),
    ...(sound.sounding ? [button(texts.silence, "", () => { sound.silence(); show(); })] : []),
    ...(worst ? [button(texts.show, "", () => ctx.go("dashboard"))] : []));
}
function soundNew() {
  const newest = known.alarms.reduce((most, one) => Math.max(most, one.number), 0);
  const fresh = known.lastAlarm === null ? known.alarms : known.alarms.filter((one) => one.number > known.lastAlarm);
  known.lastAlarm = Math.max(known.lastAlarm ?? 0, newest);
  if (fresh.length) sound.start(fresh.some((one) => one.severity === "alarm") ? "alarm" : "warning");
  else if (!known.alarms.length && link() === "up") sound.silence();
}
let wasUp = false;
function soundLost(how) {
  if (how === "up") wasUp = true;
  else if (wasUp) { wasUp = false; sound.start("alarm"); }
}

// orders
let messageTimer = null;
function say(text) {
  put("message", text);
  clearTimeout(messageTimer);
  messageTimer = setTimeout(() => put("message", ""), MESSAGE_MS);
}
async function order(name, path, body) {
  say(`${name}: ${texts.sent}`);
  const answer = await ask("POST", path, body);
  const refused = answer.status ? `${texts.refused}: ${answer.error}` : answer.error;
  say(`${name}: ${answer.ok === false ? refused : answer.obeyed === false ? texts.notYet : texts.obeyed}`);
  refresh();
  return answer;
}
// Hold is one tap: it is safe, and Resume undoes it. Stop holds at the same tap, and then asks about the part that
// cannot be undone, the end of the run: no question delays leaving the part, and no slip ends a night's work.
$("hold").addEventListener("click", () => order(texts.hold, "/api/orders/hold", { reason: "" }));
$("stop").addEventListener("click", async () => {
  const held = known.state?.live?.state === "held";
  if (!held) order(texts.hold, "/api/orders/hold", { reason: texts.stop });
  const [title, ...lines] = held ? texts.stopHeld : texts.stopAsk;
  const reason = await confirmed(title, lines, { yes: texts.stopYes, no: held ? texts.cancel : texts.stopNo, danger: true, reason: true });
  if (reason !== null) order(texts.stop, "/api/orders/stop", { reason });
});
async function resume() {
  const [title, ...lines] = texts.resumeAsk;
  const reason = await confirmed(title, lines, { yes: texts.resume, reason: true });
  if (reason !== null) await order(texts.resume, "/api/orders/resume", { reason });
}

// A question before an order: null, or the reason ("" where none was given or asked for). Escape is no.
function confirmed(title, lines, { yes = title, no = texts.cancel, danger = false, reason = false } = {}) {
  const dialog = $("confirm");
  if (dialog.open) return Promise.resolve(null);
  put("confirm-h", title);
  $("confirm-lines").replaceChildren(...lines.map((line) => (line instanceof Node ? line : made("p", line))));
  put("confirm-yes", yes);
  put("confirm-no", no);
  $("confirm-yes").className = danger ? "danger" : "primary";
  $("reason").hidden = $("reason-label").hidden = !reason;
  $("reason").value = "";
  dialog.returnValue = "";
  dialog.showModal();
  $("confirm-yes").focus();
  return new Promise((done) => {
    dialog.addEventListener("close", () => done(dialog.returnValue === "yes" ? $("reason").value : null), { once: true });
  });
}
// Enter in the reason field confirms; without this the form would take its first button, which is "no".
$("reason").addEventListener("keydown", (event) => { if (event.key === "Enter") { event.preventDefault(); $("confirm").close("yes"); } });

// settings
function choices(id, options, chosen, choose) {
  const draw = () => $(id).replaceChildren(...Object.entries(options).map(([value, text]) => {
    const one = button(text, "", () => { choose(value); draw(); $(id).querySelector("[aria-pressed=true]").focus(); });
    one.setAttribute("aria-pressed", String(chosen() === value));
    return one;
  }));
  draw();
  return draw;
}
choices("theme", texts.themes, () => window.polishdTheme.choice, (value) => { window.polishdTheme.choice = value; });
const drawSound = choices("sound", texts.sounds, () => (sound.on ? "on" : "off"), (value) => { sound.on = value === "on"; soundIcon(); });
$("sound-test").addEventListener("click", async () => put("sound-message", (await sound.test()) ? texts.soundPlayed : texts.soundBlocked));
function soundIcon() {
  $("sound-icon").setAttribute("href", sound.on ? "#i-sound" : "#i-quiet");
  put("sound-name", sound.on ? texts.soundOn : texts.soundOff);
  $("sound-button").title = $("sound-name").textContent;
}
$("sound-button").addEventListener("click", () => { sound.on = !sound.on; soundIcon(); drawSound(); if (sound.on) sound.test(); say($("sound-name").textContent); });
soundIcon();
for (const kind of ["pointerdown", "keydown"]) addEventListener(kind, () => sound.unlock(), { once: true });

ask("GET", "/api/session").then((session) => (session.status === 200 ? signedIn(session) : signedOut()));
