/** Uploads with their progress, which `fetch` does not tell. */

import { address, authorization, changeKey, onceKey, problemOf, silence } from "./api.js";
import { key } from "./key.js";

/**
 * Send a file to `/videos` or `/references` and give the medium. `onProgress` gets the share sent, 0–1.
 * Throws `Problem`, or an AbortError when `signal` says so.
 */
export async function upload(path, file, { onProgress, signal }) {
  const once = onceKey();
  for (;;) {
    const used = key();
    const { status, text } = await send(path, file, { once, onProgress, signal });
    if (status === 200 || status === 202) return JSON.parse(text);
    if (status !== 401) throw problemOf(status, text);
    await changeKey(used);
  }
}

function send(path, file, { once, onProgress, signal }) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", address(path));
    for (const [name, value] of Object.entries(authorization())) request.setRequestHeader(name, value);
    request.setRequestHeader("Idempotency-Key", once);
    request.upload.addEventListener("progress", (event) => {
      if (event.lengthComputable) onProgress?.(event.loaded / event.total);
    });
    request.addEventListener("load", () => resolve({ status: request.status, text: request.responseText }));
    request.addEventListener("error", () => reject(silence()));
    request.addEventListener("abort", () => reject(new DOMException("canceled", "AbortError")));
    signal?.addEventListener("abort", () => request.abort(), { once: true });
    const form = new FormData();
    form.append("file", file, file.name);
    request.send(form);
  });
}
