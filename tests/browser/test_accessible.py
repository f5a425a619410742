"""The page for those who use a keyboard or a screen reader, in both themes, and on a phone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import FileChooser

from scripts.samples import Samples
from tests.browser.driving import READY, at_rest
from tests.browser.guarded import PATIENCE_S, Guarded
from tests.gallery.clips import add_tone, cut_clip
from tests.service.fixtures import Api
from tests.worker.serving import Service

Pages = Callable[..., Guarded]
pytestmark = pytest.mark.timeout(900)

#: controls that a screen reader would call nothing, and pictures without a text of their own
_NAMELESS = """() => {
  const seen = (one) => one.checkVisibility({ checkVisibilityCSS: true }) && !one.closest('[aria-hidden=true]');
  const text = (id) => document.getElementById(id)?.textContent.trim() ?? '';
  const name = (one) =>
    one.getAttribute('aria-label')
    || (one.getAttribute('aria-labelledby') ?? '').split(' ').map(text).join(' ').trim()
    || [...(one.labels ?? [])].map((label) => label.textContent.trim()).join(' ')
    || (['BUTTON', 'A', 'SUMMARY'].includes(one.tagName) ? one.textContent.trim() : '');
  const controls = [...document.querySelectorAll('button, a[href], input, select, progress, summary, [role]')];
  const bad = controls.filter((one) => seen(one) && one.type !== 'hidden' && !name(one)
    && !['status', 'alert', 'presentation'].includes(one.getAttribute('role')));
  const pictures = [...document.images].filter((one) => !one.hasAttribute('alt'));
  return [...bad, ...pictures].map((one) => one.outerHTML.slice(0, 200));
}"""

#: texts with less contrast than WCAG 2.2, 1.4.3 asks for, by their relative luminances; what is disabled is left out
_FAINT = """() => {
  const canvas = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
  const rgba = (color) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = color;
    canvas.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = (top, under) => top.slice(0, 3).map((value, i) => value * top[3] + under[i] * (1 - top[3]));
  const luminance = (color) => {
    const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = color.map((value) => linear(value / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (one) => {
    const layers = [];
    for (let at = one; at; at = at.parentElement) layers.push(rgba(getComputedStyle(at).backgroundColor));
    return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
  };
  const faint = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const one = node.parentElement;
    if (!node.textContent.trim() || !one.checkVisibility({ opacityProperty: true, visibilityProperty: true })) continue;
    if (one.closest(':disabled, noscript, .unseen, option')) continue;
    const style = getComputedStyle(one);
    const under = ground(one);
    const [light, dark] = [luminance(over(rgba(style.color), under)), luminance(under)].sort((a, b) => b - a);
    const ratio = (light + 0.05) / (dark + 0.05);
    if (ratio < 4.5) faint.push(`${ratio.toFixed(2)} ${node.textContent.trim().slice(0, 60)}`);
  }
  return faint;
}"""

_WIDER = """() => [...document.querySelectorAll('body *')]
  .filter((one) => one.checkVisibility() && one.getBoundingClientRect().right > innerWidth + 0.5
    && !one.closest('.cards, .unseen, .symbols, .skip, .frame'))
  .map((one) => one.outerHTML.slice(0, 160))"""

#: no colour is on its way to another one; spinners go on and on
_STILL = """() => document.getAnimations().every((one) =>
  one.playState !== 'running' || one.effect.getComputedTiming().endTime === Infinity)"""

#: where the keyboard is, and whether that can be seen
_FOCUS = """() => {
  const one = document.activeElement;
  const style = getComputedStyle(one);
  const thumb = one.type === 'range' ? getComputedStyle(one, '::-webkit-slider-thumb') : style;
  const around = one.closest('.chip, .face-chip');
  const outlined = [style, thumb, ...(around ? [getComputedStyle(around)] : [])].some(
    (each) => each.outlineStyle !== 'none' && parseFloat(each.outlineWidth) >= 2);
  const split = one.classList.contains('split');
  return { name: one.getAttribute('aria-label') ?? one.labels?.[0]?.textContent ?? one.textContent.trim(),
    tag: one.tagName, seen: outlined || split };
}"""


@pytest.fixture(scope="module")
def media(service: Service, samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A clip with sound, portraits, one of a long name, and a picture of several people, ready, and finished looks."""
    folder = tmp_path_factory.mktemp("clips")
    clip = add_tone(cut_clip(samples.woman_clip, folder / "mute.mp4", 20, 32), 0.5, 0, folder / "short.mp4")
    long = folder / f"{'of_a_long_name_' * 8}.jpg"
    long.write_bytes(samples.pale_portrait.read_bytes() + b"other bytes")
    video = service.ready("/videos", clip)
    other, portrait = (service.ready("/references", one) for one in (long, samples.pale_portrait))
    group = service.ready("/references", samples.several_faces)
    asked = {"video": video["id"], "looks": [{"reference": one["id"]} for one in (portrait, other)]}
    job = service.finished(service.client.post("/transfer", json=asked).json()["id"])
    assert job["state"] == "succeeded"
    return {"clip": clip, "video": video, "portrait": portrait, "group": group, "job": job}


def states(guarded: Guarded, media: dict[str, Any]) -> Iterator[str]:
    """Bring the page into each of its states in turn."""
    page = guarded.page

    def empty() -> None:
        guarded.open()

    def editing() -> None:
        page.goto(f"{guarded.root}/#{media['video']['id']}")
        guarded.until("() => location.hash.length > 1")  # on a busy machine a reload may be before the address
        page.reload()
        guarded.until(READY)
        at_rest(guarded)

    def everything() -> None:
        page.get_by_role("button", name=media["group"]["filename"], exact=True).click()
        page.evaluate("() => document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        page.get_by_role("checkbox", name=f"Render {media['group']['filename']}").check()
        at_rest(guarded)

    def comparing() -> None:
        page.get_by_role("button", name="Compare man_pale.jpg before and after").first.click()
        guarded.until("() => document.querySelectorAll('#picture video')[1]?.readyState > 1")

    for state in (empty, editing, everything, comparing):
        state()
        guarded.until(_STILL)
        yield state.__name__


THEMES = ["dark", "light"]


@pytest.mark.parametrize("theme", THEMES)
def test_every_control_has_a_name_and_every_text_enough_contrast(
    pages: Pages, media: dict[str, Any], theme: str
) -> None:
    guarded = pages(color_scheme=theme)
    for state in states(guarded, media):
        assert guarded.page.evaluate(_NAMELESS) == [], state
        assert guarded.page.evaluate(_FAINT) == [], state
        # a slider says its value itself
        assert guarded.page.locator("output:not([aria-live=off])").count() == 0
        headings = guarded.page.evaluate("() => [...document.querySelectorAll('h1')].length")
        assert headings == 1


def test_a_phone_scrolls_in_one_direction_only(pages: Pages, media: dict[str, Any]) -> None:
    guarded = pages(viewport={"width": 360, "height": 740}, is_mobile=True, has_touch=True, device_scale_factor=2)
    for state in states(guarded, media):
        assert guarded.page.evaluate("() => document.documentElement.scrollWidth") == 360, state
        assert guarded.page.evaluate(_WIDER) == [], state
        small = guarded.page.evaluate(
            """() => [...document.querySelectorAll('button')].filter((one) => one.checkVisibility())
              .map((one) => [one.textContent || one.ariaLabel, one.getBoundingClientRect()])
              .filter(([, box]) => box.width < 24 || box.height < 24).map(([name]) => name)"""
        )
        assert small == [], f"{state}: targets below 24 px (WCAG 2.2, 2.5.8)"


class Keyboard:
    """A page that is worked by keys alone."""

    def __init__(self, guarded: Guarded) -> None:
        self._page = guarded.page
        # from the beginning: the browser is told only after a while that choosers are not to be shown
        self._choosers: list[FileChooser] = []
        self._page.on("filechooser", self._opened)

    def _opened(self, chooser: FileChooser) -> None:
        self._choosers.append(chooser)

    def reach(self, name: str, *, back: bool = False) -> None:
        """Go on by Tab until the control of this name is reached; each stop can be seen."""
        for _ in range(80):
            self._page.keyboard.press("Shift+Tab" if back else "Tab")
            at = self._page.evaluate(_FOCUS)
            if at["tag"] == "BODY":
                continue
            assert at["seen"], at
            if at["name"] == name:
                return
        raise AssertionError(f"{name} is not reached")

    def choose(self, file: Path) -> None:
        """Press the button that has the focus, and give the chooser that opens a file."""
        self._page.keyboard.press("Enter")
        until = time.monotonic() + PATIENCE_S
        while not self._choosers:
            assert time.monotonic() < until, "no file can be chosen"
            self._page.wait_for_timeout(50)
        self._choosers.pop().set_files(file)


def test_the_whole_way_goes_by_keyboard_alone(
    service: Service, pages: Pages, media: dict[str, Any], samples: Samples
) -> None:
    guarded = pages()
    page = guarded.page
    keyboard = Keyboard(guarded)
    guarded.open()
    page.keyboard.press("Tab")
    assert page.evaluate(_FOCUS)["name"] == "Skip to the clip"
    keyboard.reach("Choose a clip")
    keyboard.choose(media["clip"])
    guarded.until(READY)
    keyboard.reach("Add portraits")
    keyboard.choose(samples.pale_portrait)
    guarded.until("() => document.querySelector('.card.selected .thumb.loaded') !== null")
    guarded.until("() => !document.querySelector('#look button.primary').disabled")
    keyboard.reach("Strength")
    for _ in range(10):
        page.keyboard.press("ArrowLeft")
    keyboard.reach("Render")
    page.keyboard.press("Enter")
    page.locator(".job[data-state=succeeded]").nth(1).wait_for()
    assert "1 look finished" in page.locator("#polite").inner_text()
    assert service.client.get("/jobs?kind=transfer").json()["data"][0]["looks"][0]["options"]["strength"] == 0.9
    keyboard.reach("Compare man_pale.jpg before and after")
    page.keyboard.press("Enter")
    guarded.until("() => document.querySelectorAll('#picture video')[1]?.readyState > 1")
    assert page.evaluate("() => document.activeElement.id") == "stage"
    keyboard.reach("Before and after")
    split = "() => document.querySelector('.frame').style.getPropertyValue('--split')"
    was = page.evaluate(split)
    page.keyboard.press("ArrowRight")
    assert page.evaluate(split) != was
    keyboard.reach("Play")
    page.keyboard.press("Space")
    guarded.until("() => !document.querySelectorAll('#picture video')[1].paused")
    keyboard.reach("Back to the look", back=True)
    page.keyboard.press("Enter")
    at_rest(guarded)


def test_one_of_several_faces_is_chosen(service: Service, pages: Pages, media: dict[str, Any]) -> None:
    guarded = pages()
    page = guarded.open(f"/#{media['video']['id']}")
    guarded.until(READY)
    page.get_by_role("button", name=media["group"]["filename"], exact=True).click()
    faces = page.get_by_role("group", name="Face of the portrait").get_by_role("radio")
    faces.last.wait_for(state="attached")
    assert faces.count() == len(media["group"]["faces"]) > 1
    guarded.until("() => [...document.querySelectorAll('.face img')].every((one) => one.naturalWidth > 0)")
    at_rest(guarded)
    shown = page.locator(".frame img.after").get_attribute("src")
    other = next(index for index in range(faces.count()) if not faces.nth(index).is_checked())
    faces.nth(other).check()
    guarded.until("(was) => document.querySelector('.frame img.after').src !== was", shown)


#: a slider whose thumb is at its end, and a bar that is full, over an empty page
_BARS = """() => {
  const [slider, progress] = ['input', 'progress'].map((one) => document.createElement(one));
  Object.assign(slider, { type: 'range', value: 100 });
  progress.value = 1;
  document.body.replaceChildren(slider, progress);
}"""


def test_sliders_and_progress_are_seen_in_a_systems_own_colours(api: Api, open_page: Pages) -> None:
    guarded = open_page(str(api.client.base_url).rstrip("/"), forced_colors="active")
    page = guarded.open()
    ground = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    page.evaluate(_BARS)
    for kind in ("input", "progress"):
        drawn = cv2.imdecode(np.frombuffer(page.locator(kind).screenshot(), np.uint8), cv2.IMREAD_COLOR_RGB)
        assert drawn is not None
        middle = drawn[drawn.shape[0] // 2, drawn.shape[1] // 2]
        assert f"rgb({', '.join(map(str, middle))})" != ground, kind


#: change what goes to its new place or brightness little by little, and turn one thing after that for anybody
_CHANGE = """async () => {
  const drawn = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  const [tag, thumb, image, progress] = ['span', 'div', 'img', 'progress'].map((one) => document.createElement(one));
  tag.className = 'tag';
  thumb.className = 'thumb';
  thumb.append(image);
  progress.value = 0.1;
  document.body.append(tag, thumb, progress);
  await drawn();
  tag.style.opacity = '0';
  image.style.opacity = '1';
  progress.value = 0.9;
  await drawn();
  tag.animate({ rotate: ['0deg', '1deg'] }, 1);
}"""


def moved(guarded: Guarded) -> list[tuple[str, float]]:
    """What moves after a change, and for how many milliseconds; the browser tells it of the bar of a progress, too."""
    page, begun = guarded.open(), list[dict[str, Any]]()
    session = page.context.new_cdp_session(page)
    session.on("Animation.animationStarted", lambda event: begun.append(event["animation"]))
    session.send("Animation.enable")
    page.evaluate(_CHANGE)
    guarded.heard(lambda: any(one["type"] == "WebAnimation" for one in begun))
    return sorted((one["name"], one["source"]["duration"]) for one in begun if one["type"] == "CSSTransition")


def test_whoever_wants_less_motion_gets_less(api: Api, open_page: Pages) -> None:
    root = str(api.client.base_url).rstrip("/")  # without pictures, which appear when they have come
    usual = moved(open_page(root, reduced_motion="no-preference"))
    assert usual == [("opacity", 200), ("opacity", 200), ("width", 300)]
    assert moved(open_page(root, reduced_motion="reduce")) == []


#: visible texts smaller than 23 px, and controls whose text they do not hold
_TOO_SMALL_OR_CUT = """() => {
  const bad = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const one = node.parentElement;
    if (!node.textContent.trim() || !one.checkVisibility() || one.closest('noscript, option')) continue;
    if (parseFloat(getComputedStyle(one).fontSize) < 23) bad.push(`small: ${node.textContent.trim().slice(0, 60)}`);
  }
  for (const one of document.querySelectorAll('button, summary, .card')) {
    const cut = one.scrollWidth > one.clientWidth + 1 || one.scrollHeight > one.clientHeight + 1;
    if (one.checkVisibility() && cut) bad.push(`cut: ${one.textContent.trim().slice(0, 60)}`);
  }
  return bad;
}"""


@pytest.mark.parametrize("width", [1280, 360])
def test_texts_are_twice_as_large_where_the_browsers_font_is_and_all_of_them_fit(
    pages: Pages, media: dict[str, Any], width: int
) -> None:
    """WCAG 2.2, 1.4.4: also by the browser's own setting, not by zooming alone."""
    guarded = pages(viewport={"width": width, "height": 800})
    guarded.page.context.new_cdp_session(guarded.page).send("Page.setFontSizes", {"fontSizes": {"standard": 32}})
    for state in states(guarded, media):
        assert guarded.page.evaluate("() => getComputedStyle(document.documentElement).fontSize") == "32px", state
        assert guarded.page.evaluate(_TOO_SMALL_OR_CUT) == [], state
        assert guarded.page.evaluate("() => document.documentElement.scrollWidth") == width, state
        assert guarded.page.evaluate(_WIDER) == [], state
