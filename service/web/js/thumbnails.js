/** Small pictures of media. Until the service has one, or if it cannot be had, the colour of the skin stands for it. */

import { el } from "./dom.js";
import { faceOf, poster } from "./frames.js";

const PAUSE_MS = 5000;
const LONGEST_PAUSE_MS = 60_000;

/** A picture that fills its place; `find` gives its address, and is asked again later when it fails. */
function pictured(kind, skin, find) {
  const holder = el("span", { class: kind });
  const image = el("img", { alt: "", decoding: "async" });
  image.addEventListener("load", () => holder.classList.add("loaded"));
  image.addEventListener("error", () => image.remove());
  holder.append(image);
  if (skin) holder.style.setProperty("--skin", `rgb(${skin.map((value) => Math.round(value)).join(" ")})`);
  const show = async (pause = PAUSE_MS) => {
    try {
      const url = await find();
      if (url) image.src = url;
    } catch (error) {
      if (error.status === 404) return; // it is deleted
      setTimeout(() => holder.isConnected && show(Math.min(2 * pause, LONGEST_PAUSE_MS)), pause);
    }
  };
  show();
  return holder;
}

/** The picture of a medium as a whole; `url` is that of a file of this tab, which is nearer. */
export function thumbnail(path, medium, url = null) {
  return pictured("thumb", medium?.faces?.[0]?.skin_rgb, () => url ?? (medium?.state === "ready" ? poster(path, medium.id) : null));
}

/** The picture of one face. */
export function faceThumbnail(path, medium, face, kind = "face") {
  return pictured(kind, face.skin_rgb, () => faceOf(path, medium.id, face.index));
}
