/** Whether the service and its workers are there, in the bar at the top. */

import { address } from "./api.js";
import { say } from "./dom.js";

const PAUSE_MS = 15_000;

const WORDS = {
  ok: ["ready", "Ready"],
  degraded: ["waits", "No worker: jobs will wait"],
  unavailable: ["away", "Not available"],
  stopping: ["away", "Stopping"],
};

async function look(element) {
  let status = "unavailable";
  let checks = {};
  try {
    const answer = await fetch(address("readyz"), { credentials: "omit", cache: "no-store" });
    ({ status, checks = {} } = await answer.json());
  } catch {
    // the words for it are those of a part that is away
  }
  let [kind, words] = WORDS[status] ?? WORDS.unavailable;
  if (status === "degraded") {
    if (checks.storage === "full") words = "Disk full: nothing new is taken";
    else if (checks.workers !== "none" && (checks.broker !== "ok" || checks.workers !== "ok"))
      words = "Queue away: jobs will wait";
    else if (checks.workers === "ok") [kind, words] = WORDS.ok; // the rest is the operator's
  }
  element.dataset.kind = kind;
  say(element, words);
}

export function mountService() {
  const element = document.getElementById("service");
  look(element);
  setInterval(() => document.hidden || look(element), PAUSE_MS);
}
