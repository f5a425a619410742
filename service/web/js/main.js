/** Puts the page together and fetches what was there before. */

import { askForKey, key, onNewKey } from "./key.js";
import { confirmed, failure } from "./notices.js";
import { listClips, readdress, reopen } from "./clip.js";
import { listJobs } from "./transfers.js";
import { listReferences, listReferencesAnew } from "./references.js";
import { mountPanel } from "./panel.js";
import { mountQueue } from "./queue.js";
import { mountService } from "./service.js";
import { mountStage } from "./stage.js";
import { mountTray } from "./tray.js";
import { state } from "./store.js";

mountService();
mountStage();
mountTray();
mountPanel();
mountQueue();

// a file that misses its target must not replace the page
for (const kind of ["dragover", "drop"]) window.addEventListener(kind, (event) => event.preventDefault());

// what nobody else has told of: a list that could not be read again
window.addEventListener("unhandledrejection", (event) => {
  event.preventDefault();
  failure(event.reason);
});

// a bookmark of another clip, in this same tab, or the way back and forth between those that were here
window.addEventListener("hashchange", () => readdress(begin));

const uploads = () => [state.clip, ...state.references].some((one) => one && one.sent !== null);
let leaves = false;

// what is being uploaded goes with the page: the browser asks first
window.addEventListener("beforeunload", (event) => {
  if (uploads() && !leaves) event.preventDefault();
});

let lists = false;

/** What another page, or another program, has had made meanwhile. */
async function listAnew() {
  if (lists || document.hidden || !state.listed) return;
  lists = true;
  // nobody asked: what is shown stays, and the head of the page says when the service is away
  await Promise.all([listClips(), listReferencesAnew(), listJobs()]).catch(() => undefined);
  lists = false;
}

document.addEventListener("visibilitychange", listAnew);
window.addEventListener("focus", listAnew);

const change = document.getElementById("change-key");
change.hidden = !key();
change.addEventListener("click", async () => {
  if (uploads() && !(await confirmed("Change the key?", "What is being uploaded is dropped: with another key the page begins anew.", "Change"))) return;
  await askForKey("", { kept: true });
});

// what is shown, and the clip in the address, are of the key before
onNewKey(() => {
  if (!state.clip && !state.listed && !state.clips.length && !state.references.length) return false;
  history.replaceState(null, "", location.pathname + location.search);
  leaves = true; // that was asked
  location.reload();
  return true;
});

/** Fetch all of it; what fails is told once, and the clip has its own "Try again". */
async function begin() {
  let told = false;
  const tried = (work) => work.catch((error) => {
    if (!told) failure(error);
    told = true;
  });
  await tried(listClips()); // asks for a key first, where one is wanted
  await Promise.all([tried(listReferences()), tried(reopen(begin))]);
  await tried(listJobs());
}

await begin();
document.documentElement.dataset.ready = "";
