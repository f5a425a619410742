"""What the tests do on the page, and how they look at it."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from tests.browser.guarded import Guarded

READY = "() => document.querySelector('.holder') !== null"

_DROP = """([selector, files]) => {
  const carried = new DataTransfer();
  for (const { name, type, data } of files) {
    const bytes = Uint8Array.from(atob(data), (one) => one.charCodeAt(0));
    carried.items.add(new File([bytes], name, { type }));
  }
  const target = document.querySelector(selector);
  for (const kind of ['dragenter', 'dragover', 'drop']) {
    target.dispatchEvent(new DragEvent(kind, { bubbles: true, cancelable: true, dataTransfer: carried }));
  }
}"""
_TYPES = {".mp4": "video/mp4", ".jpg": "image/jpeg", ".png": "image/png", ".txt": "text/plain"}


def drop(page: Page, selector: str, *files: Path) -> None:
    """Drop files on a part of the page, as a hand does with a mouse."""
    carried = [
        {"name": one.name, "type": _TYPES[one.suffix], "data": base64.b64encode(one.read_bytes()).decode()}
        for one in files
    ]
    page.evaluate(_DROP, [selector, carried])


#: the mean difference between the two pictures that the line parts, in levels of 255
_DIFFERENCE = """() => {
  const pixels = (image) => {
    const canvas = new OffscreenCanvas(160, 90);
    const context = canvas.getContext('2d');
    context.drawImage(image, 0, 0, 160, 90);
    return context.getImageData(0, 0, 160, 90).data;
  };
  const [before, after] = [':not(.after)', '.after'].map((one) => document.querySelector(`.frame img.layer${one}`));
  if (!before?.naturalWidth || !after?.naturalWidth) return -1;
  const [one, other] = [pixels(before), pixels(after)];
  return one.reduce((sum, value, index) => sum + Math.abs(value - other[index]), 0) / (one.length * 3 / 4);
}"""


def difference(page: Page) -> float:
    value: float = page.evaluate(_DIFFERENCE)
    return value


def at_rest(guarded: Guarded) -> float:
    """Wait until the picture on the stage is the one that is wanted; the seconds that took."""
    # a slider that has just moved asks a moment later
    return guarded.until(
        """() => {
          const frame = document.querySelector('.frame');
          return frame && !frame.hasAttribute('aria-busy') && document.querySelector('.frame img').naturalWidth > 0;
        }"""
    )


def videos(page: Page) -> list[dict[str, Any]]:
    """How the videos of the stage stand."""
    found: list[dict[str, Any]] = page.evaluate(
        """() => [...document.querySelectorAll('#picture video')].map((one) => ({
          time: one.currentTime, paused: one.paused, ready: one.readyState, hidden: one.hidden, width: one.videoWidth,
        }))"""
    )
    return found
