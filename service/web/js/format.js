/** Numbers as people read them. */

/** Bytes in decimal units, as the limits of the service are. */
export function bytes(count) {
  if (count === null || count === undefined) return "";
  const units = ["bytes", "kB", "MB", "GB", "TB"];
  let size = count;
  let unit = 0;
  while (size >= 1000 && unit < units.length - 1) {
    size /= 1000;
    unit += 1;
  }
  return `${unit && size < 10 ? size.toFixed(1) : Math.round(size)} ${units[unit]}`;
}

/** Seconds as 0:07.2, the time of a player. */
export function clock(seconds) {
  const tenths = Math.max(0, Math.floor(seconds * 10 + 1e-6));
  const minutes = Math.floor(tenths / 600);
  const rest = (tenths % 600) / 10;
  return `${minutes}:${rest.toFixed(1).padStart(4, "0")}`;
}

/** How long a medium is, by what the service says of it: a time, or that there is none. */
export function lengthOf({ kind, frame_count: frames, duration_s: seconds }) {
  if (kind === "image") return "Still picture";
  return frames > 1 ? clock(seconds) : "1 frame";
}

/** How long something will take: "12 s", "3 min". */
export function duration(seconds) {
  if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

export const percent = (share) => `${Math.round(share * 100)} %`;

/** "1 look", "3 looks". */
export const count = (number, noun) => `${number} ${noun}${number === 1 ? "" : "s"}`;

/** A word with a capital, as a label has it. */
export const capital = (word) => word.charAt(0).toUpperCase() + word.slice(1);

/** When something was, by the clock of who reads it: "at 14:05", or "on 2 Nov, 14:05" where that is not today. */
export function moment(iso) {
  const then = new Date(iso);
  const isToday = then.toDateString() === new Date().toDateString();
  const day = isToday ? {} : { day: "numeric", month: "short" };
  return `${isToday ? "at" : "on"} ${then.toLocaleString([], { hour: "2-digit", minute: "2-digit", ...day })}`;
}
