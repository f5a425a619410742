/**
 * A clip or a portrait on its way from a file to a vectorised medium. An item is
 * {key, path, file, upload, url, name, sent, broken, medium, job, error}: `sent` is the share uploaded while that goes
 * on, `broken` says that its connection is waited for, `medium` and `job` are what the service shows, `url` is the
 * file's own address within this tab.
 */

import { ask, isAbort, Problem } from "./api.js";
import { changed } from "./store.js";
import { Upload } from "./upload.js";
import { watch } from "./watch.js";

let number = 0;

/** An item of a file that was dropped or chosen. */
export function ofFile(path, file) {
  number += 1;
  return { key: `file-${number}`, path, file, upload: new Upload(path, file), url: URL.createObjectURL(file), name: file.name, sent: 0, medium: null, job: null, error: null };
}

/** An item of what was uploaded before. */
export function ofMedium(path, medium) {
  return { key: medium.id, path, file: null, url: null, name: medium.filename ?? medium.id, sent: null, medium, job: null, error: medium.error && new Problem(medium.error) };
}

export const isReady = (item) => item?.medium?.state === "ready";
export const isClip = (item) => item?.medium?.media?.kind ? item.medium.media.kind !== "image" : item?.file?.type.startsWith("video/") ?? true;

/** Whether what went wrong with an item may be tried again: what has failed needs its file for that. */
export const isTriable = (item) => Boolean(item.error && (item.file || item.again || item.medium?.state === "vectorizing"));

/** Upload the file, if there is one, and wait until it is vectorised. Errors stay in the item; true when it is ready. */
export async function bring(item) {
  item.error = null;
  try {
    if (item.medium?.state === "failed" && !item.file) throw new Problem(item.medium.error ?? {});
    if (!item.medium || item.medium.state === "failed") {
      item.canceling = new AbortController();
      Object.assign(item, { sent: 0, broken: false });
      changed();
      item.medium = await item.upload.send({
        signal: item.canceling.signal,
        onProgress: (sent, broken) => {
          Object.assign(item, { sent, broken });
          changed();
        },
      });
    }
    item.sent = null;
    changed();
    while (item.medium.state === "vectorizing") await vectorized(item); // again, when it was begun anew meanwhile
    if (item.medium.state === "failed") throw new Problem(item.medium.error ?? {});
  } catch (error) {
    item.sent = null;
    item.error = error;
    if (!(error instanceof Problem) && !isAbort(error)) console.error(error);
  }
  changed();
  return !item.error;
}

async function vectorized(item) {
  await watch(item.medium.job, (job) => {
    item.job = job;
    changed();
  });
  item.medium = await ask(`${item.path}/${item.medium.id}`);
}

/** Stop an upload or a vectorisation. */
export async function stop(item) {
  dropUpload(item);
  if (item.medium?.state === "vectorizing") await ask(`jobs/${item.medium.job}/cancel`, { method: "POST" });
}

/** Stop an upload that goes on or has broken, if there is one; the service keeps nothing of it. */
export function dropUpload(item) {
  if (item.sent !== null) item.canceling?.abort();
  item.upload?.drop();
}

/** What an item is doing, for people: {label, share}; null when it does nothing. */
export function doing(item) {
  if (item.sent !== null && item.sent !== undefined) {
    if (item.broken) return { label: "The connection broke; trying again", share: item.sent };
    return item.sent < 1 ? { label: "Uploading", share: item.sent } : { label: "Checking the file", share: null };
  }
  if (item.medium?.state !== "vectorizing") return null;
  const { job } = item;
  if (!job || job.state === "queued") return { label: "Waiting for a worker", share: null };
  const stages = { landmarks: "Looking for faces", "best frame": "Choosing the best frame", vectorize: "Vectorising", "second reading": "Reading once more" };
  const { stage, fraction, frames_done: done, frames_total: total } = job.progress;
  return { label: stages[stage] ?? "Preparing", share: fraction, frames: total > 1 ? `frame ${done} of ${total}` : "" };
}
