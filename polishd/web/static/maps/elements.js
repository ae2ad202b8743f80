// Small elements of these views.
import { box, button, made } from "../dom.js";

let number = 0;

// A labelled choice of a few: a fieldset of radio buttons that looks like one bar.
export function choice(title, options, chosen, onChoose) {
  const group = box("fieldset", "m-choice"), name = `choice-${++number}`;
  group.append(made("legend", title));
  for (const [value, text] of Object.entries(options)) {
    const label = made("label"), input = made("input");
    Object.assign(input, { type: "radio", name, value, checked: value === chosen });
    input.addEventListener("change", () => onChoose(value));
    label.append(input, made("span", text));
    group.append(label);
  }
  group.choose = (value) => { for (const one of group.querySelectorAll("input")) one.checked = one.value === value; };
  return group;
}

export function select(title, options, chosen, onChoose) {
  const label = box("label", "m-field"), input = made("select");
  label.append(made("span", title), input);
  label.fill = (entries, value) => {
    input.replaceChildren(...Object.entries(entries).map(([key, text]) => new Option(text, key, false, key === String(value))));
    input.value = String(value);
  };
  label.fill(options, chosen);
  input.addEventListener("change", () => onChoose(input.value));
  return label;
}

export function toggle(title, chosen, onChoose) {
  const label = box("label", "m-toggle"), input = made("input");
  Object.assign(input, { type: "checkbox", checked: chosen });
  input.addEventListener("change", () => onChoose(input.checked));
  label.append(input, made("span", title));
  return label;
}

// A button with a sign, and its meaning for screen readers.
export function sign(text, meaning, clicked) {
  const one = button(text, "m-button", clicked);
  one.title = meaning;
  one.setAttribute("aria-label", meaning);
  return one;
}

// A list of names and values; show([[name, value], ...]).
export function facts(title) {
  const section = box("section", "m-facts"), list = made("dl");
  section.append(made("h2", title), list);
  section.show = (rows) => {
    if (list.children.length !== 2 * rows.length) list.replaceChildren(...rows.flatMap(() => [made("dt"), made("dd")]));
    rows.forEach(([name, value], k) => {
      const [dt, dd] = [list.children[2 * k], list.children[2 * k + 1]];
      if (dt.textContent !== name) dt.textContent = name;
      if (dd.textContent !== value) dd.textContent = value;
    });
  };
  return section;
}

export function canvas(label, kind = "") {
  const one = box("canvas", kind);
  one.setAttribute("role", "img");
  one.setAttribute("aria-label", label);
  return one;
}
