/** Uploads in pieces (tus 1.0), which go on where a connection broke, and tell their progress, as `fetch` does not. */

import { address, ask, authorization, changeKey, pause, Problem, problemOf, silence } from "./api.js";
import { key } from "./key.js";

const VERSION = "1.0.0";
const ROLES = { videos: "video", references: "reference" };
/** a connection that stands still for so long while bytes go is dead */
const STALLED_MS = 30_000;
/** before, it may wait for one of the six that a browser opens to a host; after, the service puts the file together */
const LATE_MS = 600_000;
/** of a file that is larger than this the first bytes, by which the service knows its type, go before the others */
const LARGE_BYTES = 4 * 1024 ** 2;
const HEAD_BYTES = 4096;
/** what each break in a row is waited out with; then somebody has to ask for it */
const PAUSES_S = [1, 2, 4, 8, 15];
/** what the same bytes may be sent again after, besides silence */
const PASSING = new Set([404, 408, 409, 410, 429, 500, 502, 503, 504]);

/** those of which something may be with the service */
const unfinished = new Set();

// what is left of them would count as stored until it expires
window.addEventListener("pagehide", () => unfinished.forEach((one) => one.drop({ keepalive: true })));

/** A file on its way to `/videos` or `/references`. */
export class Upload {
  #path;
  #file;
  #id = null;
  #isDropped = false;

  constructor(path, file) {
    this.#path = path;
    this.#file = file;
  }

  /**
   * Send what the service has not got yet, and give the medium. `onProgress` gets the share that was sent, 0–1, and
   * whether a broken connection is waited for. Called again after an error, it goes on where it was.
   * Throws `Problem`, or an AbortError when `signal` says so.
   */
  async send({ onProgress, signal }) {
    this.#isDropped = false;
    let breaks = 0;
    let furthest = 0;
    for (;;) {
      try {
        const { offset_bytes: offset, media } = await this.#reached(signal);
        if (offset > furthest) breaks = 0;
        furthest = Math.max(offset, furthest);
        const id = media ?? (await this.#append(offset, { onProgress, signal }));
        if (!id) continue; // there is more to send, or another key has come
        const medium = await ask(`${this.#path}/${id}`, { signal });
        this.#forget();
        return medium;
      } catch (error) {
        if (error.status === 415) this.#forget(); // what is no picture or clip, the service has removed
        if (!this.#id || !isPassing(error)) throw error;
        if (breaks >= PAUSES_S.length) throw await this.#causeOf(error);
        onProgress?.(furthest / this.#file.size, true);
        await pause(PAUSES_S[breaks], signal);
        breaks += 1;
      }
    }
  }

  /**
   * Remove what has arrived. Whoever waits for it is told by the signal of `send`. `keepalive`: the page is hidden, for
   * good most likely; one that is shown again sends it anew.
   */
  async drop({ keepalive = false } = {}) {
    this.#isDropped ||= !keepalive;
    const id = this.#id;
    if (!id) return;
    this.#forget();
    await ask(`uploads/${id}`, { method: "DELETE", keepalive, again: !keepalive }).catch(() => undefined); // it expires
  }

  #forget() {
    this.#id = null;
    unfinished.delete(this);
  }

  /** How the upload stands with the service; one that is not there, or not any more, is begun. */
  async #reached(signal) {
    if (this.#id) {
      try {
        return await ask(`uploads/${this.#id}`, { signal });
      } catch (error) {
        if (![404, 410].includes(error.status)) throw error;
        this.#forget();
      }
    }
    const headers = { "Tus-Resumable": VERSION, "Upload-Length": this.#file.size, "Upload-Metadata": this.#said() };
    // without the signal: of one that is begun unheard, nobody could remove what it takes of a quota
    const begun = await ask("uploads", { method: "POST", headers });
    this.#id = begun.id;
    unfinished.add(this);
    if (this.#isDropped) await this.drop();
    signal?.throwIfAborted();
    return begun;
  }

  #said() {
    const about = { role: ROLES[this.#path], filename: this.#file.name };
    return Object.entries(about).map(([name, value]) => `${name} ${base64(value)}`).join(",");
  }

  /** Send what comes from `offset` on; the id of the medium, or null when there is more to do. */
  async #append(offset, { onProgress, signal }) {
    const used = key();
    const { status, text, media } = await this.#patch(offset, { onProgress, signal });
    if (status === 204) return media;
    if (status !== 401) throw problemOf(status, text);
    await changeKey(used);
    return null;
  }

  #patch(offset, { onProgress, signal }) {
    const { size } = this.#file;
    return new Promise((resolve, reject) => {
      const request = new XMLHttpRequest();
      let timer = 0;
      const wait = (ms) => {
        clearTimeout(timer);
        timer = setTimeout(() => {
          reject(silence());
          request.abort();
        }, ms);
      };
      request.open("PATCH", address(`uploads/${this.#id}`));
      const fields = { "Tus-Resumable": VERSION, "Upload-Offset": offset, "Content-Type": "application/offset+octet-stream" };
      for (const [name, value] of Object.entries({ ...fields, ...authorization() })) request.setRequestHeader(name, value);
      request.upload.addEventListener("progress", ({ loaded, total }) => {
        wait(loaded < total ? STALLED_MS : LATE_MS);
        onProgress?.((offset + loaded) / size, false);
      });
      request.addEventListener("load", () => resolve({ status: request.status, text: request.responseText, media: request.getResponseHeader("Pvg-Media") }));
      request.addEventListener("error", () => reject(silence()));
      request.addEventListener("abort", () => reject(new DOMException("canceled", "AbortError")));
      const abort = () => request.abort();
      signal?.addEventListener("abort", abort);
      request.addEventListener("loadend", () => {
        clearTimeout(timer);
        signal?.removeEventListener("abort", abort);
      });
      wait(LATE_MS);
      // what is no picture or clip is told by its first bytes, before all the others are sent
      request.send(this.#file.slice(offset, offset === 0 && size > LARGE_BYTES ? HEAD_BYTES : size));
    });
  }

  /** What is the matter when nothing gets through: a file that was changed or moved meanwhile is one reason. */
  async #causeOf(error) {
    try {
      await this.#file.slice(0, 1).arrayBuffer();
      return error;
    } catch {
      return new Problem({ code: "unreadable", title: "The file cannot be read any more", detail: "it was changed or moved; choose it once more" });
    }
  }
}

const isPassing = (error) => error.code === "unreachable" || PASSING.has(error.status);

const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
