// Runs before the first paint, so that the page never flashes in the other colors. Choice: "auto", "light" or "dark".
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const choice = () => { try { return localStorage.getItem("polishd.theme") || "auto"; } catch { return "auto"; } };
  const apply = () => {
    const theme = choice() === "auto" ? (dark.matches ? "dark" : "light") : choice();
    if (document.documentElement.dataset.theme === theme) return;
    document.documentElement.dataset.theme = theme;
    document.querySelector("meta[name=theme-color]").content = theme === "dark" ? "#0f1215" : "#f3f4f6";
    dispatchEvent(new Event("polishd-theme"));
  };
  window.polishdTheme = {
    get choice() { return choice(); },
    set choice(one) { try { localStorage.setItem("polishd.theme", one); } catch { /* private window */ } apply(); },
  };
  dark.addEventListener("change", apply);
  apply();
})();
