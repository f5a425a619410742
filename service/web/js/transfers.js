/** Transfers: started, watched, canceled, their files fetched. */

import { address, ask, call, page } from "./api.js";
import { announce, failure, notice } from "./notices.js";
import { outputAgain, outputOf } from "./output.js";
import { chosen, lookAgain, lookOf } from "./references.js";
import { changed, state } from "./store.js";
import { key } from "./key.js";
import { watch } from "./watch.js";
import { count } from "./format.js";

const SHOWN = 20;

let listings = 0;

/** The jobs of the clip on the stage, or of all clips while there is none. One that is not known yet has none. */
export async function listJobs() {
  const video = state.clip?.medium?.id;
  if (state.clip && !video) return;
  const before = new Set(state.jobs.map((job) => job.id));
  const listing = ++listings;
  const { data, next_cursor: next } = await page(listOf(video), Math.max(SHOWN, state.jobs.length));
  // another clip came meanwhile, or what was asked for later is answered already
  if (video !== state.clip?.medium?.id || listing !== listings) return;
  // asked for after the service had read the list
  const there = new Set(data.map((job) => job.id));
  const newest = new Date(data[0]?.created_at ?? 0);
  const since = state.jobs.filter(({ id, created_at: made }) => !before.has(id) && !there.has(id) && new Date(made) >= newest);
  listed([...since, ...data], next);
}

/** The jobs that come after those of the list. */
export async function moreJobs() {
  const { jobs: cursor } = state.more;
  const { data, next_cursor: next } = await page(listOf(state.clip?.medium?.id), SHOWN, cursor);
  if (state.more.jobs === cursor) listed([...state.jobs, ...data], next); // else it was listed anew
}

const listOf = (video) => `jobs?kind=transfer&kind=swap${video ? `&video=${video}` : ""}`;

function listed(jobs, next) {
  Object.assign(state, { jobs, listed: true });
  state.more.jobs = next;
  changed();
  jobs.filter((job) => !job.done).forEach(follow);
}

function put(job) {
  const at = state.jobs.findIndex((one) => one.id === job.id);
  if (state.jobs[at]?.done && !job.done) return; // an answer that was slower than the events
  if (at >= 0) state.jobs[at] = job;
  changed();
}

/** id → the end of a job that is followed */
const followed = new Map();

/** Show a job as it goes on, and tell of its end once, however often it is listed meanwhile. */
function follow(job) {
  if (!followed.has(job.id)) followed.set(job.id, toItsEnd(job).finally(() => followed.delete(job.id)));
  return followed.get(job.id);
}

async function toItsEnd(job) {
  try {
    const done = await watch(job.id, put);
    if (done.state === "succeeded") announce(`${count(done.looks.length, "look")} finished`);
    if (done.state === "failed") announce(`The rendering failed. ${done.error?.title ?? ""}`, { urgent: true });
    return done;
  } catch (error) {
    if (error.status !== 404) failure(error);
    state.jobs = state.jobs.filter((one) => one.id !== job.id);
    changed();
    return null;
  }
}

/** Put a job of a clip first in the queue, unless that is another clip's by now, and wait for its end. */
function add(job, video) {
  if (!state.clip || state.clip.medium?.id === video) {
    state.jobs = [job, ...state.jobs.filter((one) => one.id !== job.id)];
    changed();
  }
  return follow(job);
}

/** Render the chosen portraits on the clip. */
export async function start() {
  const { clip } = state;
  const looks = chosen().map(lookOf);
  let job;
  try {
    job = await ask("transfer", { method: "POST", json: { video: clip.medium.id, looks, output: outputOf(clip) } });
  } catch (error) {
    failure(error, "The rendering was not started");
    return;
  }
  if (job.done) notice("This was rendered before; its result is in the queue");
  else if (state.jobs.some((one) => one.id === job.id)) notice("This is in the queue already");
  else announce(`Rendering ${count(looks.length, "look")}`);
  await add(job, clip.medium.id);
}

/** Make a job that has ended once more, as it was asked for. */
export async function again(job) {
  const looks = job.looks.map(lookAgain);
  const { video } = job.looks[0];
  try {
    await add(await ask("transfer", { method: "POST", json: { video, looks, output: outputAgain(job), force: true } }), video);
  } catch (error) {
    failure(error, "The rendering was not started again");
  }
}

export async function cancel(job) {
  try {
    put(await ask(`jobs/${job.id}/cancel`, { method: "POST" }));
    announce("Canceled");
  } catch (error) {
    if (error.status !== 409) failure(error, "The job was not canceled"); // else it has just ended
  }
}

/** path → a promise of the address of its blob, of a service that wants a key and makes no links; see `release` */
const held = new Map();
/** for which the browser has time to begin to save a blob */
const SAVED_MS = 60_000;
/** results that are being saved: their blobs stay for SAVED_MS, whoever else lets go of them */
const saving = new Set();

/** Let go of the files of a result that are in blobs. */
export function release(id) {
  if (saving.has(id)) return;
  for (const [path, blob] of held) {
    if (!`${path}/`.startsWith(`results/${id}/`)) continue;
    held.delete(path);
    blob.then((url) => URL.revokeObjectURL(url), () => undefined);
  }
}

/**
 * An address that a player or a download can use by itself. Without keys it is the file's own; else a link that is
 * signed for a while, so that the key is in no address; or a blob, where the service makes no links to itself.
 */
async function fileUrl(id, part = null, person = 1) {
  const path = part ? `results/${id}/${part}?person=${person}` : `results/${id}`;
  if (!key()) return address(path);
  if (held.has(path)) return held.get(path);
  try {
    const { url } = await ask(`results/${id}/link`, { method: "POST", json: part ? { part, person } : {} });
    const link = new URL(url, location.href);
    if (link.origin === location.origin) return link.href;
  } catch (error) {
    if (![404, 405].includes(error.status)) throw error;
  }
  if (!held.has(path)) hold(path); // else another asked meanwhile
  return held.get(path);
}

function hold(path) {
  const blob = blobUrl(path);
  held.set(path, blob);
  // what failed is tried again by the next who asks
  blob.catch(() => held.get(path) === blob && held.delete(path));
}

const blobUrl = async (path) => URL.createObjectURL(await (await call(path)).blob());

export const resultUrl = (id) => fileUrl(id);

/** Whether an address still leads to its file, as a link does for an hour; "away" when nobody answers. */
export async function isGood(url) {
  if (url.startsWith("blob:")) return true;
  try {
    return (await fetch(url, { method: "HEAD", credentials: "omit", cache: "no-store" })).ok;
  } catch {
    return "away"; // another link would not help
  }
}

/** The same of the file of a clip as it was uploaded. There are no links to these: with keys it is a blob, to be revoked. */
export async function uploadedUrl(id) {
  const path = `videos/${id}/file`;
  return key() ? blobUrl(path) : address(path);
}

/** Have the browser keep a file; the service names it, but of a blob we do. */
function save(url, name) {
  const link = document.createElement("a");
  Object.assign(link, { href: url, download: name });
  link.click();
}

export async function download(look) {
  saving.add(look.result);
  try {
    save(await fileUrl(look.result), look.result);
    for (const { part, person } of look.extras) save(await fileUrl(look.result, part, person), `${look.result}-${person}-${part}`);
  } catch (error) {
    failure(error, "The file could not be fetched");
  }
  setTimeout(() => {
    saving.delete(look.result);
    if (state.compared?.look.result !== look.result) release(look.result);
  }, SAVED_MS);
}

/** Every file of a job, one after another: browsers ask once whether a page may. */
export async function downloadAll(job) {
  const kept = job.looks.filter((look) => look.content_type);
  for (const look of kept) {
    await download(look);
    await new Promise((resolve) => setTimeout(resolve, 300));
  }
  announce(`${count(kept.length, "download")} started`);
}
