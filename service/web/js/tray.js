/** The tray of portraits: dropped or picked, chosen for rendering, selected for the panel. */

import { el, fileButton, iconButton, keyed, say, takesFiles } from "./dom.js";
import { addFiles, include, listReferences, remove, retry, select } from "./references.js";
import { doing, isReady, isTriable } from "./medium.js";
import { count } from "./format.js";
import { noFile } from "./notices.js";
import { onChange } from "./store.js";
import { faceThumbnail, thumbnail } from "./thumbnails.js";
import { takenFace } from "./faces.js";

const TYPES = "image/*,video/*,.tif,.tiff,.mkv,.mov";

function card(item) {
  const check = el("input", { type: "checkbox", class: "include", "aria-label": `Render ${item.name}`, onchange: () => include(item, check.checked) });
  const picture = el("span", { class: "portrait" });
  const name = el("span", { class: "name" }, item.name);
  const status = el("span", { class: "quiet small status", id: `status-${item.key}` });
  const bar = el("progress", { max: "1", "aria-label": `Progress of ${item.name}`, hidden: true });
  const pick = el("button", { type: "button", class: "pick", "aria-label": item.name, "aria-describedby": status.id, onclick: () => select(item.key) }, picture, name, status);
  const again = el("button", { type: "button", class: "small", hidden: true, onclick: () => retry(item) }, "Try again");
  const made = el("li", { class: "card" }, pick, bar, again, check, iconButton("bin", `Delete ${item.name}`, () => remove(item), { class: "icon away" }));
  let pictured = "";
  made.update = (now, selected) => {
    const busy = doing(now);
    const ready = isReady(now);
    const face = ready ? takenFace(now.medium, now.settings) : null;
    const near = now.file?.type.startsWith("video/") ? null : now.url;
    const wanted = face ? `face ${face.index}` : "file";
    if (pictured !== wanted) {
      pictured = wanted;
      picture.replaceChildren(face ? faceThumbnail("references", now.medium, face, "thumb") : thumbnail("references", now.medium, near));
    }
    check.checked = now.included;
    check.disabled = !ready && !busy;
    pick.setAttribute("aria-pressed", String(selected));
    made.classList.toggle("selected", selected);
    made.classList.toggle("failed", Boolean(now.error));
    bar.hidden = !busy;
    if (busy?.share === null) bar.removeAttribute("value");
    else if (busy) bar.value = busy.share;
    again.hidden = !isTriable(now);
    const warnings = face?.warnings ?? [];
    const faces = now.medium?.faces.length ?? 0;
    let text = ready && faces > 1 ? count(faces, "face") : "";
    if (warnings.length) text = warnings[0];
    if (busy) text = busy.label;
    if (now.error) text = now.error.text ?? now.error.message;
    say(status, text);
    pick.title = [now.name, ...warnings, now.error?.text ?? now.error?.message].filter(Boolean).join("\n");
  };
  return made;
}

export function mountTray() {
  const section = document.getElementById("tray");
  const cards = document.getElementById("cards");
  takesFiles(section, addFiles, noFile);
  const [button, input] = fileButton("Add portraits", { accept: TYPES, multiple: true, take: addFiles, className: "add", symbol: "plus" });
  const adder = el("li", { class: "card adder" }, button, input, el("span", { class: "quiet small" }, "or drop them here"));
  adder.dataset.key = "add";
  cards.append(adder);
  onChange((state) => {
    const more = state.more.references ? [{ key: "more" }] : [];
    keyed(cards, [{ key: "add" }, ...state.references, ...more], (one) => one.key, (item) => {
      if (item.key === "more") return el("li", { class: "card adder" }, el("button", { type: "button", class: "add", onclick: () => listReferences(state.more.references) }, "Show more"));
      const made = card(item);
      const { update } = made;
      made.update = (now) => update(now, now.key === state.selected);
      return made;
    });
    const included = state.references.filter((one) => one.included).length;
    say(document.getElementById("tray-hint"), state.references.length ? `${included} of ${state.references.length} chosen` : "Whose colours shall the clip have?");
  });
}
