/** What the page knows, in one place. Whoever shows a part of it is told after it has changed. */

export const state = {
  /** the clip on the stage: see clip.js */
  clip: null,
  /** media that were uploaded before, newest first */
  clips: [],
  /** references of the tray: see references.js */
  references: [],
  /** key of the reference whose settings are shown */
  selected: null,
  /** how results are written: see output.js */
  output: { format: "auto", extras: [] },
  /** transfers, newest first, as the service shows them */
  jobs: [],
  /** whether the service has said which there are */
  listed: false,
  /** cursors of what the service has beyond these lists; null where there is no more */
  more: { clips: null, references: null, jobs: null },
  /** ids of media that are known to be deleted */
  deleted: new Set(),
  /** a finished look that is compared on the stage: {job, look} */
  compared: null,
};

const listeners = new Set();
let pending = false;

export function onChange(listener) {
  listeners.add(listener);
  listener(state);
}

/** Tell everyone, once for all changes of this turn. */
export function changed() {
  if (pending) return;
  pending = true;
  queueMicrotask(() => {
    pending = false;
    for (const listener of listeners) listener(state);
  });
}

export const selectedReference = () => state.references.find((one) => one.key === state.selected) ?? null;
