/** The stage shows one of four things: a place to drop a clip, the clip on its way, the clip with a look, a result. */

import { el, fileButton, icon, iconButton, say, takesFiles } from "./dom.js";
import { lengthOf } from "./format.js";
import { CLIP_TYPES, close, openClipOf, openFiles, remove } from "./clip.js";
import { Comparing } from "./comparing.js";
import { Editing } from "./editing.js";
import { isReady } from "./medium.js";
import { noFile } from "./notices.js";
import { changed, onChange, state } from "./store.js";
import { OnTheWay } from "./on-the-way.js";
import { download } from "./transfers.js";
import { Welcome } from "./welcome.js";

const picture = document.getElementById("picture");
const bar = document.getElementById("transport");
const choices = document.getElementById("choices");

let view = null;
let shown = "";

function wanted() {
  const { clip, compared } = state;
  if (compared) return [`compare ${compared.look.result}`, () => new Comparing({ bar, choices, compare }, compared)];
  if (!clip) return ["welcome", () => new Welcome()];
  if (!isReady(clip)) return [`way ${clip.key}`, () => new OnTheWay(clip)];
  return [`edit ${clip.medium.id}`, () => new Editing({ bar, choices }, clip)];
}

function show() {
  const stage = document.getElementById("stage");
  const hadFocus = stage.contains(document.activeElement);
  const [name, make] = wanted();
  if (name !== shown) {
    view?.close?.();
    for (const part of [bar, choices]) {
      part.hidden = true;
      part.replaceChildren();
    }
    shown = null; // what cannot be made is tried again
    view = make();
    shown = name;
    picture.replaceChildren(view.element);
  }
  view.update?.();
  head();
  // what had the focus may have gone or be hidden
  const now = document.activeElement;
  if (hadFocus && !(stage.contains(now) && now.checkVisibility())) stage.focus({ preventScroll: true });
}

function facts(media) {
  if (!media) return "";
  const parts = [`${media.width}×${media.height}`];
  if (media.frame_count > 1) parts.push(`${Number(media.frame_rate.toFixed(2))} fps`);
  parts.push(lengthOf(media));
  if (media.codec) parts.push(media.codec.toUpperCase());
  if (media.color) parts.push(media.color);
  return parts.join(" · ");
}

const tools = document.getElementById("stage-tools");
const cross = iconButton("cross", "", () => close());
const bin = iconButton("bin", "Delete the clip from the service", () => remove(state.clip.medium));

function head() {
  const { clip, compared } = state;
  document.getElementById("stage").classList.toggle("bare", !clip && !compared);
  const title = document.getElementById("stage-name");
  say(title, clip ? clip.name : compared ? "Finished look" : "Clip");
  title.title = clip?.name ?? "";
  say(document.getElementById("stage-facts"), facts(clip?.medium?.media));
  bin.hidden = !clip?.medium; // there is nothing to delete yet
  cross.title = clip?.medium ? "Close the clip; it stays with the service" : "Close the clip; what is not uploaded yet is dropped";
  cross.ariaLabel = cross.title;
  const kind = compared ? "compare" : clip ? "clip" : "none";
  if (tools.dataset.kind === kind) return;
  tools.dataset.kind = kind;
  tools.replaceChildren();
  if (compared) {
    tools.append(
      el("button", { type: "button", onclick: () => download(state.compared.look) }, icon("down"), "Download"),
      el("button", { type: "button", onclick: () => leaveComparison() }, "Back to the look"),
    );
  }
  if (!clip || compared) return;
  tools.append(
    ...fileButton("Another clip", { accept: CLIP_TYPES, take: openFiles }),
    cross,
    bin,
  );
}

/** Show a finished look beside its clip, which comes to the stage first. */
export async function compare(job, look) {
  // who goes through the looks by arrow keys stays among them
  const byKeys = choices.querySelector(":focus-visible");
  if (!(await openClipOf(look))) return;
  state.compared = { job, look };
  changed();
  await null; // it is shown by then
  const focused = (byKeys && choices.querySelector(":checked")) ?? document.getElementById("stage");
  focused.focus({ preventScroll: true });
  window.scrollTo({ top: 0 });
}

function leaveComparison() {
  state.compared = null;
  changed();
  document.getElementById("stage").focus();
}

/** what has every key for itself, and what is pressed by Space */
const WRITES = "textarea, select, input:not([type=range], [type=checkbox], [type=radio])";
const PRESSED = "button, a, summary, input:not([type=range])";

/**
 * Space plays, wherever the focus is; comma and full stop go by frames while it is on the stage, so that nobody who
 * types or dictates elsewhere steps by mistake (WCAG 2.2, 2.1.4). What has the focus may need the key itself.
 */
function keys(event) {
  const on = (selector) => event.target.closest?.(selector);
  if (event.ctrlKey || event.metaKey || event.altKey || on(WRITES) || document.querySelector("dialog[open]")) return;
  const isSpace = event.key === " ";
  if (isSpace ? on(PRESSED) : !on("#stage")) return;
  const [act, by] = { " ": ["toggle"], ",": ["step", -1], ".": ["step", 1] }[event.key] ?? [];
  if (!view[act]) return;
  event.preventDefault();
  if (!isSpace || !event.repeat) view[act](by);
}

export function mountStage() {
  const stage = document.getElementById("stage");
  takesFiles(stage, openFiles, noFile);
  document.addEventListener("keydown", keys);
  // followed, the link would take the place of the clip in the address
  document.querySelector(".skip").addEventListener("click", (event) => {
    event.preventDefault();
    stage.focus();
  });
  // on a phone the picture stays in sight while the rest goes by: what is above it may leave
  const above = () => picture.getBoundingClientRect().top - stage.getBoundingClientRect().top;
  new ResizeObserver(() => stage.style.setProperty("--above", `${above()}px`)).observe(stage);
  onChange(show);
}
