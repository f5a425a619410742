/**
 * The key of a service that wants one. It lives in this tab's session storage, goes out in the Authorization header
 * alone, and is never part of an address.
 */

const PLACE = "pvg-key";
/** what a header can carry; keys have even less */
const VISIBLE = /^[\x21-\x7e]+$/;
let asking = null;
const listeners = [];

/**
 * Tell `listener` whenever another key has come: what was fetched with the one before is not for it. One that gives
 * true loads the page anew; then nothing that waited for a key goes on.
 */
export const onNewKey = (listener) => listeners.push(listener);

export const key = () => sessionStorage.getItem(PLACE);

/** Forget a key that the service does not want any more, unless another one has come. What waited for one goes on. */
export function dropKey(old) {
  if (key() !== old) return;
  sessionStorage.removeItem(PLACE);
  document.getElementById("change-key").hidden = true;
}

/**
 * Ask for a key; `why` says what was wrong with the last one. The same question is not asked twice at a time. Where
 * one is `kept` meanwhile, the question may be left with that.
 */
export function askForKey(why = "", { kept = false } = {}) {
  asking ??= new Promise((resolve) => {
    const dialog = document.getElementById("key-dialog");
    const form = document.getElementById("key-form");
    const input = document.getElementById("key");
    const reason = document.getElementById("key-why");
    const leave = document.getElementById("keep-key");
    const say = (text) => {
      reason.textContent = text;
      reason.hidden = !text;
    };
    say(why);
    input.value = "";
    leave.hidden = !kept;
    leave.onclick = () => dialog.close();
    // without a key there is nothing to do: Escape leaves the question
    dialog.oncancel = (event) => { if (!kept) event.preventDefault(); };
    form.onsubmit = (event) => {
      if (VISIBLE.test(input.value.trim())) return;
      event.preventDefault();
      say("A key has letters, digits, _ and - alone. This text has others, or spaces; copy the key once more.");
      input.select();
    };
    const show = () => {
      dialog.returnValue = "";
      dialog.showModal();
      input.focus();
    };
    dialog.onclose = () => {
      const isGiven = dialog.returnValue === "use";
      if (!isGiven && !kept) {
        show(); // browsers let a second Escape through
        return;
      }
      const given = isGiven ? input.value.trim() : key();
      const isNew = given !== key();
      if (given !== null) sessionStorage.setItem(PLACE, given); // else it was dropped meanwhile
      input.value = "";
      if (isNew && listeners.some((listener) => listener())) return;
      asking = null;
      document.getElementById("change-key").hidden = given === null;
      resolve();
    };
    show();
  });
  return asking;
}
