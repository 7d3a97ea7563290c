"use strict";
// The app's pages: forms and buttons that ask the server, uploads, progress as it comes.
document.addEventListener("DOMContentLoaded", () => {
  const problem = document.getElementById("problem");
  const state = document.getElementById("state");
  const run = document.getElementById("run")?.dataset.run;
  const all = (selector, act) => { for (const e of document.querySelectorAll(selector)) act(e); };
  const say = (text) => { problem.textContent = text; problem.hidden = !text; if (text) problem.scrollIntoView({ block: "nearest" }); };

  const ask = async (method, path, body) => {
    say("");
    let answer;
    try {
      answer = await fetch(path, { method, headers: { "Content-Type": "application/json" }, body: body && JSON.stringify(body) });
    } catch {
      throw new Error("The server does not answer: is simgap app still running?");
    }
    const told = await answer.json().catch(() => ({ error: `The server answered with ${answer.status}.` }));
    if (!answer.ok) throw new Error(told.error);
    return told;
  };
  const attempt = (act) => async (event) => {
    try { await act(event); } catch (error) { state.textContent = ""; say(error.message); }
  };
  const go = (told, then) => { if (then === "open") location.assign(`/runs/${told.id}`); else location.reload(); };

  // what is said after the page has been loaded again
  const later = (text) => sessionStorage.setItem("said", text);
  state.textContent = sessionStorage.getItem("said") ?? "";
  sessionStorage.removeItem("said");

  // one file after the other; its share shown as it goes
  const put = (base, path, file, which) => new Promise((done, fail) => {
    const request = new XMLHttpRequest();
    request.open("PUT", base + path.split("/").map(encodeURIComponent).join("/"));
    request.upload.onprogress = (e) => { state.textContent = `${which} ${path}: ${Math.round(100 * e.loaded / Math.max(e.total, 1))} %`; };
    request.onerror = () => fail(new Error(`${path}: the server does not take it: it is too large, or simgap app does not run`));
    request.onload = () => {
      let told = {};
      try { told = JSON.parse(request.responseText); } catch { /* no JSON */ }
      if (request.status < 300) done(told); else fail(new Error(told.error ?? `The server answered with ${request.status}.`));
    };
    request.send(file);
  });
  // of a folder only files that are read here are sent
  const wanted = (file, endings) => {
    const parts = (file.webkitRelativePath || file.name).split("/");
    return !endings || (!parts.some((part) => part.startsWith(".")) && endings.split(",").some((e) => file.name.toLowerCase().endsWith(e)));
  };
  const upload = async (input) => {
    say("");
    const chosen = [...input.files].filter((file) => wanted(file, input.dataset.endings));
    if (!chosen.length) throw new Error(`The folder holds no file that is read here: ${input.dataset.endings.replaceAll(",", ", ")}.`);
    let left = input.files.length - chosen.length;
    for (const [i, file] of chosen.entries()) {
      const told = await put(input.dataset.put, file.webkitRelativePath || file.name, file, `${i + 1} of ${chosen.length}:`);
      left += told.left_out ?? 0;
    }
    if (left) later(`${left} ${left > 1 ? "files" : "file"} of kinds that are not read here ${left > 1 ? "were" : "was"} left out.`);
    location.reload();
  };

  all("form[data-post]", (form) => form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(async () => go(await ask("POST", form.dataset.post, Object.fromEntries(new FormData(form))), form.dataset.then))();
  }));
  all("form[data-compare]", (form) => form.addEventListener("submit", (event) => {
    event.preventDefault(); // the page's policy lets no form be sent
    location.assign(`/compare?${new URLSearchParams(new FormData(form))}`);
  }));
  all("button[data-post]", (b) => b.addEventListener("click", attempt(async () => go(await ask("POST", b.dataset.post, {}), b.dataset.then))));
  all("button[data-delete]", (b) => b.addEventListener("click", attempt(async () => {
    if (!b.dataset.ask || confirm(b.dataset.ask)) go(await ask("DELETE", b.dataset.delete));
  })));
  all("input[data-put]", (input) => input.addEventListener("change", attempt(() => input.files.length ? upload(input) : undefined)));

  // settings are saved as they are changed; a start waits for those under way
  let saving = Promise.resolve();
  const save = (settings, again) => {
    saving = saving.catch(() => {}).then(() => ask("POST", `${run}/settings`, settings)).then(() => { state.textContent = "Saved."; if (again) location.reload(); });
    return saving;
  };
  const value = (e) => e.type === "checkbox" ? e.checked : e.type !== "number" ? e.value : e.value === "" ? null : Number(e.value);
  all("[data-setting]", (e) => e.addEventListener("change", attempt(() => {
    if (e.validity.badInput) throw new Error(`${e.labels[0]?.textContent.trim()}: no number.`);
    const { command, setting } = e.dataset;
    return save(command ? { values: { [command]: { [setting]: value(e) } } } : { [setting]: value(e) }, !command);
  })));
  all("[data-part]", (e) => e.addEventListener("change", attempt(() => {
    const { part } = e.dataset;
    return save({ [part]: [...document.querySelectorAll(`[data-part=${part}]:checked`)].map((c) => c.value) }, true);
  })));
  all("[data-start]", (b) => b.addEventListener("click", attempt(async () => {
    await saving;
    await ask("POST", `${run}/start`, { command: b.dataset.start });
    location.reload();
  })));

  all("[data-picture]", async (place) => {
    try {
      const told = await ask("GET", place.dataset.picture);
      if (told.svg) place.innerHTML = told.svg; // drawn by the server, its texts escaped
      else place.textContent = told.problem;
    } catch (error) { place.textContent = error.message; }
  });

  all("[data-events]", (list) => {
    const events = new EventSource(list.dataset.events);
    events.onmessage = (event) => {
      const line = document.createElement("li");
      line.textContent = JSON.parse(event.data);
      list.append(line);
      list.scrollTop = list.scrollHeight;
    };
    events.addEventListener("ended", () => { events.close(); location.reload(); });
    events.onerror = () => { if (events.readyState === EventSource.CLOSED) say("The server does not answer: is simgap app still running?"); };
    events.onopen = () => { list.replaceChildren(); };
  });
});
