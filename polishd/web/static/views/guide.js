// "What to do" in each state that needs a person, and at each ending: what happened, what is safe, and steps.
import { box, made } from "/dom.js";

// The state of the cell as a key of texts.guides, or "" while nothing needs a person.
export function guideOf(ctx) {
  const state = ctx.state(), how = ctx.link(), live = state?.live;
  if (how === "page") return "page";
  if (how === "silent") return "silent";
  if (how === "none") return state.ending?.state ?? "unknown";
  if (!live) return "";
  if (live.unsafe?.length) return "unsafe";
  if (live.approval) return "approval";
  if (live.state === "changing") return "changing";
  if (live.state !== "held") return "";
  const last = ctx.journal().find((one) => one.name === "cell_held" || (one.name === "command_received" && ["hold", "estop"].includes(one.data.order)));
  return last?.name === "command_received" ? "ordered" : "held";
}

// Text with `commands` as code.
export function withCode(tag, text) {
  const one = made(tag);
  text.split("`").forEach((part, k) => one.append(k % 2 ? made("code", part) : part));
  return one;
}

// The panel of a guide: title, what happened, safety as the devices confirmed it, steps, and the daemon's own advice.
export function guidePanel(ctx, key) {
  const t = ctx.texts.guide, guide = ctx.texts.guides[key] ?? ctx.texts.guides.unknown, state = ctx.state();
  const facts = ctx.link() === "none" ? state?.ending : ctx.link() === "up" ? state?.live : null;
  const steps = box("ol", "steps", ...guide.steps.map((text) => withCode("li", text)));
  const reason = facts?.reason || "";
  const safety = ctx.link() === "none" && facts?.tool_off ? box("dl", "safety", ...rows([[t.toolOff, t.confirmed[facts.tool_off] ?? facts.tool_off], [t.atRest, t.confirmed[facts.robot_at_rest] ?? facts.robot_at_rest]])) : null;
  const unsafe = (facts?.unsafe ?? []).map((text) => made("p", `${t.notSafe}: ${text}`, "alarm"));
  const panel = box("div", `guide current kind-${guide.kind}`, box("div", "guide-what", made("h3", guide.title, "guide-title"), reason ? made("p", reason, "guide-why") : null, ...unsafe, safety), box("div", "guide-steps", made("h4", t.todo), steps));
  panel.id = "guide";
  panel.dataset.guide = key;
  return panel;
}
const rows = (pairs) => pairs.flatMap(([name, value]) => [made("dt", name), made("dd", value)]);
