/** Which faces: those of the clip that are recoloured, and the one of the portrait whose colours are taken. */

import { el, keyed } from "./dom.js";
import { faceThumbnail } from "./thumbnails.js";
import { isReady } from "./medium.js";
import { selectedReference, state } from "./store.js";
import { set } from "./references.js";

const nameOf = (face) => `Face ${face.index + 1}`;

/** The face whose colours are taken: the chosen one, or the largest. */
export function takenFace(medium, settings) {
  const chosen = medium.faces.find((face) => face.index === settings.reference_face);
  return chosen ?? medium.faces.reduce((best, face) => (face.width_px > (best?.width_px ?? 0) ? face : best), null);
}

function faces(label, type, path, takes) {
  const list = el("div", { class: "faces" });
  const made = el("fieldset", { class: "face-group", hidden: true }, el("legend", {}, label), list);
  made.show = (medium, chosen) => {
    const found = isReady({ medium }) ? medium.faces : [];
    made.hidden = found.length < 2;
    keyed(list, found, (face) => `${medium.id} ${face.index}`, (face) => {
      const input = el("input", { type, name: type === "radio" ? `${label} ${medium.id}` : undefined });
      input.addEventListener("change", () => takes(face.index, input.checked));
      const chip = el("label", { class: "face-chip", title: face.warnings?.join("\n") ?? "" }, input, faceThumbnail(path, medium, face), el("span", {}, nameOf(face)));
      return chip;
    });
    for (const [at, chip] of [...list.children].entries()) {
      chip.querySelector("input").checked = chosen(found[at]);
    }
  };
  return made;
}

/** Checkboxes for the faces of the clip. At least one stays chosen. */
export function faceChecks() {
  const all = () => state.clip.medium.faces.map((face) => face.index);
  const made = faces("Faces of the clip", "checkbox", "videos", (index, on) => {
    const { faces: now } = selectedReference().settings;
    const before = now === "all" ? all() : now;
    const after = all().filter((one) => (one === index ? on : before.includes(one)));
    set({ faces: after.length === all().length ? "all" : after.length ? after : before });
  });
  made.update = (settings) => made.show(state.clip?.medium, (face) => settings.faces === "all" || settings.faces.includes(face.index));
  return made;
}

/** Radio buttons for the faces of the portrait; the largest is taken unless another is chosen. */
export function faceChoice() {
  const made = faces("Face of the portrait", "radio", "references", (index) => set({ reference_face: index }));
  made.update = (settings, item) => {
    const taken = item?.medium ? takenFace(item.medium, settings) : null;
    made.show(item?.medium, (face) => face.index === taken?.index);
  };
  return made;
}
