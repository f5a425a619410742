/** Nothing on the stage yet: a place to drop a clip, and the clips of before. */

import { el, fileButton, iconButton, keyed, say } from "./dom.js";
import { CLIP_TYPES, moreClips, openFiles, openMedium, remove } from "./clip.js";
import { lengthOf } from "./format.js";
import { thumbnail } from "./thumbnails.js";
import { state } from "./store.js";

/** What a card says of a clip. */
function factsOf({ state: standing, media, error }) {
  if (standing === "failed") return error?.title ?? "Failed";
  return media ? lengthOf(media) : "On its way";
}

export class Welcome {
  constructor() {
    this.list = el("ul", { class: "recent" });
    this.more = el("button", { type: "button", class: "small", onclick: () => moreClips() }, "Show more");
    this.past = el("section", { class: "past", "aria-labelledby": "recent-name", hidden: true }, el("h3", { id: "recent-name" }, "Recent clips"), this.list, this.more);
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
    this.more.hidden = !state.more.clips;
    keyed(this.list, state.clips, (medium) => medium.id, (medium) => {
      const name = medium.filename ?? medium.id;
      const facts = el("span", { class: "quiet small" });
      const picture = el("span", { class: "poster" });
      const item = el("li", {}, el("button", { type: "button", class: "clip-card", onclick: () => openMedium(item.medium) },
        picture, el("span", { class: "name", title: name }, name), facts),
      iconButton("bin", `Delete ${name}`, () => remove(item.medium), { class: "icon away" }));
      item.update = (now) => {
        if (item.medium?.state !== now.state) picture.replaceChildren(thumbnail("videos", now));
        item.medium = now;
        item.classList.toggle("failed", now.state === "failed");
        say(facts, factsOf(now));
      };
      return item;
    });
  }
}
