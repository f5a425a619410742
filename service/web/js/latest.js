/** Work of which only the newest counts: what is still under way is canceled when the next begins. */

import { isAbort } from "./api.js";

/** `begin(work)` waits `pauseMs`, then runs `work(signal)`, unless another came in between. */
export class Latest {
  #controller = new AbortController();
  #timer = 0;

  begin(work, pauseMs = 0) {
    this.cancel();
    const { signal } = this.#controller;
    this.#timer = setTimeout(async () => {
      try {
        await work(signal);
      } catch (error) {
        if (!isAbort(error)) console.error(error);
      }
    }, pauseMs);
  }

  cancel() {
    clearTimeout(this.#timer);
    this.#controller.abort();
    this.#controller = new AbortController();
  }
}
