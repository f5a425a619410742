/**
 * The portraits of the tray. An item of medium.js with `included`, whether it is rendered, and `settings`, how its
 * colours are put on the clip; their names and ranges are those of `looks[]` of POST /transfer. One that is being
 * deleted is `leaving`.
 */

import { ask, page } from "./api.js";
import { forget } from "./frames.js";
import { bring, isReady, ofFile, ofMedium, stop } from "./medium.js";
import { announce, confirmed, failure, notice } from "./notices.js";
import { changed, selectedReference, state } from "./store.js";
import { listJobs } from "./transfers.js";

const PATH = "references";
const SHOWN = 24;

export const DEFAULTS = Object.freeze({
  strength: 1,
  contrast: "auto",
  makeup: 0.75,
  light: 0,
  scene: 1,
  extent: "skin",
  match: "semantic",
  protect: ["eyes", "teeth"],
  faces: "all",
  reference_face: null,
});

const fresh = () => structuredClone({ ...DEFAULTS });

/** A look of POST /transfer and POST /preview. */
export function lookOf(item) {
  const { reference_face: face, ...settings } = item.settings;
  return { reference: item.medium.id, ...settings, ...(face === null ? {} : { reference_face: face }) };
}

/** The request for a look that was rendered before. */
export const lookAgain = ({ reference, options }) => ({ reference, ...options });

export async function addFiles(files) {
  const items = files.map((file) => ({ ...ofFile(PATH, file), included: true, settings: fresh() }));
  const before = state.selected;
  state.references.unshift(...items);
  state.selected = items[0]?.key ?? state.selected;
  changed();
  announce(items.length === 1 ? `Uploading ${items[0].name}` : `Uploading ${items.length} portraits`);
  await Promise.all(items.map(async (item) => {
    if (!(await arrive(item))) fallBack(item, items, before);
  }));
}

/** What cannot be used does not stay selected: another one of those that came with it is, or what was before. */
function fallBack(item, others, before) {
  if (state.selected !== item.key) return;
  const usable = (one) => state.references.includes(one) && !one.error;
  const next = others.find(usable) ?? state.references.find((one) => one.key === before && usable(one));
  if (!next) return;
  state.selected = next.key;
  changed();
}

async function arrive(item) {
  const ready = await bring(item);
  if (item.medium) dropTwin(item);
  if (item.leaving || !state.references.includes(item)) return ready;
  if (ready) {
    announce(`${item.name} is ready`);
  } else {
    item.included = false;
    if (item.error) announce(`${item.name} could not be used. ${item.error.text ?? ""}`, { urgent: true });
  }
  changed();
  return ready;
}

/** The same picture uploaded again is the same reference: one card is enough. */
function dropTwin(item) {
  if (!state.references.includes(item)) return; // its twin was ready first
  const twins = state.references.filter((one) => one !== item && one.medium?.id === item.medium.id);
  state.references = state.references.filter((one) => !twins.includes(one));
  for (const twin of twins) {
    if (twin.url) URL.revokeObjectURL(twin.url);
    if (state.selected === twin.key) state.selected = item.key;
  }
}

export const retry = (item) => {
  item.included = true;
  return arrive(item);
};

/** The stage goes from a finished look to the one that is chosen or changed now. */
const toTheStage = () => { if (state.clip) state.compared = null; };

export function select(key) {
  state.selected = key;
  toTheStage();
  changed();
}

export function include(item, on) {
  item.included = on;
  if (on) state.selected = item.key;
  changed();
}

/** Change settings of the selected portrait. */
export function set(values) {
  const item = selectedReference();
  if (!item) return;
  Object.assign(item.settings, values);
  toTheStage();
  changed();
}

export function reset() {
  set(fresh());
}

/** Give all portraits the settings of the selected one, but for the face that is taken of each. */
export function setAll() {
  const from = selectedReference();
  if (!from) return;
  const { reference_face: _, ...shared } = from.settings;
  for (const item of state.references) Object.assign(item.settings, structuredClone(shared));
  notice("All portraits have these settings now");
  changed();
}

export async function remove(item) {
  if (item.medium) {
    const sure = await confirmed(`Delete ${item.name}?`, "The portrait, what was found in it and every result made with it are removed from the service for good.");
    if (!sure) return;
    item.leaving = true; // the end of its job is no news
    try {
      await ask(`${PATH}/${item.medium.id}?cancel_jobs=true`, { method: "DELETE" });
    } catch (error) {
      if (error.status !== 404) {
        item.leaving = false;
        failure(error, `${item.name} was not deleted`);
        return;
      }
    }
    forget(item.medium.id);
    state.deleted.add(item.medium.id);
  } else {
    item.leaving = true;
    await stop(item);
  }
  takeAway(item);
  if (item.medium) await listJobs();
}

function takeAway(item) {
  if (item.url) URL.revokeObjectURL(item.url);
  const at = state.references.indexOf(item);
  state.references = state.references.filter((one) => one !== item);
  if (state.selected === item.key) state.selected = state.references[Math.min(at, state.references.length - 1)]?.key ?? null;
  changed();
}

/**
 * The newest of the portraits that were uploaded before, or those that come after `cursor`; they are not rendered until
 * they are chosen.
 */
export async function listReferences(cursor = null) {
  const { data, next_cursor: next } = await page(PATH, SHOWN, cursor);
  state.references.push(...unknown(data));
  state.more.references = next;
  selectAny();
}

/** As another page, or another program, has left them: portraits that are new come first, those that were deleted go. */
export async function listReferencesAnew() {
  const before = state.references.filter((one) => one.medium);
  const { data, next_cursor: next } = await page(PATH, SHOWN);
  const listed = new Set(data.map(({ id }) => id));
  const isOnPage = ({ id }) => !next || id >= data.at(-1).id; // ids are in the order of the list
  for (const item of before) {
    if (item.leaving || listed.has(item.medium.id) || !isOnPage(item.medium)) continue;
    forget(item.medium.id);
    state.deleted.add(item.medium.id);
    takeAway(item);
  }
  state.references.unshift(...unknown(data));
  selectAny();
}

/** Items of the media that are not in the tray yet. */
function unknown(media) {
  const known = new Set(state.references.map((one) => one.medium?.id));
  const items = media
    .filter(({ id }) => !known.has(id) && !state.deleted.has(id))
    .map((medium) => ({ ...ofMedium(PATH, medium), included: false, settings: fresh() }));
  items.filter(({ medium }) => medium.state === "vectorizing").forEach(bring);
  return items;
}

function selectAny() {
  state.selected ??= state.references.find((one) => !one.error)?.key ?? null;
  changed();
}

export const chosen = () => state.references.filter((one) => one.included && isReady(one));
export const onTheWay = () => state.references.filter((one) => one.included && !one.error && !isReady(one));
