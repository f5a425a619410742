/**
 * What the media of looks are called. Those that are in no list of this page are looked for in the service's own, which
 * also says which are gone, without a request for each.
 */

import { page } from "./api.js";
import { changed, state } from "./store.js";

const PAGE = 200;
const GONE = "a portrait that is no longer here";

/** names by id, of media that are in no list of this page */
const names = new Map();
/** ids of media that are looked for */
const wanted = new Set();
let looking = false;

/** The file's name of a medium that colours are taken from; undefined until it is found. */
export function knownName(id) {
  const portrait = state.references.find((one) => one.medium?.id === id);
  if (portrait) return portrait.name;
  const clip = state.clips.find((one) => one.id === id);
  if (clip) return clip.filename ?? id;
  if (state.deleted.has(id)) return "a deleted portrait";
  if (!names.has(id)) {
    wanted.add(id);
    if (!looking) lookFor();
  }
  return names.get(id);
}

/** The same, or words in its place. */
export const nameOf = (id) => knownName(id) ?? "a portrait that is not listed here";

async function lookFor() {
  looking = true;
  await null; // all that are asked for in this turn
  const ids = [...wanted];
  wanted.clear();
  try {
    const clips = ids.filter((id) => id.startsWith("vid_"));
    await findIn("references", ids.filter((id) => !clips.includes(id)));
    await findIn("videos", clips);
    changed();
  } catch {
    // nobody asked: they are looked for when they are shown again, and the head of the page says what is wrong
  } finally {
    looking = false;
  }
}

/** Go through a list, newest first, as ids are, until it has passed all of them. */
async function findIn(path, ids) {
  if (!ids.length) return;
  const oldest = ids.reduce((one, other) => (one < other ? one : other));
  for (let cursor = null, passed = false; !passed;) {
    const { data, next_cursor: next } = await page(path, PAGE, cursor);
    for (const medium of data) names.set(medium.id, medium.filename ?? medium.id);
    cursor = next;
    passed = !next || data.at(-1).id <= oldest;
  }
  for (const id of ids) if (!names.has(id)) names.set(id, GONE);
}
