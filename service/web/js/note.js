/** A line over the picture that says what is the matter, with "Try again" where that may help. */

import { el, say } from "./dom.js";

export class Note {
  #words = el("span", { role: "status" });
  #again = el("button", { type: "button", class: "small", hidden: true, onclick: () => this.#retry() }, "Try again");
  #work = null;

  element = el("p", { class: "note", hidden: true }, this.#words, this.#again);

  /** `again` is what is done when it is to be tried again, if it can be. */
  say(text, again = null) {
    this.#work = again;
    this.element.hidden = !text;
    this.#again.hidden = !again;
    say(this.#words, text);
  }

  #retry() {
    const work = this.#work;
    document.getElementById("stage").focus({ preventScroll: true }); // the button goes
    this.say("");
    work();
  }
}
