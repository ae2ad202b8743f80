// The cell's computer, its devices and signals, and this page: figures with plain names, units and limits.
import { box, card, made } from "/dom.js";
import { duration, figure, megabytes, NONE } from "/format.js";

export const styles = ["/views/host.css"];
const OLD_S = 15;

export function mount(root, ctx) {
  const t = ctx.texts.host;
  let certificate = null;
  const figures = made("div"), devices = made("div"), signals = made("div"), page = box("dl", "about");
  root.append(box("div", "host", card("host-figures", t.title, figures), card("host-devices", t.devices, devices), card("host-signals", t.signals, signals), card("host-page", t.page, page)));

  const shown = (value, unit) => (unit === "MB" ? megabytes(value) : unit === "s" ? (value < 1 ? `${figure(1000 * value, 2)}\u00a0ms` : duration(value)) : `${figure(Math.round(value), 3)}\u00a0${unit}`.trim());
  function table(at, heads, rows, empty) {
    const key = JSON.stringify(rows);
    if (at.dataset.key === key) return;
    at.dataset.key = key;
    if (!rows.length) { at.replaceChildren(made("p", empty, "note")); return; }
    const head = box("tr", "", ...heads.map((text) => { const one = made("th", text); one.scope = "col"; return one; }));
    const body = box("tbody", "", ...rows.map(([name, ...cells]) => {
      const first = made("th", name);
      first.scope = "row";
      return box("tr", "", first, ...cells.map((cell) => (Array.isArray(cell) ? made("td", cell[0], cell[1]) : made("td", cell))));
    }));
    at.replaceChildren(box("div", "scroll", box("table", "", box("thead", "", head), body)));
  }
  function show() {
    const state = ctx.state(), live = state?.live, how = ctx.link();
    const health = Object.entries(live?.health ?? {}).map(([name, one]) => {
      const [words, unit] = t.names[name] ?? [name.replaceAll("_", " "), ""];
      return [words, [shown(one.value, unit), "number"], [(one.least ? t.atLeast : t.atMost)(shown(one.limit, unit)), "number"], one.fits ? t.fine : [one.advice, "warning"]];
    });
    table(figures, [t.figure, t.value, t.limit, t.state], health, t.none);
    table(devices, [t.device, t.lastAnswer], Object.entries(live?.ages_s ?? {}).map(([name, age]) => [name, age > OLD_S ? [duration(age), "number warning"] : [age < 1 ? "< 1\u00a0s" : duration(Math.round(age)), "number"]]), t.noDevices);
    table(signals, [t.signal, t.value, t.state], Object.entries(live?.signals ?? {}).map(([name, one]) => [name, one.text || NONE, one.wrong ? [one.wrong, "warning"] : t.fine]), t.noSignals);
    const session = ctx.session(), facts = [
      [t.daemon, t.states[how] ?? t.states.none], [t.link, state?.age_s === null || state?.age_s === undefined ? NONE : state.age_s < 2 ? "< 2\u00a0s" : duration(state.age_s)],
      [t.user, session ? `${session.name} (${t.roles[session.role] ?? session.role})` : NONE],
      [t.certificate, certificate?.expires ? certificate.wrong || t.expires(Math.floor(certificate.days_left), certificate.expires) : t.noCertificate],
    ];
    const key = JSON.stringify(facts);
    if (page.dataset.key === key) return;
    page.dataset.key = key;
    page.replaceChildren(...facts.flatMap(([name, value]) => [made("dt", name), made("dd", value)]));
  }
  return {
    update: show,
    async refresh() {
      show();
      certificate = (await ctx.got("/api/health"))?.certificate ?? null;
      show();
    },
  };
}
