/** The queue: transfers under way and finished, with their progress, their files and what went wrong. */

import { again, cancel, download, downloadAll, moreJobs } from "./transfers.js";
import { bytes, count, duration, moment, percent } from "./format.js";
import { el, icon, iconButton, keyed, say } from "./dom.js";
import { nameOf } from "./names.js";
import { onChange, state } from "./store.js";
import { compare } from "./stage.js";

const STAGES = { landmarks: "Looking for faces", render: "Rendering" };

function standing(job) {
  if (job.state === "queued") {
    if (job.waiting_for === "media") return "Waiting for its media";
    if (job.waiting_for === "room") return "Waiting for room on the disk";
    const position = job.queue?.position;
    return position ? `Queued, number ${position}` : "Queued";
  }
  if (job.state === "running") {
    const { stage, fraction, frames_done: done, frames_total: total } = job.progress;
    const parts = [STAGES[stage] ?? "Preparing", percent(fraction)];
    if (total > 1) parts.push(`frame ${done} of ${total}`);
    if (job.eta?.seconds > 1) parts.push(`about ${duration(job.eta.seconds)} left`);
    return parts.join(" · ");
  }
  const at = job.finished_at ? ` ${moment(job.finished_at)}` : "";
  return { canceling: "Stopping…", canceled: "Canceled", succeeded: "Finished", failed: "Failed", expired: "Expired" }[job.state] + at;
}

/** Why a job failed; a portrait that is at fault is named, of which there may be many. */
function problemOf(job) {
  const { title, detail, errors = [] } = job.error;
  const told = errors.flatMap(({ pointer, detail: what }) => {
    const look = job.looks[/^\/looks\/(\d+)\//.exec(pointer)?.[1]];
    return look ? [`${nameOf(look.reference)}: ${what}`] : [];
  });
  return [title, told.join("; ") || detail].filter(Boolean).join(": ");
}

function resultRow(look, show) {
  // of a file that has expired, or was deleted with its media, the job knows nothing any more, not even which it was
  const gone = !look.content_type || new Date(look.expires_at) < new Date();
  const size = gone ? "No longer kept" : bytes(look.size_bytes);
  const name = nameOf(look.reference);
  const made = el("li", { class: "result" },
    el("div", { class: "result-name" }, el("span", { class: "name", title: name }, name), el("span", { class: "quiet small" }, size)),
    el("button", { type: "button", disabled: gone, onclick: show, "aria-label": `Compare ${name} before and after` }, icon("split"), "Compare"),
    iconButton("down", `Download ${name}`, () => download(look), { disabled: gone }));
  const warnings = look.warnings ?? [];
  if (warnings.length) {
    made.append(el("details", { class: "warnings" }, el("summary", {}, icon("warn"), count(warnings.length, "note")), el("ul", {}, warnings.map((one) => el("li", {}, one)))));
  }
  return made;
}

function card(first) {
  let job = first;
  const title = el("h3", {});
  const status = el("p", { class: "quiet small" });
  const bar = el("progress", { max: "1" });
  const stop = el("button", { type: "button", onclick: () => cancel(job) }, "Cancel");
  const repeat = el("button", { type: "button", onclick: () => again(job) }, "Try again");
  const every = el("button", { type: "button", onclick: () => downloadAll(job) }, icon("down"), "Download all");
  const problem = el("p", { class: "problem", hidden: true });
  const results = el("ul", { class: "results" });
  const made = el("li", { class: "job", tabindex: "-1" }, el("div", { class: "job-head" }, el("div", {}, title, status), stop, repeat, every), bar, problem, results);
  made.update = (now) => {
    job = now;
    const done = job.state === "succeeded";
    made.dataset.state = job.state;
    const looks = count(job.looks.length, "look");
    // the results below have the names
    say(title, done ? looks : `${looks}: ${job.looks.map((look) => nameOf(look.reference)).join(", ")}`);
    title.title = title.textContent;
    say(status, standing(job));
    bar.hidden = job.done;
    bar.setAttribute("aria-label", `Progress of ${title.textContent}`);
    if (job.state === "running") bar.value = job.progress.fraction;
    else bar.removeAttribute("value");
    const stopped = document.activeElement === stop;
    stop.hidden = job.done || job.state === "canceling";
    if (stopped && stop.hidden) made.focus();
    repeat.hidden = job.kind !== "transfer" || !["failed", "canceled", "expired"].includes(job.state);
    every.hidden = !done || job.looks.filter((look) => look.content_type).length < 2;
    problem.hidden = !job.error || job.state !== "failed";
    say(problem, job.error ? problemOf(job) : "");
    if (done) {
      // looks that are not kept have no id
      const key = (look) => `${job.looks.indexOf(look)} ${look.result} ${look.content_type} ${nameOf(look.reference)}`;
      keyed(results, job.looks, key, (look) => {
        const index = job.looks.indexOf(look);
        return resultRow(look, () => compare(job, job.looks[index])); // the job as it is then
      });
    }
  };
  return made;
}

export function mountQueue() {
  const list = document.getElementById("jobs");
  const more = el("button", { type: "button", class: "small more", hidden: true, onclick: () => moreJobs() }, "Show more");
  list.after(more);
  onChange(() => {
    keyed(list, state.jobs, (job) => job.id, card);
    more.hidden = !state.more.jobs;
    const active = state.jobs.filter((job) => !job.done).length;
    say(document.getElementById("queue-hint"), active ? `${active} at work` : state.jobs.length || !state.listed ? "" : "Nothing rendered yet");
  });
}
