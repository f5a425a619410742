/**
 * Two videos that play as one. `after` leads: it has the sound and the time; `before` is held to it frame by frame.
 * `before` may be null, or a file that the browser cannot play; then `after` plays alone.
 */

/** seconds apart beyond which `before` jumps; below, it runs a little faster or slower */
const JUMP_S = 0.3;
const MOST_HASTE = 0.15;

/** Whether a browser shows a video that it has loaded: of a file whose pictures it cannot decode it plays the sound alone. */
export const isShown = (video) => video.videoWidth > 0;

export class Player extends EventTarget {
  /** video → the time of its first frame */
  #starts = new Map();
  /** the time that is wanted and lies after the end that the browser knows of so far */
  #ahead = null;

  constructor(before, after, { rate, length }) {
    super();
    Object.assign(this, { before, after, rate: rate || 25, length: length || 0, loops: true, drift: 0 });
    after.addEventListener("play", () => this.#tell());
    after.addEventListener("pause", () => {
      before?.pause();
      this.#align();
      this.#tell();
    });
    after.addEventListener("seeking", () => this.#align());
    after.addEventListener("timeupdate", () => this.#tell());
    after.addEventListener("durationchange", () => {
      if (this.#ahead !== null) this.time = this.#ahead;
    });
    before?.addEventListener("durationchange", () => this.#align());
    after.addEventListener("ended", () => {
      if (!this.loops) return;
      this.time = 0;
      this.play();
    });
    for (const video of [before, after]) {
      video?.addEventListener("loadeddata", () => {
        // some files begin later than at 0, and the browser counts from there
        this.#starts.set(video, video.currentTime);
        this.#align();
      }, { once: true });
    }
    this.#follow();
  }

  get playing() {
    return !this.after.paused && !this.after.ended;
  }

  /** Seconds after the first frame. */
  get time() {
    return Math.max(0, this.after.currentTime - this.#start(this.after));
  }

  set time(seconds) {
    if (!this.#starts.has(this.after)) return; // nothing is loaded yet
    const wanted = Math.max(0, seconds);
    this.#ahead = wanted > this.duration ? wanted : null;
    this.after.currentTime = this.#start(this.after) + Math.min(wanted, this.duration);
    this.#align();
  }

  /** Of a file that begins later than at 0, Chromium finds the end only as it reads on, and jumps no further than that. */
  get duration() {
    const { duration } = this.after;
    return Number.isFinite(duration) ? duration - this.#start(this.after) : this.length;
  }

  #start(video) {
    return this.#starts.get(video) ?? 0;
  }

  /** Where `before` ought to be. */
  get #wanted() {
    return this.time + this.#start(this.before);
  }

  /** The number of the frame that is shown. */
  get frame() {
    return Math.max(0, Math.floor(this.time * this.rate + 1e-3));
  }

  set frame(number) {
    // the middle of a frame: its beginning may be rounded into the one before
    this.time = (Math.max(0, number) + 0.5) / this.rate;
  }

  async play() {
    if (this.after.ended) this.time = 0;
    this.#align();
    try {
      await Promise.all([this.after.play(), this.#playBefore()]);
    } catch (error) {
      if (error.name !== "AbortError") throw error; // a pause came first
    }
  }

  pause() {
    this.#ahead = null;
    this.after.pause();
  }

  toggle() {
    return this.playing ? this.pause() : this.play();
  }

  async #playBefore() {
    if (this.before && !this.before.error) await this.before.play().catch(() => undefined);
  }

  #tell() {
    this.dispatchEvent(new Event("time"));
  }

  /** While nothing plays, both show the same moment. */
  #align() {
    const { before, after } = this;
    if (!before || before.error || this.playing || !this.#starts.has(before) || !this.#starts.has(after)) return;
    before.playbackRate = 1;
    if (Math.abs(before.currentTime - this.#wanted) > 1e-4) before.currentTime = this.#wanted;
  }

  /** With each frame of `after`, bring `before` nearer to it. */
  #follow() {
    const step = () => {
      const { before, after } = this;
      if (before && !before.error && this.playing) {
        this.drift = before.currentTime - this.#wanted;
        if (before.paused && !before.ended) this.#playBefore();
        if (Math.abs(this.drift) > JUMP_S) before.currentTime = this.#wanted;
        else before.playbackRate = 1 - Math.max(-MOST_HASTE, Math.min(MOST_HASTE, this.drift * 2));
      }
      this.#tell();
      after.requestVideoFrameCallback(step);
    };
    this.after.requestVideoFrameCallback?.(step);
  }
}
