"use strict";
// The switch of colours: system, light, dark. Stored while the page is open, where the browser allows it.
(() => {
  const root = document.documentElement;
  const names = ["system", "light", "dark"];
  root.classList.add("js");
  const recall = () => { try { return sessionStorage.getItem("simgap-theme"); } catch { return null; } };
  const keep = (name) => { try { sessionStorage.setItem("simgap-theme", name); } catch { /* not allowed from a file */ } };
  const changed = () => document.dispatchEvent(new Event("simgap-theme"));
  let now = names.includes(recall()) ? recall() : "system";
  const show = () => {
    if (now === "system") root.removeAttribute("data-theme"); else root.dataset.theme = now;
    const button = document.getElementById("theme");
    if (button) button.textContent = `Colours: ${now}`;
  };
  show();
  document.addEventListener("DOMContentLoaded", () => {
    show();
    document.getElementById("theme")?.addEventListener("click", () => {
      now = names[(names.indexOf(now) + 1) % names.length];
      keep(now);
      show();
      changed();
    });
    let opened = [];
    addEventListener("beforeprint", () => { opened = [...document.querySelectorAll("details:not([open])")]; for (const d of opened) d.open = true; });
    addEventListener("afterprint", () => { for (const d of opened) d.open = false; });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  });
})();
