/** Calls to the service: addresses, the key, errors as problems (RFC 9457), and asking again when it is busy. */

import { askForKey, dropKey, key } from "./key.js";

/** This module lies at <root>/web/js/api.js, wherever a proxy has put the root. */
const ROOT = new URL("../../", import.meta.url);
/** The version of the interface that the page was written for. */
const PREFIX = "v1/";

export const address = (path) => new URL(PREFIX + path.replace(/^\//, ""), ROOT).href;

const MOST_TRIES = 4;
const LONGEST_PAUSE_S = 15;

/** What went wrong, in the service's own words. */
export class Problem extends Error {
  constructor({ code = "unknown", type = "", title = "Something went wrong", detail = "", status = 0, request_id = "", errors = null }) {
    super(detail || title);
    Object.assign(this, { code, type, title, detail, status, requestId: request_id, errors });
  }

  /** One sentence for a person. */
  get text() {
    return this.detail && this.detail !== this.title ? `${this.title}: ${this.detail}` : this.title;
  }
}

export const isAbort = (error) => error?.name === "AbortError";

/** The problem of an answer, also when something between us and the service has answered. */
export function problemOf(status, text) {
  try {
    const body = JSON.parse(text);
    if (body.title) return new Problem({ ...body, status });
  } catch {
    // it is no JSON
  }
  return new Problem({ status, title: `The service answered ${status || "nothing"}` });
}

export const silence = () => new Problem({ code: "unreachable", title: "The service does not answer", detail: "check that it runs and that you are connected" });

/** A fresh name for a request that must not be done twice. `crypto.randomUUID` is missing where there is no TLS. */
export function onceKey() {
  const random = crypto.getRandomValues(new Uint8Array(16));
  return [...random].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

export const authorization = () => (key() ? { Authorization: `Bearer ${key()}` } : {});

let trying = null;

/** Whether the service gives what is asked for without a key. */
function isOpen() {
  trying ??= fetch(address("videos?limit=1"), { credentials: "omit", cache: "no-store" })
    .then((answer) => answer.ok, () => false)
    .finally(() => { trying = null; });
  return trying;
}

/** After a 401 to `used`, the key that was sent, have another one; or none, where a service is that has no keys. */
export async function changeKey(used) {
  if (used && (await isOpen())) dropKey(used);
  else if (!used || key()) await askForKey(used ? "That key is not known here, or it was revoked." : "");
}

export const pause = (seconds, signal) =>
  new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, seconds * 1000);
    signal?.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(signal.reason);
    }, { once: true });
  });

/**
 * Ask the service, and give its answer if it is a success. Asks again after 429 and 503 as Retry-After says, which
 * is safe because every POST carries an Idempotency-Key; asks the user for a key after 401. Throws `Problem`.
 */
export async function call(path, { method = "GET", json, body, headers = {}, signal, again = true, keepalive = false } = {}) {
  const sent = { ...headers };
  if (json !== undefined) sent["Content-Type"] = "application/json";
  if (method === "POST") sent["Idempotency-Key"] = onceKey();
  for (let tries = 1; ; tries += 1) {
    const used = key();
    let answer;
    try {
      answer = await fetch(address(path), {
        method,
        headers: { ...sent, ...authorization() },
        body: json === undefined ? body : JSON.stringify(json),
        signal,
        keepalive,
        credentials: "omit",
        cache: "no-store", // faces are not left in the browser's files
      });
    } catch (error) {
      if (isAbort(error)) throw error;
      throw silence();
    }
    if (answer.ok) return answer;
    const problem = problemOf(answer.status, await answer.text());
    if (answer.status === 401) {
      await changeKey(used);
      continue;
    }
    const after = Number(answer.headers.get("Retry-After"));
    if (!again || ![429, 503].includes(answer.status) || tries >= MOST_TRIES || after > LONGEST_PAUSE_S) throw problem;
    await pause(after || 1, signal);
  }
}

/** the most that one answer of a list has */
const LONGEST_PAGE = 200;

/** A page of a list: its data, as many as `count` and no more than a page may have, and the cursor of the next one. */
export async function page(path, count, cursor = null) {
  const query = new URLSearchParams({ limit: Math.min(count, LONGEST_PAGE), ...(cursor ? { cursor } : {}) });
  return ask(`${path}${path.includes("?") ? "&" : "?"}${query}`);
}

/** The JSON of an answer; null of an empty one. */
export async function ask(path, options) {
  const answer = await call(path, options);
  return answer.status === 204 ? null : answer.json();
}
