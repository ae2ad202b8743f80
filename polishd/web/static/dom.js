// Elements of the page. What comes from elsewhere is put on it as text, never as markup.
export const $ = (id) => document.getElementById(id);

// An element with its text and class.
export function made(tag, text, kind) {
  const one = document.createElement(tag);
  if (text !== undefined && text !== null) one.textContent = text;
  if (kind) one.className = kind;
  return one;
}

// An element with children; null and undefined are left out.
export function box(tag, kind, ...children) {
  const one = made(tag, undefined, kind);
  one.append(...children.filter((child) => child !== null && child !== undefined));
  return one;
}

// Set a text where it differs: a screen reader announces only what has changed.
export function put(element, text) {
  const one = typeof element === "string" ? $(element) : element;
  const value = text === null || text === undefined ? "" : String(text);
  if (one.textContent !== value) one.textContent = value;
}

// An icon of the sprite in index.html.
export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  use.setAttribute("href", `#i-${name}`);
  svg.setAttribute("aria-hidden", "true");
  svg.append(use);
  return svg;
}

export function button(text, kind, clicked) {
  const one = made("button", text, kind);
  one.type = "button";
  one.addEventListener("click", clicked);
  return one;
}

// A card of a view: heading and body. `id` names it for tests and for the skip link.
export function card(id, title, ...children) {
  const one = box("section", "card");
  const heading = made("h2", title);
  one.id = id;
  heading.id = `${id}-h`;
  one.setAttribute("aria-labelledby", heading.id);
  one.append(heading, ...children);
  return one;
}

// A color of page.css, for canvases.
export const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
