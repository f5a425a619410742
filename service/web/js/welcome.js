/** Nothing on the stage yet: a place to drop a clip, and the clips of before. */

import { el, fileButton, keyed } from "./dom.js";
import { CLIP_TYPES, openFiles, openMedium } from "./clip.js";
import { lengthOf } from "./format.js";
import { thumbnail } from "./thumbnails.js";
import { state } from "./store.js";

export class Welcome {
  constructor() {
    this.list = el("ul", { class: "recent" });
    this.past = el("section", { class: "past", "aria-labelledby": "recent-name", hidden: true }, el("h3", { id: "recent-name" }, "Recent clips"), this.list);
    this.element = el("div", { class: "welcome" },
      el("div", { class: "drop" },
        el("p", { class: "big" }, matchMedia("(hover: none)").matches ? "Add a portrait clip" : "Drop a portrait clip here"),
        el("p", { class: "quiet" }, "It is vectorised once. After that, every look is quick."),
        ...fileButton("Choose a clip", { accept: CLIP_TYPES, take: openFiles, className: "primary", symbol: "plus" }),
        el("p", { class: "quiet small" }, "MP4, MOV, MKV, WebM, AVI, or a still picture. Files go to this service and nowhere else."),
      ),
      this.past);
  }

  update() {
    this.past.hidden = !state.clips.length;
    keyed(this.list, state.clips.slice(0, 6), (medium) => medium.id, (medium) => {
      const name = medium.filename ?? medium.id;
      const facts = el("span", { class: "quiet small" });
      const item = el("li", {}, el("button", { type: "button", class: "clip-card", onclick: () => openMedium(item.medium) },
        thumbnail("videos", medium), el("span", { class: "name" }, name), facts));
      item.update = (now) => {
        item.medium = now;
        facts.textContent = now.media ? lengthOf(now.media) : "On its way";
      };
      return item;
    });
  }
}
