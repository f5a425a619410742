/**
 * Jobs as they go on. Two of them are heard by events, at once; browsers open six connections to a host, and pictures
 * need some as well. One request asks for all the others, however many there are.
 */

import { ask, Problem } from "./api.js";
import { events } from "./events.js";

const MOST_STREAMS = 2;
const PAUSE_MS = 500;
const LONG_PAUSE_MS = 5000;
/** an answer that has not come by then does not come any more */
const LATE_MS = 30_000;

/** id → {seen, listeners, ended, resolve, reject, streamed} */
const watched = new Map();
let asking = false;

/**
 * Tell `onUpdate` of a job whenever it has changed; gives the job once it is done. Throws `Problem` when there is no
 * such job any more. Outages of the service are waited out.
 */
export function watch(id, onUpdate) {
  let entry = watched.get(id);
  if (!entry) {
    entry = { seen: "", listeners: new Set(), streamed: false, failures: 0 };
    entry.ended = new Promise((resolve, reject) => Object.assign(entry, { resolve, reject }));
    watched.set(id, entry);
  }
  if (onUpdate) entry.listeners.add(onUpdate);
  fill();
  return entry.ended;
}

function took(job) {
  const entry = watched.get(job.id);
  if (!entry) return;
  const seen = JSON.stringify(job);
  if (seen !== entry.seen) {
    entry.seen = seen;
    for (const listener of entry.listeners) listener(job);
  }
  if (!job.done) return;
  watched.delete(job.id);
  entry.resolve(job);
  fill();
}

function lost(id) {
  watched.get(id)?.reject(new Problem({ status: 404, title: "The job is gone", detail: "it was deleted with what it was made of" }));
  watched.delete(id);
}

/** Give free streams to those that have none, and ask for the rest. */
function fill() {
  let free = MOST_STREAMS - [...watched.values()].filter((one) => one.streamed).length;
  for (const [id, entry] of watched) {
    if (free <= 0) break;
    if (entry.streamed || entry.failures > 2) continue;
    free -= 1;
    listen(id, entry);
  }
  if (!asking && others().length) round();
}

const others = () => [...watched].filter(([, entry]) => !entry.streamed).map(([id]) => id);

async function listen(id, entry) {
  entry.streamed = true;
  try {
    for await (const job of events(`jobs/${id}/events`)) took(job);
  } catch (error) {
    if (error.status === 404) lost(id);
  }
  // a stream that ends before its job is asked for instead, and may be tried again
  entry.streamed = false;
  entry.failures += 1;
  if (watched.has(id)) fill();
}

async function round() {
  asking = true;
  let failures = 0;
  for (let ids = others(); ids.length; ids = others()) {
    try {
      const { data } = await ask(`jobs?id=${ids.slice(0, 200).join(",")}`, { signal: AbortSignal.timeout(LATE_MS) });
      failures = 0;
      data.forEach(took);
      const there = new Set(data.map((job) => job.id));
      ids.slice(0, 200).filter((id) => !there.has(id)).forEach(lost);
    } catch {
      failures += 1; // the service restarts, or the network is away: the jobs go on without us
    }
    await new Promise((resolve) => setTimeout(resolve, Math.min(LONG_PAUSE_MS, PAUSE_MS * 2 ** failures)));
  }
  asking = false;
}
