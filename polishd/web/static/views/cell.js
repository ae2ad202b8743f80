// The cell: the robot as a stick figure, the part, the path colored by dwell, and where the tool is.
import { Camera } from "../maps/camera.js";
import { figure } from "../maps/colormap.js";
import { box, made } from "../dom.js";
import { canvas, choice, facts, select, toggle } from "../maps/elements.js";
import { drawCell, drawInset, drawLegend, intoHall, jointsAt, sceneOf } from "../maps/stick_figure.js";
import { oncePerFrame, onChange } from "../maps/theme.js";

const VIEWS = { free: [-0.65, 0.42], top: [0, Math.PI / 2], side: [-Math.PI / 2, 0], front: [0, 0] };

export const styles = ["/maps/maps.css"];

export function mount(root, ctx) {
  const texts = ctx.texts.cellView, now = { cycle: null, chosen: false, follow: true, focus: "cell", k: 0 }, known = { cell: null, why: "", asked: 0 };
  let ended = false;

  // elements
  const view = box("div", "m-view m-cell"), main = box("div", "m-main"), side = box("div", "m-side"), head = box("div", "m-head"), stage = box("div", "m-stage");
  const message = box("p", "m-message"), problem = box("p", "m-note m-warn"), note = box("p", "m-note"), picture = canvas(texts.canvas), bar = canvas(texts.color);
  picture.tabIndex = 0;
  picture.setAttribute("role", "application");
  message.setAttribute("role", "status");
  const views = choice(texts.view, texts.views, "free", (name) => camera.look(...VIEWS[name]));
  const cycles = select(texts.pass, {}, "", (cycle) => { Object.assign(now, { cycle: Number(cycle), chosen: true }); load(); });
  const follow = toggle(texts.follow, true, (on) => { now.follow = on; show(); });
  const point = box("label", "m-field"), slider = made("input"), card = box("section", "m-card"), numbers = facts(texts.shown), legend = box("section", "m-card");
  Object.assign(slider, { type: "range", min: "0", step: "1" });
  point.append(made("span", texts.point), slider);
  slider.addEventListener("input", () => { now.follow = false; follow.querySelector("input").checked = false; now.k = Number(slider.value); show(); });
  bar.style.height = "38px";
  bar.style.width = "100%";
  legend.append(made("h2", texts.color), bar);
  card.append(cycles, follow, point);
  stage.append(picture);
  head.append(views, choice(texts.focus, texts.focuses, now.focus, (focus) => { now.focus = focus; aim(); }));
  main.append(head, message, stage, problem, note);
  side.append(card, numbers, legend);
  view.append(main, side);
  root.replaceChildren(view);
  const camera = new Camera(picture, { yaw: VIEWS.free[0], pitch: VIEWS.free[1], radius: 1000, onMove: oncePerFrame(() => { views.choose(matching()); show(); }) });

  const matching = () => Object.entries(VIEWS).find(([, [yaw, pitch]]) => Math.abs(camera.yaw - yaw) < 1e-6 && Math.abs(camera.pitch - pitch) < 1e-6)?.[0] ?? "free";

  // data
  async function load() {
    const turn = ++known.asked, all = ctx.cycles() ?? [], waits = Boolean(ctx.state()?.live?.approval);
    const list = all.filter((one) => one.run || (waits && one === all.at(-1)));
    if (list.length && !(now.chosen && list.some((one) => one.cycle === now.cycle))) now.cycle = list.at(-1).cycle;
    cycles.fill(Object.fromEntries(list.map((one) => [one.cycle, String(one.cycle + 1)])), now.cycle);
    const key = JSON.stringify([ctx.job(), now.cycle, list.find((one) => one.cycle === now.cycle)?.run?.began_s]);
    if (known.cell && known.key === key) return;
    const found = list.length ? await ctx.ask("GET", `/api/jobs/${ctx.job()}/cycles/${now.cycle}/cell`) : { status: 404, error: texts.noPlan };
    if (ended || turn !== known.asked || !found.status) return;
    known.key = key;
    const before = known.cell?.robot;
    known.cell = found.status === 200 ? found : null;
    known.why = found.status === 200 ? "" : found.error;
    if (known.cell) {
      known.hall = intoHall(known.cell.up);
      const sorted = known.cell.path.dwell_s.slice().sort((a, b) => a - b);
      known.limits = [sorted[0], Math.max(sorted[Math.floor(sorted.length * 0.995)] ?? sorted[0], sorted[0] + 1e-9)];
      slider.max = String(known.cell.path.block.length - 1);
      aim();
      if (before !== known.cell.robot) camera.look(...VIEWS.free);
    }
    for (const one of [stage, note, head, numbers, legend, follow, point]) one.hidden = !known.cell;
    message.hidden = Boolean(known.cell);
    message.textContent = known.why;
    problem.textContent = known.cell?.problem ?? "";
    problem.hidden = !known.cell?.problem;
    note.textContent = `${texts.nominal} ${texts.keys}`;
    show();
  }

  function aim() {
    const scene = sceneOf(known.cell, known.hall, now.focus), whole = sceneOf(known.cell, known.hall, "cell");
    known.scene = { ...scene, radius: now.focus === "part" ? scene.radius * 1.3 : whole.radius };
    Object.assign(camera, { center: scene.center, radius: known.scene.radius, panX: 0, panY: 0, zoom: 1 });
    show();
  }

  // The block that the robot has executed, while this pass runs; else null.
  function running() {
    const live = ctx.state()?.live, block = live?.readings?.robot?.executed;
    return live?.phase === "run" && live.cycle === now.cycle && Number.isFinite(block) && ctx.state().daemon === "up" ? { block, touching: Boolean(live.pressing) } : null;
  }

  function show() {
    if (ended || !known.cell || !stage.clientWidth) return;
    const { cell } = known, runs = running(), live = now.follow ? runs : null, last = cell.path.block.length - 1;
    if (live) {
      const k = cell.path.block.findIndex((one) => one >= live.block);
      now.k = k < 0 ? last : k;
    }
    now.k = Math.min(now.k, last);
    slider.value = String(now.k);
    const block = cell.path.block[now.k], tip = cell.path.mm[now.k];
    slider.setAttribute("aria-valuetext", `${texts.block} ${block}`);
    drawCell(picture, { ...known, camera, joints: jointsAt(cell.poses, block), k: now.k, touching: Boolean(live?.touching) });
    if (now.focus === "cell") drawInset(picture, { ...known, k: now.k, touching: Boolean(live?.touching) });
    drawLegend(bar, known.limits, "s");
    view.dataset.ready = "cell"; // for tests and screenshots
    numbers.show([
      [texts.robot, texts.robots[cell.robot] ?? cell.robot], [texts.block, String(block)], [texts.tip, `${tip.map((value) => figure(value, 0)).join(", ")} mm`],
      [texts.state, runs ? (runs.touching ? texts.on : texts.off) : texts.notRunning],
    ]);
  }

  const end = onChange([picture, bar], show);
  return { update() { if (now.follow && running()) show(); }, refresh: load, unmount() { ended = true; end(); root.replaceChildren(); } };
}
