/** Pictures of media that the service draws: frames, layers, looks, posters, faces. They are kept for a while. */

import { call } from "./api.js";

const MOST_KEPT = 60;
/** Widths in steps, so that a window that grows a little does not ask for everything again. */
const STEP_PX = 320;
const WIDEST_PX = 1920;

const kept = new Map();

/** The address of a picture within this tab. The same `name` is not asked for twice. */
async function picture(name, ask) {
  let url = kept.get(name);
  if (url) {
    kept.delete(name); // back to the end: the oldest goes first
  } else {
    url = URL.createObjectURL(await (await ask()).blob());
    const twin = kept.get(name); // asked for meanwhile by another part of the page
    if (twin) {
      URL.revokeObjectURL(url);
      return twin;
    }
  }
  kept.set(name, url);
  for (const [oldest, old] of kept) {
    if (kept.size <= MOST_KEPT) break;
    kept.delete(oldest);
    URL.revokeObjectURL(old);
  }
  return url;
}

const got = (path, signal) => picture(path, () => call(path, { signal }));

/** Frame `n` of a clip with what was found in it: `layer` is landmarks, mask, matte or curves. */
export const layerOf = (video, n, layer, signal) => got(`videos/${video}/frames/${n}?layer=${layer}`, signal);

/** A frame of a medium that shows its largest face. */
export const poster = (path, id) => got(`${path}/${id}/poster`);

/** A face in a small square. */
export const faceOf = (path, id, index) => got(`${path}/${id}/faces/${index}/thumbnail`);

/** Frame `n` of a clip, with a look or, where that is null, as it is; no wider than `width` pixels of the screen. */
export function frame(video, n, look, width, signal) {
  const stepped = Math.min(WIDEST_PX, Math.max(STEP_PX, Math.ceil(width / STEP_PX) * STEP_PX));
  const json = { video, frame: n, max_width: stepped, ...(look ? { look } : {}) };
  return picture(JSON.stringify(json), () => call("preview", { method: "POST", json, signal }));
}

/** Pixels of the screen across an element. */
export const widthOf = (element) => Math.round(element.clientWidth * devicePixelRatio) || STEP_PX;

/** Forget every picture of a medium that is deleted. */
export function forget(id) {
  for (const [name, url] of kept) {
    if (!name.includes(id)) continue;
    kept.delete(name);
    URL.revokeObjectURL(url);
  }
}
