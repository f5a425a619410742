/** The clip on the stage: put there from a file or from what was uploaded before, and taken away. */

import { ask, page } from "./api.js";
import { forget } from "./frames.js";
import { bring, dropUpload, ofFile, ofMedium, stop } from "./medium.js";
import { announce, confirmed, failure, notice } from "./notices.js";
import { changed, state } from "./store.js";
import { listJobs } from "./transfers.js";
import { watch } from "./watch.js";

/** what a file chooser offers */
export const CLIP_TYPES = "video/*,image/*,.mkv,.mov,.mp4,.webm,.avi,.tif,.tiff";

const PATH = "videos";
const SHOWN = 6;

/**
 * The address names the clip, so that a reload finds it again, and Back what was here before; where that is `gone` there is
 * no way back to it. Ids open nothing without the key.
 */
function remember(id, { gone = false } = {}) {
  const hash = id ? `#${id}` : "";
  if (location.hash === hash) return;
  const address = hash || location.pathname + location.search;
  if (gone) history.replaceState(null, "", address);
  else history.pushState(null, "", address);
}

/** The first of the files that were dropped or chosen takes the place of the clip that is there. */
export async function openFiles([file, ...others]) {
  if (others.length) notice("One clip at a time; portraits go into the tray below");
  const item = ofFile(PATH, file);
  put(item);
  announce(`Uploading ${item.name}`);
  await arrive(item);
}

export async function openMedium(medium) {
  const item = ofMedium(PATH, medium);
  put(item, medium.id);
  await arrive(item);
}

/** the look that was asked for last: it alone is shown */
let sought = null;

/**
 * Have the clip of a finished look on the stage. False when it cannot be had, which is told, or when something else
 * was opened meanwhile.
 */
export async function openClipOf(look) {
  sought = look;
  const before = state.clip;
  if (before?.medium?.id === look.video) return true;
  const isLate = () => sought !== look || state.clip !== before;
  let medium;
  try {
    medium = await ask(`${PATH}/${look.video}`);
  } catch (error) {
    if (isLate()) return false;
    if (error.status === 404) notice("The clip of this result is no longer here; the result went with it");
    else failure(error, "The result could not be shown");
    await Promise.all([listClips(), listJobs()]);
    return false;
  }
  if (isLate()) return false;
  openMedium(medium); // one that is vectorised again takes its time
  return true;
}

async function arrive(item) {
  const ready = await bring(item);
  if (state.clip !== item) return;
  remember(item.medium?.id);
  if (ready) announce(`${item.name} is ready`);
  else if (item.error) announce(`${item.name} could not be used. ${item.error.text ?? ""}`, { urgent: true });
  if (item.medium) await listJobs();
}

/** `id` is what the address names from now on, in one step: a reload may come at any time. */
function put(item, id = null) {
  clear(id);
  // those that were chosen are of the clip before
  for (const { settings } of state.references) settings.faces = "all";
  Object.assign(state, { clip: item, jobs: [], listed: false });
  changed();
}

/** Take the clip off the stage; it stays with the service, unless it is `gone`, and can be opened again. */
export async function close({ gone = false } = {}) {
  clear(null, { gone });
  await Promise.all([listClips(), listJobs()]);
}

/** Try a failed clip once more. */
export function retry(item) {
  if (!item.again) return arrive(item);
  item.error = null;
  changed();
  return item.again();
}

function clear(id = null, { gone = false } = {}) {
  const { clip } = state;
  if (clip?.url) URL.revokeObjectURL(clip.url);
  if (clip) dropUpload(clip);
  Object.assign(state, { clip: null, compared: null });
  state.more.jobs = null;
  remember(id, { gone });
  changed();
}

export async function cancel(item) {
  try {
    await stop(item);
    if (state.clip === item) clear();
    notice(`${item.name} was stopped`);
  } catch (error) {
    failure(error, `${item.name} could not be stopped`);
  }
  await Promise.all([listClips(), listJobs()]);
}

/** Remove a clip and all that was made of it from the service. */
export async function remove(medium) {
  const name = medium.filename ?? medium.id;
  const sure = await confirmed(`Delete ${name}?`, "The clip, what was found in it and every result made with it are removed from the service for good.");
  if (!sure) return;
  try {
    await ask(`${PATH}/${medium.id}?cancel_jobs=true`, { method: "DELETE" });
  } catch (error) {
    if (error.status !== 404) { // else somebody else has deleted it
      failure(error, `${name} was not deleted`);
      return;
    }
  }
  forget(medium.id);
  state.deleted.add(medium.id);
  if (state.clip?.medium?.id === medium.id) clear(null, { gone: true });
  notice(`${name} was deleted`);
  await Promise.all([listClips(), listJobs()]);
}

/** The newest clips, as many as are shown. */
export async function listClips() {
  const { data, next_cursor: next } = await page(PATH, Math.max(SHOWN, state.clips.length));
  listed(data, next);
}

/** The clips that come after those of the list. */
export async function moreClips() {
  const { clips: cursor } = state.more;
  const { data, next_cursor: next } = await page(PATH, SHOWN, cursor);
  if (state.more.clips === cursor) listed([...state.clips, ...data], next); // else it was listed anew
}

function listed(clips, next) {
  state.clips = clips;
  state.more.clips = next;
  changed();
  clips.filter((one) => one.state === "vectorizing").forEach(follow);
}

/** ids of the clips of the list whose end is waited for */
const followed = new Set();

/** Show in the list what becomes of a clip that is on its way. */
async function follow({ id, job }) {
  if (followed.has(id)) return;
  followed.add(id);
  try {
    await watch(job);
    const now = await ask(`${PATH}/${id}`);
    state.clips = state.clips.map((one) => (one.id === id ? now : one));
  } catch (error) {
    if (error.status !== 404) throw error;
    state.clips = state.clips.filter((one) => one.id !== id);
  } finally {
    followed.delete(id);
  }
  changed();
}

/** Show what the address names by now, as after Back: a clip, or none. What is being uploaded is dropped if that is wanted. */
export async function readdress(again) {
  const { clip } = state;
  if (clip && clip.sent !== null && !(await confirmed("Stop the upload?", `${clip.name} is not there whole yet.`, "Stop it"))) {
    if (state.clip === clip) remember(clip.medium?.id);
    return;
  }
  if (!location.hash && state.clip) await close();
  else await reopen(again);
}

/**
 * The clip that the address names, if there is one and it is still there. While the service cannot say, the address
 * keeps it, and the stage offers `again`.
 */
export async function reopen(again) {
  const id = location.hash.slice(1);
  if (!/^vid_\w+$/.test(id) || id === state.clip?.medium?.id) return;
  const before = state.clip;
  const isLate = () => state.clip !== before || location.hash !== `#${id}`; // another clip came, or another address
  let medium;
  try {
    medium = await ask(`${PATH}/${id}`);
  } catch (error) {
    if (isLate()) return;
    if (error.status === 404) {
      notice("This clip is no longer here");
      await close({ gone: true });
      return;
    }
    put({ ...ofMedium(PATH, { id, filename: "Clip" }), medium: null, error, again }, id);
    return;
  }
  if (!isLate()) await openMedium(medium);
}
