/** How results are written. */

import { isClip } from "./medium.js";
import { state } from "./store.js";

export const CLIP_FORMATS = [
  ["auto", "MP4, for the web", {}],
  ["hevc", "MP4, HEVC", { container: "mp4", codec: "hevc" }],
  ["av1", "MP4, AV1", { container: "mp4", codec: "av1" }],
  ["webm", "WebM, VP9", { container: "webm", codec: "vp9" }],
  ["prores", "MOV, ProRes 422 HQ", { container: "mov", codec: "prores" }],
  ["prores4444", "MOV, ProRes 4444", { container: "mov", codec: "prores4444" }],
  ["dnxhr", "MOV, DNxHR", { container: "mov", codec: "dnxhr" }],
  ["ffv1", "MKV, FFV1 (lossless)", { container: "mkv", codec: "ffv1" }],
];

export const PICTURE_FORMATS = [
  ["auto", "PNG, 16 bits", {}],
  ["tiff", "TIFF, 16 bits", { container: "tiff" }],
  ["jpg", "JPEG", { container: "jpg" }],
  ["webp", "WebP", { container: "webp" }],
];

export const formatsOf = (clip) => (clip && !isClip(clip) ? PICTURE_FORMATS : CLIP_FORMATS);

/** what a request need not say, and must not of pictures */
const USUAL = { codec: "auto", audio: "copy", matte: "ffv1" };

/** The request for the output of a job that was made before. */
export const outputAgain = ({ output }) =>
  Object.fromEntries(Object.entries(output).filter(([name, value]) => value !== null && value !== USUAL[name]));

/** `output` of POST /transfer. */
export function outputOf(clip) {
  const { format, extras } = state.output;
  const values = formatsOf(clip).find(([name]) => name === format)?.[2] ?? {};
  return { ...values, ...(extras.length ? { extras } : {}) };
}
