/** A clip that is uploaded and vectorised: the clip itself, dimmed, how far it is, and what went wrong. */

import { el, say } from "./dom.js";
import { cancel, close, retry } from "./clip.js";
import { doing, isTriable } from "./medium.js";
import { percent } from "./format.js";

export class OnTheWay {
  constructor(clip) {
    this.clip = clip;
    this.label = el("p", { class: "big" });
    this.detail = el("p", { class: "quiet" });
    this.bar = el("progress", { max: "1", "aria-label": "Progress of the clip" });
    this.stop = el("button", { type: "button", onclick: () => cancel(clip) }, "Cancel");
    this.again = el("button", { type: "button", class: "primary", onclick: () => retry(clip) }, "Try again");
    this.away = el("button", { type: "button", onclick: () => close() }, "Choose another clip");
    this.problem = el("div", { class: "problem", hidden: true });
    this.busy = el("div", { class: "busy" }, this.label, this.bar, this.detail, this.problem, el("div", { class: "row" }, this.stop, this.again, this.away));
    this.element = el("div", { class: "way" }, this.#backdrop(), this.busy);
  }

  #backdrop() {
    const { file, url } = this.clip;
    if (!url) return el("span");
    if (file.type.startsWith("image/")) return el("img", { class: "backdrop", src: url, alt: "" });
    const video = el("video", { class: "backdrop", src: url, playsinline: true, "aria-hidden": "true", tabindex: "-1" });
    Object.assign(video, { muted: true, loop: true });
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) video.play().catch(() => undefined);
    return video;
  }

  update() {
    const { error } = this.clip;
    const now = doing(this.clip);
    this.element.classList.toggle("failed", Boolean(error));
    this.problem.hidden = !error;
    this.bar.hidden = Boolean(error);
    this.stop.hidden = Boolean(error) || !now;
    this.again.hidden = !isTriable(this.clip);
    this.away.hidden = !error;
    if (error) {
      say(this.label, error.title ?? "Something went wrong");
      say(this.detail, error.detail ?? error.message ?? "");
      this.problem.hidden = !error.requestId;
      say(this.problem, error.requestId ? `Request ${error.requestId}` : "");
      return;
    }
    say(this.label, now?.label ?? "Nearly there");
    say(this.detail, now ? [now.share === null ? "" : percent(now.share), now.frames].filter(Boolean).join(" · ") : "");
    if (now?.share === null || !now) this.bar.removeAttribute("value");
    else this.bar.value = now.share;
  }

  close() {
    this.element.querySelector("video")?.removeAttribute("src");
  }
}
