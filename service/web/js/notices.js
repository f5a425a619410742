/** What the page tells: short messages that go by themselves, errors that stay until they are closed. */

import { el, iconButton, icon } from "./dom.js";
import { isAbort } from "./api.js";

const SHOWN_MS = 6000;
const MOST_SHOWN = 4;

/** Say something to a screen reader alone. */
export function announce(text, { urgent = false } = {}) {
  const region = document.getElementById(urgent ? "assertive" : "polite");
  // the same words twice are news as well
  region.textContent = region.textContent === text ? `${text}\u00a0` : text;
}

export function notice(text) {
  show(el("p", {}, text), "");
  announce(text);
}

/** Show an error; what was canceled is none. `doing` begins the sentence: "The upload of clip.mp4 failed". */
export function failure(error, doing = "") {
  if (isAbort(error)) return;
  const title = error.title ?? "Something went wrong on this page";
  const detail = error.detail ?? error.message ?? "";
  const body = el("div", {}, el("p", { class: "strong" }, doing || title), el("p", {}, doing ? [title, detail].filter(Boolean).join(": ") : detail));
  if (error.requestId) body.append(el("p", { class: "quiet" }, `Request ${error.requestId}`));
  show(body, "error");
  announce(`${doing} ${title}. ${detail}`, { urgent: true });
  if (!error.title) console.error(error);
}

/** Something was dropped that is no file. */
export const noFile = () =>
  failure({ title: "That was no file", detail: "Drag a clip or a picture from a folder to here, or choose one with the button" });

function show(body, kind) {
  const list = document.getElementById("toasts");
  const toast = el("div", { class: `toast ${kind}` }, icon(kind ? "warn" : "check"), body);
  toast.append(iconButton("cross", "Close this message", () => {
    toast.remove();
    (list.querySelector("button") ?? document.getElementById("stage")).focus({ preventScroll: true });
  }));
  list.append(toast);
  while (list.children.length > MOST_SHOWN) list.firstElementChild.remove();
  if (!kind) setTimeout(() => toast.remove(), SHOWN_MS);
}

/** Ask before something goes for good. */
export function confirmed(title, text, yes = "Delete") {
  const dialog = document.getElementById("confirm");
  document.getElementById("confirm-title").textContent = title;
  document.getElementById("confirm-text").textContent = text;
  document.getElementById("confirm-yes").textContent = yes;
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}
