/**
 * The key of a service that wants one. It lives in this tab's session storage, goes out in the Authorization header
 * alone, and is never part of an address.
 */

const PLACE = "pvg-key";
/** what a header can carry; keys have even less */
const VISIBLE = /^[\x21-\x7e]+$/;
let asking = null;
const listeners = [];

/** Tell `listener` whenever another key has come: what was fetched with the one before is not for it. */
export const onNewKey = (listener) => listeners.push(listener);

export const key = () => sessionStorage.getItem(PLACE);

/** Ask for a key; `why` says what was wrong with the last one. The same question is not asked twice at a time. */
export function askForKey(why = "") {
  asking ??= new Promise((resolve) => {
    const dialog = document.getElementById("key-dialog");
    const form = document.getElementById("key-form");
    const input = document.getElementById("key");
    const reason = document.getElementById("key-why");
    const say = (text) => {
      reason.textContent = text;
      reason.hidden = !text;
    };
    say(why);
    input.value = "";
    // there is nothing to do without a key: Escape leaves the question
    dialog.oncancel = (event) => event.preventDefault();
    form.onsubmit = (event) => {
      if (VISIBLE.test(input.value.trim())) return;
      event.preventDefault();
      say("A key has letters, digits, _ and - alone. This text has others, or spaces; copy the key once more.");
      input.select();
    };
    dialog.addEventListener("close", () => {
      asking = null;
      const given = input.value.trim();
      const isNew = given !== key();
      sessionStorage.setItem(PLACE, given);
      if (isNew) for (const listener of listeners) listener();
      input.value = "";
      document.getElementById("change-key").hidden = false;
      resolve();
    }, { once: true });
    dialog.showModal();
    input.focus();
  });
  return asking;
}
