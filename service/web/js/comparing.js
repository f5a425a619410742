/**
 * A finished look over the clip it was made of, both playing as one. What the browser cannot play (ProRes, HEVC in
 * some) is compared in single frames, drawn by the service.
 */

import { choice, el, showPicture } from "./dom.js";
import { frame as frameOf, widthOf } from "./frames.js";
import { isAbort, silence } from "./api.js";
import { Latest } from "./latest.js";
import { Note } from "./note.js";
import { knownName } from "./names.js";
import { lookAgain } from "./references.js";
import { isShown, Player } from "./player.js";
import { state } from "./store.js";
import { middleOf, Split } from "./split.js";
import { isGood, release, resultUrl, uploadedUrl } from "./transfers.js";
import { transport } from "./transport.js";
import { failure } from "./notices.js";

export class Comparing {
  #stills = new Latest();

  /** The clip of `look` is on the stage; `compare` shows another look. */
  constructor({ bar, choices, compare }, { job, look }) {
    const { clip } = state;
    Object.assign(this, { clip, look, at: 0, playsBefore: null, playsAfter: null, renewing: false, left: null, broken: false, closed: false });
    const media = clip.medium.media ?? {};
    this.frames = Math.max(1, media.frame_count ?? 1);
    this.rate = media.frame_rate || 25;
    this.isClip = look.content_type.startsWith("video/");

    const video = (label) => el("video", { playsinline: true, preload: "auto", tabindex: "-1", "aria-label": label });
    this.videos = [video("The clip before"), video("The clip with the look")];
    this.images = [el("img", { alt: "The clip before", hidden: true }), el("img", { alt: "The clip with the look", hidden: true })];
    const sides = this.videos.map((one, index) => el("div", { class: "side-of" }, one, this.images[index]));
    this.split = new Split({ before: sides[0], after: sides[1] });
    this.split.shape(media.width, media.height);
    this.split.at = middleOf(clip.medium);
    this.note = new Note();
    this.split.element.append(el("span", { class: "spinner", "aria-hidden": "true" }));
    this.element = el("div", { class: "holder" }, this.split.element, this.note.element);
    this.#chooser(choices, job, compare);
    if (this.isClip) this.#makePlayer(bar);
    this.#load();
  }

  #chooser(choices, job, compare) {
    // of a file that is not kept there is nothing to show
    const kept = [...job.looks.entries()].filter(([, look]) => look.content_type);
    if (kept.length < 2) return;
    const group = choice("Finished looks", kept.map(([index, look]) => [String(index), knownName(look.reference) ?? `Look ${index + 1}`]), (index) => compare(job, job.looks[Number(index)]));
    group.value = String(job.looks.indexOf(this.look));
    choices.replaceChildren(group);
    choices.hidden = false;
    // of many looks not all are in sight: the one that is shown is
    const [row, all] = [group.querySelector(".chip:has(:checked)"), group].map((one) => one.getBoundingClientRect());
    group.scrollTop = row.top - all.top - (all.height - row.height) / 2;
  }

  #makePlayer(bar) {
    const [before, after] = this.videos;
    before.muted = true;
    const length = this.frames / this.rate;
    this.player = new Player(before, after, { rate: this.rate, length });
    this.player.addEventListener("time", () => this.#moved());
    before.addEventListener("loadeddata", () => { this.playsBefore = isShown(before); this.#showSides(); });
    before.addEventListener("error", async () => {
      const source = before.getAttribute("src");
      if (!source) return;
      if ((await isGood(source)) === "away") {
        this.#away();
        return;
      }
      this.playsBefore = false;
      this.#showSides();
    });
    after.addEventListener("loadeddata", () => {
      if (!isShown(after)) {
        this.#stepThrough();
        return;
      }
      this.playsAfter = true;
      this.split.shape(after.videoWidth, after.videoHeight);
      this.#moved();
      this.#resume();
    });
    after.addEventListener("error", async () => {
      const source = after.getAttribute("src");
      if (!source || (await this.#renewed(source))) return;
      this.#stepThrough();
    });
    this.controls = transport(bar, {
      on: {
        toggle: () => this.toggle(),
        seek: (n) => this.go(n),
        step: (by) => this.step(by),
        mute: this.clip.medium.media?.has_audio ? () => { after.muted = !after.muted; this.#moved(); } : null,
      },
      full: () => this.element,
    });
    this.#moved();
  }

  /** The result is one that the browser cannot play. */
  #stepThrough() {
    this.playsAfter = false;
    this.note.say("This browser cannot play this format; you see single frames. Download the file to see it whole.");
    this.#moved();
  }

  /**
   * Give the player another link when that of the result has expired, and say so when nobody answers; false when it is
   * the file that is no good.
   */
  async #renewed(source) {
    const [, after] = this.videos;
    this.left ??= { playing: this.player.playing, time: this.player.time };
    const good = await isGood(source);
    if (good === "away") {
      this.player.pause();
      this.#away();
      return true;
    }
    if (this.renewing || good) return false;
    try {
      const url = await resultUrl(this.look.result);
      if (this.#letGo() || after.getAttribute("src") !== source) return true;
      this.renewing = true; // until it plays: one that is no good at once is not renewed again
      after.src = url;
      return true;
    } catch (error) {
      failure(error, "The result cannot be shown any more");
      return true;
    }
  }

  /** Go on where the result was when it broke. */
  #resume() {
    const { left } = this;
    Object.assign(this, { renewing: false, left: null });
    if (!left) return;
    this.player.time = left.time;
    if (left.playing) this.player.play();
  }

  /** Nobody gave a file: what did not come is asked for again by hand. */
  #away() {
    if (this.closed) return;
    this.note.say(silence().text, () => this.videos.filter((video) => video.error).forEach((video) => video.load()));
  }

  async #load() {
    this.split.element.setAttribute("aria-busy", "true");
    try {
      const url = await resultUrl(this.look.result);
      if (this.#letGo()) return;
      if (this.isClip) {
        this.videos[1].src = url;
        if (!this.clip.url) this.uploaded = await uploadedUrl(this.look.video);
        if (this.#letGo()) return;
        this.videos[0].src = this.clip.url ?? this.uploaded;
      } else {
        await Promise.all([
          showPicture(this.images[1], url),
          frameOf(this.look.video, 0, null, widthOf(this.element)).then((before) => showPicture(this.images[0], before)),
        ]);
        this.split.shape(this.images[1].naturalWidth, this.images[1].naturalHeight);
      }
    } catch (error) {
      if (this.closed) return;
      this.note.say(`The result could not be shown. ${error.text ?? error.message}`, () => this.#load());
    }
    this.split.element.removeAttribute("aria-busy");
    this.#showSides();
  }

  toggle() {
    if (!this.playsAfter || this.videos[1].error) return;
    this.player.toggle();
    if (this.playsBefore === false) this.note.say("Only the result plays here: this browser cannot play the clip.");
  }

  step(by) {
    this.go(this.at + by);
  }

  go(n) {
    this.at = Math.max(0, Math.min(this.frames - 1, n));
    if (this.player) {
      this.player.pause();
      this.player.frame = this.at;
    }
    this.#moved();
  }

  #moved() {
    if (!this.player) return; // a still picture
    if (this.playsAfter) this.at = Math.min(this.frames - 1, this.player.frame);
    const { playing } = this.player;
    this.controls?.({ playing, frame: this.at, frames: this.frames, rate: this.rate, muted: this.videos[1].muted, canPlay: this.playsAfter });
    this.#showSides();
  }

  /**
   * Each side is a video if the browser plays it, else a still; while one plays alone there is nothing to part. The
   * result leads: when it cannot be played, the clip is a still of the same frame, too.
   */
  #showSides() {
    if (this.closed) return;
    const plays = this.isClip && this.playsAfter !== false ? [this.playsBefore, this.playsAfter] : [false, false];
    plays.forEach((on, side) => {
      this.videos[side].hidden = !on;
      this.images[side].hidden = on;
    });
    const playing = Boolean(this.player?.playing);
    this.split.active = !playing || Boolean(plays[0]);
    // null: it has not been tried yet
    if (!this.isClip || playing || plays.includes(null) || (plays[0] && plays[1])) return;
    const { at } = this;
    const name = `${at} ${plays}`;
    if (name === this.still) return;
    this.still = name;
    this.#stills.begin(async (signal) => {
      const { video } = this.look;
      try {
        const [before, after] = await Promise.all([
          plays[0] ? null : frameOf(video, at, null, widthOf(this.element), signal),
          plays[1] ? null : frameOf(video, at, lookAgain(this.look), widthOf(this.element), signal),
        ]);
        if (signal.aborted) return;
        if (before) await showPicture(this.images[0], before);
        if (after) await showPicture(this.images[1], after);
        if (this.broken) this.note.say("");
        this.broken = false;
      } catch (error) {
        if (isAbort(error) || signal.aborted) return;
        this.broken = true;
        this.note.say(error.text ?? error.message, () => this.#again());
      }
    }, 60);
  }

  /** Draw once more the single frames that could not be drawn. */
  #again() {
    this.still = "";
    this.#showSides();
  }

  /** Whether it was closed meanwhile; then nobody else lets go of what has come since. */
  #letGo() {
    if (!this.closed) return false;
    if (this.uploaded) URL.revokeObjectURL(this.uploaded);
    if (state.compared?.look.result !== this.look.result) release(this.look.result); // else it is shown again
    return true;
  }

  close() {
    this.closed = true;
    this.#stills.cancel();
    this.player?.pause();
    for (const video of this.videos) {
      video.removeAttribute("src");
      video.load();
    }
    release(this.look.result);
    if (this.uploaded) URL.revokeObjectURL(this.uploaded);
  }
}
