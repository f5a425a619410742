/** The bar under the picture: play, single frames, a slider of time, sound, full screen. */

import { el, icon, iconButton } from "./dom.js";
import { clock } from "./format.js";

function swap(button, symbol, label) {
  if (button.getAttribute("aria-label") === label) return;
  button.replaceChildren(icon(symbol));
  button.setAttribute("aria-label", label);
  button.title = label;
}

/**
 * Fill `bar` with the controls. `on` has toggle, seek(frame), step(by), and may have mute(); `full` is the element that
 * fills the screen. Gives `update({playing, frame, frames, rate, muted, canPlay})`.
 */
export function transport(bar, { on, full, extra = [] }) {
  const play = iconButton("play", "Play", () => on.toggle());
  const back = iconButton("back", "One frame back", () => on.step(-1), { title: "One frame back (,)", "aria-keyshortcuts": "," });
  const forward = iconButton("forward", "One frame on", () => on.step(1), { title: "One frame on (.)", "aria-keyshortcuts": "." });
  const slider = el("input", { type: "range", class: "time", min: "0", step: "1", value: "0", "aria-label": "Frame" });
  const time = el("span", { class: "clock" });
  const sound = on.mute ? iconButton("sound", "Switch the sound off", () => on.mute()) : null;
  const screen = iconButton("full", "Full screen", () => (document.fullscreenElement ? document.exitFullscreen() : full().requestFullscreen?.()));
  slider.addEventListener("input", () => on.seek(Number(slider.value)));
  bar.replaceChildren(play, back, forward, slider, time, ...extra, ...(sound ? [sound] : []), screen);
  bar.hidden = false;

  return ({ playing, frame, frames, rate, muted = false, canPlay = true }) => {
    if (!canPlay && document.activeElement === play) forward.focus(); // it would be nowhere
    play.hidden = !canPlay;
    swap(play, playing ? "pause" : "play", playing ? "Pause" : "Play");
    if (sound) swap(sound, muted ? "muted" : "sound", muted ? "Switch the sound on" : "Switch the sound off");
    slider.max = String(Math.max(0, frames - 1));
    slider.value = String(frame);
    slider.setAttribute("aria-valuetext", `frame ${frame + 1} of ${frames}, ${clock(frame / rate)}`);
    slider.style.setProperty("--done", `${(frame / Math.max(1, frames - 1)) * 100}%`);
    const text = `${clock(frame / rate)} / ${clock(frames / rate)}`;
    if (time.textContent !== text) time.textContent = text;
  };
}
