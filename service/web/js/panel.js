/** The panel: how the selected portrait's colours are put on the clip, how results are written, and the start. */

import { DEFAULTS, chosen, onTheWay, reset, set, setAll } from "./references.js";
import { choice, el, say } from "./dom.js";
import { changed, onChange, selectedReference, state } from "./store.js";
import { count, percent, capital } from "./format.js";
import { faceChecks, faceChoice, takenFace } from "./faces.js";
import { formatsOf } from "./output.js";
import { isReady } from "./medium.js";
import { start } from "./transfers.js";

const PARTS = ["lips", "lids", "cheeks", "brows"];
let rows = 0;

/** A slider with its name and its value. `read(settings)` is the number, `write(number)` what is set. */
function row(label, { min = 0, max = 1, step = 0.01, show = percent, note = "" }, read, write) {
  rows += 1;
  const id = `row-${rows}`;
  // the slider says it: by itself it would be read out once more, and with each portrait that is selected
  const value = el("output", { for: id, "aria-live": "off" });
  const range = el("input", { type: "range", id, min, max, step, "aria-describedby": note ? `${id}-note` : undefined });
  range.addEventListener("input", () => write(Number(range.value)));
  const made = el("div", { class: "setting" },
    el("div", { class: "setting-head" }, el("label", { for: id }, label), value),
    range,
    note && el("p", { class: "quiet small", id: `${id}-note` }, note));
  made.update = (settings) => {
    const number = read(settings);
    if (Number(range.value) !== number) range.value = String(number);
    range.style.setProperty("--done", `${((number - min) / (max - min)) * 100}%`);
    say(value, show(number));
    range.setAttribute("aria-valuetext", show(number));
  };
  return made;
}

function checkbox(label, read, write) {
  const input = el("input", { type: "checkbox" });
  input.addEventListener("change", () => write(input.checked));
  const made = el("label", { class: "check" }, input, el("span", {}, label));
  made.update = (settings) => { input.checked = read(settings); };
  return made;
}

function contrast() {
  const times = (number) => `× ${number.toFixed(2)}`;
  const made = row("Contrast", { min: 0.7, max: 1.5, show: times }, ({ contrast: now }) => (now === "auto" ? 1 : now), (now) => set({ contrast: now }));
  const auto = checkbox("Auto", ({ contrast: now }) => now === "auto", (on) => set({ contrast: on ? "auto" : 1 }));
  auto.querySelector("input").setAttribute("aria-label", "Automatic contrast");
  const value = made.querySelector("output");
  value.before(auto);
  const { update } = made;
  made.update = (settings) => {
    update(settings);
    auto.update(settings);
    made.classList.toggle("off", settings.contrast === "auto");
    if (settings.contrast !== "auto") return;
    say(value, "");
    made.querySelector('input[type="range"]').setAttribute("aria-valuetext", "automatic");
  };
  return made;
}

/** One slider for all of the make-up, and one for each part where that is wanted. */
function makeup() {
  const mean = (now) => (typeof now === "number" ? now : PARTS.reduce((sum, part) => sum + now[part], 0) / PARTS.length);
  const parts = (now) => (typeof now === "number" ? Object.fromEntries(PARTS.map((part) => [part, now])) : now);
  const whole = row("Make-up", {}, ({ makeup: now }) => mean(now), (now) => set({ makeup: now }));
  const single = PARTS.map((part) => row(capital(part), {}, ({ makeup: now }) => parts(now)[part],
    (share) => set({ makeup: { ...parts(selectedReference().settings.makeup), [part]: share } })));
  const made = el("div", {}, whole, el("details", {}, el("summary", {}, "Make-up by part"), ...single));
  made.update = (settings) => [whole, ...single].forEach((one) => one.update(settings));
  return made;
}

function extent() {
  const made = choice("Where", [["skin", "All skin"], ["face", "Face and neck"]], (now) => set({ extent: now }), { hidden: false });
  made.update = (settings) => { made.value = settings.extent; };
  return made;
}

function keep() {
  const made = el("fieldset", { class: "checks" }, el("legend", {}, "Keep the clip's own colours of"));
  const boxes = [["eyes", "Eyes"], ["teeth", "Teeth"]].map(([part, label]) => checkbox(label, ({ protect }) => protect.includes(part),
    (on) => set({ protect: ["eyes", "teeth"].filter((one) => (one === part ? on : selectedReference().settings.protect.includes(one))) })));
  made.append(...boxes);
  made.update = (settings) => boxes.forEach((one) => one.update(settings));
  return made;
}

function match() {
  const made = choice("Match", [["semantic", "Part by part"], ["color", "By colour alone"]], (now) => set({ match: now }), { hidden: false });
  made.update = (settings) => { made.value = settings.match; };
  return made;
}

function output() {
  const select = el("select", { id: "format", onchange: () => { state.output.format = select.value; changed(); } });
  const extra = (name, label) => checkbox(label, () => state.output.extras.includes(name), (on) => {
    state.output.extras = ["cube", "matte"].filter((one) => (one === name ? on : state.output.extras.includes(one)));
    changed();
  });
  const extras = [extra("cube", "Look as a 3D LUT (.cube)"), extra("matte", "Matte")];
  const made = el("details", { class: "output" }, el("summary", {}, "Output"),
    el("div", { class: "setting" }, el("label", { for: "format" }, "Format"), select), ...extras);
  let kind = null;
  made.update = () => {
    const formats = formatsOf(state.clip);
    if (kind !== formats) {
      kind = formats;
      select.replaceChildren(...formats.map(([name, label]) => el("option", { value: name }, label)));
      if (!formats.some(([name]) => name === state.output.format)) state.output.format = "auto";
    }
    select.value = state.output.format;
    extras.forEach((one) => one.update());
  };
  return made;
}

/** Why nothing can be rendered yet; empty when it can. */
function missing() {
  if (!state.clip) return "Add a clip to begin.";
  if (state.clip.error && !state.clip.again) return "This clip cannot be used.";
  if (!isReady(state.clip)) return "The clip is not ready yet.";
  const waiting = onTheWay().length;
  if (waiting) return `${count(waiting, "portrait")} not ready yet.`;
  if (chosen().length) return "";
  return state.references.some(isReady) ? "Tick a portrait to render its look." : "Add a portrait to begin.";
}

export function mountPanel() {
  const form = document.getElementById("look");
  const settings = [
    faceChecks(),
    faceChoice(),
    row("Strength", {}, ({ strength }) => strength, (strength) => set({ strength })),
    contrast(),
    makeup(),
    row("Light", { note: "How far light falls as it does on the portrait." }, ({ light }) => light, (light) => set({ light })),
    row("Scene", { note: "How far the look gives way to the clip's own light where it is far from it." }, ({ scene }) => scene, (scene) => set({ scene })),
    extent(),
  ];
  const more = [keep(), match()];
  const every = [...settings, ...more];
  const alike = el("button", { type: "button", class: "plain", onclick: setAll }, "Use for all portraits");
  const undo = el("button", { type: "button", class: "plain", onclick: () => {
    reset();
    form.querySelector('input[type="range"]').focus(); // the button goes
  } }, "Reset");
  const group = el("fieldset", { class: "look" }, el("legend", { class: "unseen" }, "Settings of the look"), ...settings,
    el("details", {}, el("summary", {}, "More"), ...more), el("div", { class: "row bare" }, undo, alike));
  const note = el("p", { hidden: true });
  const hint = el("p", { class: "quiet small", id: "start-hint" });
  const go = el("button", { type: "submit", class: "primary wide", "aria-describedby": "start-hint" }, "Render");
  const written = output();
  form.append(note, group, written, el("div", { class: "start" }, go, hint));

  let starting = false;
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (starting || missing()) return;
    starting = true;
    // a second click within the same moment is one too many; the job itself may take long
    setTimeout(() => { starting = false; }, 600);
    await start();
  });

  onChange(() => {
    const item = selectedReference();
    document.getElementById("panel-kind").hidden = !item;
    const title = document.getElementById("panel-name");
    say(title, item ? item.name : "Look");
    title.title = item?.name ?? "";
    const notes = item?.error ? [item.error.text ?? item.error.message] : isReady(item) ? takenFace(item.medium, item.settings)?.warnings ?? [] : [];
    note.className = item?.error ? "problem" : "quiet small";
    note.hidden = !notes.length;
    say(note, notes.join("; "));
    group.disabled = !item;
    const now = item?.settings ?? DEFAULTS;
    every.forEach((one) => one.update(now, item));
    written.update();
    alike.hidden = state.references.length < 2;
    undo.hidden = JSON.stringify(now) === JSON.stringify(DEFAULTS);
    const why = missing();
    go.disabled = Boolean(why);
    say(hint, why);
    const looks = chosen().length;
    say(go, looks > 1 ? `Render ${count(looks, "look")}` : "Render");
  });
}
