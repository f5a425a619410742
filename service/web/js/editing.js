/**
 * The clip at rest, with the selected portrait's look on one of its frames, or with what was found in it drawn over
 * it. Playing shows the clip as it is: the file in this tab, or, after a reload, what the service has of it.
 */

import { choice, el, showPicture } from "./dom.js";
import { frame as frameOf, layerOf, widthOf } from "./frames.js";
import { isAbort } from "./api.js";
import { isReady } from "./medium.js";
import { Latest } from "./latest.js";
import { Note } from "./note.js";
import { lookOf } from "./references.js";
import { isShown, Player } from "./player.js";
import { selectedReference, state } from "./store.js";
import { middleOf, Split } from "./split.js";
import { isGood, uploadedUrl } from "./transfers.js";
import { transport } from "./transport.js";
import { failure } from "./notices.js";

/** a slider that moves asks only for where it rests */
const PAUSE_MS = 90;
const VEILS = ["mask", "matte"];
const LAYERS = [["look", "Look"], ["landmarks", "Landmarks"], ["mask", "Mask"], ["matte", "Matte"], ["curves", "Curves"]];

export class Editing {
  #work = new Latest();
  #asked = "";
  #layer = "";
  #seen = null;

  constructor({ bar, choices }, clip) {
    this.clip = clip;
    const { media } = clip.medium;
    this.frames = Math.max(1, media.frame_count ?? 1);
    this.rate = media.frame_rate || 25;
    this.at = Math.min(this.frames - 1, clip.medium.faces[0]?.first_frame ?? 0);

    this.video = el("video", { class: "layer playing", playsinline: true, hidden: true, tabindex: "-1", "aria-label": "The clip as it is" });
    this.before = el("img", { alt: "" });
    this.after = el("img", { alt: "" });
    this.veil = el("img", { class: "layer veil", alt: "", hidden: true });
    this.split = new Split({ before: this.before, after: this.after });
    this.split.shape(media.width, media.height);
    this.split.at = middleOf(clip.medium);
    this.note = new Note();
    this.split.element.append(this.veil, this.video, el("span", { class: "spinner", "aria-hidden": "true" }));
    this.before.addEventListener("load", () => this.split.shape(this.before.naturalWidth, this.before.naturalHeight));
    this.element = el("div", { class: "holder" }, this.split.element, this.note.element);

    this.chips = choice("Show", LAYERS, (value) => {
      this.#layer = value;
      this.update();
    });
    choices.replaceChildren(this.chips);
    choices.hidden = false;

    if (this.frames > 1) this.#makePlayer(bar);
  }

  #makePlayer(bar) {
    const { clip } = this;
    this.player = new Player(null, this.video, { rate: this.rate, length: this.frames / this.rate });
    this.player.loops = true;
    this.player.addEventListener("time", () => this.#played());
    this.video.addEventListener("error", () => this.#broke());
    this.video.addEventListener("loadeddata", () => isShown(this.video) || this.#stepThrough());
    if (clip.url) {
      this.video.src = clip.url;
      this.video.hidden = false; // until the first frame has come
    }
    const mute = () => {
      this.video.muted = !this.video.muted;
      this.#showTime();
    };
    this.controls = transport(bar, {
      on: { toggle: () => this.toggle(), seek: (n) => this.go(n), step: (by) => this.step(by), mute: clip.medium.media.has_audio ? mute : null },
      full: () => this.element,
    });
    this.#showTime();
  }

  get playing() {
    return Boolean(this.player?.playing);
  }

  /** Without a choice of the user: what was found, until there is a look to be seen. */
  get layer() {
    return this.#layer || (this.#look() ? "look" : "landmarks");
  }

  async toggle() {
    if (!this.player || this.fetching) return;
    if (this.playing) {
      this.player.pause();
    } else if (this.video.hasAttribute("src") || (await this.#fetched())) {
      this.player.frame = this.at;
      this.player.play();
    }
  }

  /** Have the file from the service, once it is to be played; true when it can be. */
  async #fetched() {
    const { video } = this;
    this.fetching = true;
    this.split.element.setAttribute("aria-busy", "true");
    try {
      this.uploaded = await uploadedUrl(this.clip.medium.id);
      if (this.closed) {
        URL.revokeObjectURL(this.uploaded);
        return false;
      }
      const comes = new Promise((resolve) => {
        video.addEventListener("loadeddata", () => resolve(isShown(video)), { once: true });
        video.addEventListener("error", () => resolve(false), { once: true });
      });
      video.preload = "auto";
      video.src = this.uploaded;
      return (await comes) && !this.closed;
    } catch (error) {
      failure(error, "The clip could not be fetched");
      return false;
    } finally {
      this.fetching = false;
      this.split.element.removeAttribute("aria-busy");
    }
  }

  /** A file that comes and cannot be played is stepped through; one that does not come is tried again. */
  async #broke() {
    const source = this.video.getAttribute("src");
    if (!source) return;
    if ((await isGood(source)) === true) {
      this.#stepThrough();
    } else if (!this.closed) {
      this.player?.pause();
      this.video.removeAttribute("src");
      failure({ title: "The service did not give its file", detail: "press Play once more in a moment" }, "The clip cannot be played just now");
    }
    this.#showTime();
  }

  /** The file is one that the browser cannot play. */
  #stepThrough() {
    this.player = null;
    if (this.uploaded) this.note.say("This browser cannot play this format; go through it frame by frame.");
    this.#showTime();
  }

  step(by) {
    this.go(this.at + by);
  }

  go(n) {
    this.player?.pause();
    this.at = Math.max(0, Math.min(this.frames - 1, n));
    this.#showTime();
    this.update();
  }

  #played() {
    if (this.playing) {
      this.video.hidden = false;
      this.at = Math.min(this.frames - 1, this.player.frame);
    } else if (!this.video.hidden) {
      this.update(); // the frame comes, then the video goes
    }
    this.#showTime();
  }

  #showTime() {
    this.controls?.({ playing: this.playing, frame: this.at, frames: this.frames, rate: this.rate, muted: this.video.muted, canPlay: Boolean(this.player) });
  }

  /** The look of the selected portrait; while that is on its way, the one that was seen before. */
  #look() {
    const reference = selectedReference();
    if (isReady(reference) || !reference || reference.error) this.#seen = reference;
    return isReady(this.#seen) && state.references.includes(this.#seen) ? lookOf(this.#seen) : null;
  }

  update() {
    if (this.playing) return;
    const { layer, at } = this;
    this.chips.value = layer;
    const look = layer === "look" ? this.#look() : null;
    const asked = JSON.stringify([at, layer, look]);
    if (asked === this.#asked) {
      // while it is still drawn, the video stays in its place
      this.video.hidden ||= !this.split.element.hasAttribute("aria-busy");
      return;
    }
    const pause = this.#asked ? PAUSE_MS : 0;
    this.#asked = asked;
    this.split.element.setAttribute("aria-busy", "true");
    this.#work.begin((signal) => this.#draw(at, layer, look, signal), pause);
  }

  async #draw(at, layer, look, signal) {
    const { id } = this.clip.medium;
    const width = widthOf(this.element);
    try {
      // masks are white on black: they lie over the frame and darken what is not of them
      const veiled = VEILS.includes(layer);
      // the look is asked for first: it is what is waited for
      const over = look ? frameOf(id, at, look, width, signal) : null;
      const drawn = layer !== "look" && layerOf(id, at, layer, signal);
      const under = layer === "look" || veiled ? frameOf(id, at, null, width, signal) : drawn;
      const [first, second, third] = await Promise.all([under, over, veiled ? drawn : null]);
      if (signal.aborted) return;
      await Promise.all([showPicture(this.before, first), second && showPicture(this.after, second), third && showPicture(this.veil, third)]);
      if (signal.aborted) return;
      this.before.alt = layer === "look" ? `Frame ${at + 1} of the clip` : `Frame ${at + 1} of the clip with its ${layer}`;
      this.after.alt = second ? `Frame ${at + 1} with the look` : "";
      this.veil.hidden = !third;
      this.split.active = Boolean(second);
      this.note.say("");
    } catch (error) {
      if (isAbort(error) || signal.aborted) return;
      this.split.active = false;
      const isGone = error.status === 404 && error.detail.includes(id);
      if (isGone) this.note.say("This clip is no longer here: it was deleted.");
      else this.note.say(error.text ?? error.message, () => this.#again());
    }
    this.video.hidden = true;
    this.split.element.removeAttribute("aria-busy");
  }

  /** Draw once more what could not be drawn. */
  #again() {
    this.#asked = "";
    this.update();
  }

  close() {
    this.closed = true;
    this.#work.cancel();
    this.player?.pause();
    this.video.removeAttribute("src");
    if (this.uploaded) URL.revokeObjectURL(this.uploaded);
  }
}
