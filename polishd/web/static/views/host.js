// Placeholder until this view exists.
export function mount(root, ctx) {
  const said = document.createElement("p");
  said.className = "empty";
  said.textContent = ctx.texts.noView;
  root.append(said);
  return {};
}
