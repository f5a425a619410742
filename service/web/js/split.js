/** Two pictures over each other and a line that parts them: before on its left, after on its right. */

import { el } from "./dom.js";

/** The middle of the largest face of a clip: a line through it shows most. */
export function middleOf(medium) {
  const largest = medium?.faces.reduce((best, face) => ((face.box?.[2] ?? 0) > (best?.box[2] ?? 0) ? face : best), null);
  if (!largest?.box || !medium.media?.width) return 0.5;
  const [x, , width] = largest.box;
  return Math.min(0.85, Math.max(0.15, (x + width / 2) / medium.media.width));
}

export class Split {
  /** `before` and `after` are elements of the same size. */
  constructor({ before, after, label = "Before and after" }) {
    before.classList.add("layer");
    after.classList.add("layer", "after");
    this.range = el("input", { type: "range", class: "split", min: "0", max: "100", step: "0.5", value: "50", "aria-label": label });
    this.tags = [el("span", { class: "tag left", "aria-hidden": "true" }, "Before"), el("span", { class: "tag right", "aria-hidden": "true" }, "After")];
    this.element = el("div", { class: "frame" }, before, after, el("span", { class: "line", "aria-hidden": "true" }), ...this.tags, this.range);
    this.range.addEventListener("input", () => this.#move());
    this.#move();
    this.active = false;
  }

  #move() {
    const at = Number(this.range.value);
    this.element.style.setProperty("--split", `${at}%`);
    this.range.setAttribute("aria-valuetext", `${Math.round(100 - at)} % after`);
    this.tags[0].classList.toggle("gone", at < 14);
    this.tags[1].classList.toggle("gone", at > 86);
  }

  /** Where the line is, 0–1 of the width. */
  set at(share) {
    this.range.value = String(share * 100);
    this.#move();
  }

  /** The shape of the pictures, width by height. */
  shape(width, height) {
    if (width && height) this.element.style.setProperty("--ratio", String(width / height));
  }

  /** Whether there is anything to compare. */
  set active(on) {
    this.element.classList.toggle("single", !on);
    this.range.disabled = !on;
    this.range.hidden = !on;
  }
}
