// The queue: the part at the machine, the parts that wait in order, and the last ones that ended.
import { box, button, card, icon, made, put } from "/dom.js";
import { clock, duration, withUnit } from "/format.js";
import { chip, hash, problem, styles, terms } from "./shop.js";

export { styles };

export function mount(root, ctx) {
  const t = ctx.texts.queue;
  let queue = null, failed = false, chosen = ctx.args().get("job") ?? "", focus = null, ended = innerWidth > 900, lastLook = "", dragging = false;
  const list = box("div", "queue-list"), details = box("aside", "queue-details card");
  const announce = made("p", "", "unseen");
  announce.setAttribute("aria-live", "polite");
  details.setAttribute("aria-label", t.details);
  root.append(announce, box("div", "queue-page", list, details));

  const up = () => ctx.link() === "up";
  const may = () => ctx.mayOperate() && up();
  const live = () => ctx.state()?.live ?? null;
  const waiting = () => queue.jobs.filter((one) => one.state === "waiting");
  const isHeld = () => live()?.state === "held";
  const shown = () => queue?.jobs.find((one) => one.name === chosen) ?? null;

  async function read() {
    const found = await ctx.got("/api/queue");
    failed = found === null;
    if (found) queue = found;
    draw();
  }

  // what a job is doing, in words
  function stateOf(one) {
    if (one.state === "waiting") return ["waiting", t.states.waiting];
    if (!up()) return ["", t.states["under way"]];
    const state = live()?.state;
    if (live()?.approval) return ["held", t.approval];
    return state === "held" ? ["held", t.held] : state === "changing" ? ["under way", t.changing] : state === "polishing" ? ["under way", t.polishing] : ["under way", t.states["under way"]];
  }
  function when(one) {
    if (one.begun_s !== null) return [t.since(duration(Date.now() / 1000 - one.begun_s)), one.typical_s === null ? t.takesUnknown : t.takes(duration(one.typical_s))].join(", ");
    const first = waiting()[0] === one && !queue.jobs.some((other) => other.begun_s !== null);
    const starts = one.starts_s === null ? "" : first && up() && !isHeld() ? t.startsNow : isHeld() || !up() ? t.startsAfter(clock(one.starts_s)) : t.starts(clock(one.starts_s));
    return [starts, one.typical_s === null ? t.takesUnknown : t.takes(duration(one.typical_s))].filter(Boolean).join(", ");
  }

  // orders
  async function move(one, where, other) {
    const order = waiting().filter((each) => each !== one);
    const at = where === "first" ? 0 : where === "last" ? order.length : order.findIndex((each) => each.name === other) + (where === "after" ? 1 : 0);
    const answer = await ctx.order(t.move, "/api/queue/move", { job: one.name, where, other: other ?? "" });
    if (answer.ok) put(announce, t.moved(one.name, at + 1, order.length + 1));
    await read();
  }
  function shift(one, by) {
    const order = waiting(), at = order.indexOf(one), other = order[at + by];
    if (other) move(one, by < 0 ? "before" : "after", other.name);
  }
  async function remove(one) {
    const [title, ...lines] = one.begun_s === null ? t.removeAsk(one.name) : t.asideAsk(one.name);
    const reason = await ctx.confirmWithReason(title, lines, { yes: one.begun_s === null ? t.remove : t.setAside, danger: true });
    if (reason === null) return;
    await ctx.order(t.remove, "/api/queue/remove", { job: one.name, reason });
    await read();
  }

  // the list
  function draw() {
    if (dragging) return; // never under a finger: a drag ends at the line it began with, and draws then
    if (!queue) {
      list.replaceChildren(failed ? problem(t.notLoaded) : made("p", "", "empty"));
      details.hidden = true;
      return;
    }
    const at = document.activeElement?.closest?.("[data-job]") && { job: document.activeElement.closest("[data-job]").dataset.job, what: document.activeElement.dataset.what };
    if (!shown() && queue.jobs.length) chosen = queue.jobs[0].name;
    const running = queue.jobs.filter((one) => one.state !== "waiting"), wait = waiting();
    const known = wait.every((one) => one.typical_s !== null), total = wait.reduce((sum, one) => sum + (one.typical_s ?? 0), 0);
    const rule = !up() ? made("p", t.noDaemon, "note") : ctx.mayOperate() ? null : made("p", t.watchOnly, "note");
    const order = box("ol", "jobs");
    order.append(...wait.map((one, n) => item(one, n, wait.length)));
    list.replaceChildren(
      ...(running.length ? [card("queue-running", t.atMachine, box("ol", "jobs", ...running.map((one) => item(one))))] : ownJob()),
      card("queue-waiting", t.waiting(wait.length), ...(wait.length ? [made("p", known ? t.total(wait.length, duration(total)) : t.totalUnknown(wait.length), "note"), rule, order].filter(Boolean) : [made("p", t.none), made("p", t.addWith, "note")])),
      endedCard(),
    );
    drawDetails();
    const again = focus ?? at;
    focus = null;
    if (again) list.querySelector(`[data-job="${CSS.escape(again.job)}"] [data-what="${again.what}"]`)?.focus({ preventScroll: true });
  }
  function item(one, n, of) {
    const [key, word] = stateOf(one), line = box("li", "job"), open = box("button", "job-open");
    open.type = "button";
    open.dataset.what = "open";
    open.setAttribute("aria-pressed", String(one.name === chosen));
    open.append(box("span", "job-names", made("strong", one.part_id), made("span", one.name, "note")), box("span", "job-when note", made("span", when(one))));
    open.addEventListener("click", () => { chosen = one.name; draw(); details.scrollIntoView({ block: "nearest", behavior: "smooth" }); });
    line.dataset.job = one.name;
    if (n !== undefined) {
      const grip = button("", "grip", () => {});
      grip.append(made("span", String(n + 1)), dots());
      grip.dataset.what = "grip";
      grip.setAttribute("aria-label", t.grip(one.name, n + 1, of));
      grip.disabled = !may() || of < 2;
      grip.addEventListener("keydown", (event) => {
        const act = { ArrowUp: () => shift(one, -1), ArrowDown: () => shift(one, 1), Home: () => move(one, "first"), End: () => move(one, "last") }[event.key];
        if (act) { event.preventDefault(); focus = { job: one.name, what: "grip" }; act(); }
      });
      grip.addEventListener("pointerdown", (event) => drag(event, one, line));
      line.append(grip);
    }
    line.append(open, ...(one.state === "waiting" ? [] : [chip(key, word)]));
    if (one.begun_s === null || isHeld()) {
      const tools = box("span", "job-tools");
      if (n !== undefined) {
        for (const [by, name, label, off] of [[-1, "up", t.up(one.name), n === 0], [1, "down", t.down(one.name), n === of - 1]]) {
          const arrow = button(by < 0 ? "↑" : "↓", "icon", () => { focus = { job: one.name, what: name }; shift(one, by); });
          arrow.dataset.what = name;
          arrow.setAttribute("aria-label", label);
          arrow.disabled = off || !may();
          tools.append(arrow);
        }
      }
      const out = button(one.begun_s === null ? "✕" : t.setAside, one.begun_s === null ? "icon" : "", () => remove(one));
      out.dataset.what = "remove";
      if (one.begun_s === null) out.setAttribute("aria-label", t.removeOf(one.name));
      out.disabled = !may();
      tools.append(out);
      line.append(tools);
    }
    if (one.state !== "waiting" && up() && live()?.approval) {
      const plan = made("a", t.lookAtPlan, "job-why attend");
      plan.href = "#approve";
      line.append(plan);
    }
    const why = key === "held" && isHeld() ? t.heldWhy(live()?.reason) : one.problem ? `${t.fileProblem} ${one.problem}` : one.shop && one.state === "waiting" ? t.shop : "";
    if (why) line.append(made("p", why, key === "held" || one.problem ? "job-why attend" : "job-why"));
    return line;
  }
  // a job of the cell's own file, which is in no queue
  function ownJob() {
    const now = live();
    if (!up() || !now?.job || ["idle", "finished"].includes(now.state)) return [];
    const held = now.state === "held", line = box("li", "job", box("span", "job-names", made("strong", now.part), made("span", now.job, "note")), chip(held ? "held" : "under way", held ? t.held : t.polishing), made("p", held ? t.heldWhy(now.reason) : t.ownJob, held ? "job-why attend" : "job-why"));
    return [card("queue-running", t.atMachine, box("ol", "jobs", line))];
  }
  function endedCard() {
    if (!queue.ended.length) return "";
    const fold = box("details", ""), rows = box("ol", "jobs ended");
    fold.open = ended;
    fold.addEventListener("toggle", () => { ended = fold.open; });
    for (const one of queue.ended) {
      const name = box("span", "job-names", made("strong", one.part_id), made("span", one.name, "note"));
      const line = box("li", "job", one.job === null ? name : link(`#history?job=${one.job}`, name), made("span", clock(one.ended_s), "note job-when"), chip(one.state, t.states[one.state] ?? one.state));
      if (one.reason && one.state !== "accepted") line.append(made("p", one.reason, "job-why"));
      rows.append(line);
    }
    const all = made("a", t.allParts(queue.ended_total));
    all.href = "#history";
    fold.append(made("summary", t.ended), rows, all);
    return box("section", "card", fold);
  }
  function link(href, child) {
    const one = box("a", "job-open", child);
    one.href = href;
    return one;
  }

  // the chosen job
  function drawDetails() {
    const one = shown();
    details.hidden = !queue.jobs.length;
    if (!one) { details.replaceChildren(made("p", t.choose, "empty")); return; }
    const d = one.details, [key, word] = stateOf(one);
    const head = box("div", "details-head", box("div", "", made("h2", one.name), made("p", one.part_id, "big")), chip(key, word));
    const parts = [head];
    if (one.problem) parts.push(problem(t.fileProblem, one.problem));
    if (d) {
      parts.push(
        made("h3", t.part), terms([
          [t.outline, d.outline.replace(/^an? /, "").replace(/^./, (first) => first.toUpperCase())], [t.edge, withUnit(d.edge_mm, "mm")],
          [t.radius, d.curvature_radius_mm === null ? t.flat : withUnit(d.curvature_radius_mm, "mm", 5)], [t.conic, d.conic || null],
          [t.offAxis, d.off_axis_mm.some(Boolean) ? `${d.off_axis_mm.join(", ")}\u00a0mm` : null], [t.form, d.form],
        ]),
        made("h3", t.tolerance), terms([...d.tolerance.map((line) => [line.what, `≤ ${withUnit(line.limit, unit(line.unit))}`]), [t.acceptBy, t.accepts[d.accept_by]]]),
        made("h3", t.recipe), terms([
          [t.program, box("span", "", `${d.program} `, d.program_sha256 ? hash(d.program_sha256) : made("span", t.programOfCell, "note"))],
          [t.force, withUnit(d.force_n, "N")], [t.speed, withUnit(d.rpm, "rpm")], [t.tools, d.tools.join(", ")],
          [t.model, d.removal_model.replaceAll("_", " ")], [t.correction, d.correction], [t.objective, d.objective.replaceAll("_", " ")], [t.passes, d.max_passes], [t.approve, d.approve ? t.yes : t.no],
        ]),
      );
    }
    parts.push(
      made("h3", t.time), terms([
        [t.duration, one.typical_s === null ? t.takesUnknown : duration(one.typical_s), one.typical_of ? t.basis(one.typical_of) : t.basisNone],
        [one.begun_s === null ? t.begin : t.began, one.begun_s === null ? clock(one.starts_s) : clock(one.begun_s)],
      ]),
      made("h3", t.origin), terms([[t.added, `${clock(one.added_s)}, ${one.by ? t.by(one.by) : t.byUnknown}`], [t.file, one.path]]),
    );
    details.replaceChildren(...parts);
  }

  // drag by mouse, pen or finger
  function drag(event, one, line) {
    if (event.button !== 0 || !may()) return;
    const grip = event.currentTarget, items = [...line.parentElement.children], from = items.indexOf(line), boxes = items.map((each) => each.getBoundingClientRect());
    const startY = event.clientY, step = boxes[from].height + (boxes[1] ? boxes[1].top - boxes[0].bottom : 0);
    let to = from, moved = false;
    grip.setPointerCapture(event.pointerId);
    const follow = (now) => {
      const by = now.clientY - startY;
      if (!moved && Math.abs(by) < 5) return;
      moved = true;
      line.classList.add("dragged");
      line.style.transform = `translateY(${by}px)`;
      const middle = boxes[from].top + boxes[from].height / 2 + by;
      to = items.reduce((best, _, n) => (Math.abs(boxes[n].top + boxes[n].height / 2 - middle) < Math.abs(boxes[best].top + boxes[best].height / 2 - middle) ? n : best), from);
      items.forEach((each, n) => { if (each !== line) each.style.transform = n > from && n <= to ? `translateY(${-step}px)` : n < from && n >= to ? `translateY(${step}px)` : ""; });
    };
    const end = (drop) => {
      grip.removeEventListener("pointermove", follow);
      for (const each of items) each.style.transform = "";
      line.classList.remove("dragged");
      dragging = false;
      if (drop && to !== from) { focus = { job: one.name, what: "grip" }; move(one, to < from ? "before" : "after", items[to].dataset.job); } else draw();
    };
    dragging = true;
    grip.addEventListener("pointermove", follow);
    grip.addEventListener("pointerup", () => end(moved), { once: true });
    grip.addEventListener("pointercancel", () => end(false), { once: true });
  }

  return {
    refresh: read,
    update() { // twice a second: only what follows from the state is drawn again
      const look = JSON.stringify([ctx.link(), live()?.state, live()?.approval, live()?.reason, ctx.mayOperate(), Math.floor(Date.now() / 30_000)]);
      if (look !== lastLook && queue && !dragging) { lastLook = look; draw(); }
    },
  };
}

const unit = (one) => (one === "urad" ? "µrad" : one.replaceAll("^2", "²"));
function dots() {
  const svg = icon("grip");
  svg.replaceChildren(...[6, 12, 18].flatMap((y) => [9, 15].map((x) => {
    const dot = document.createElementNS("http://www.w3.org/2000/svg", "circle");
    for (const [name, value] of Object.entries({ cx: x, cy: y, r: 1.2 })) dot.setAttribute(name, value);
    return dot;
  })));
  return svg;
}
