"""From a clip that is dropped to looks that are compared and downloaded, in a browser, with nothing pretended."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Download, Page

from scripts.samples import Samples
from tests.browser.driving import READY, at_rest, difference, drop, videos
from tests.browser.guarded import PATIENCE_S, Guarded
from tests.gallery.clips import cut_clip
from tests.worker.serving import Service

Pages = Callable[..., Guarded]
pytestmark = pytest.mark.timeout(900)

#: seconds that two videos which play as one are apart at most, once the player has seen to it
TOGETHER_S = 0.15


def test_a_dropped_clip_becomes_looks_that_are_compared_and_downloaded(
    service: Service, pages: Pages, samples: Samples, tiny_clip: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    guarded = pages()
    page = guarded.open()
    page.get_by_role("heading", name="Face colour").wait_for()
    assert page.get_by_role("button", name="Render").is_disabled()

    show_what_was_found(guarded, tiny_clip)
    try_looks(guarded, samples, capsys)
    job = render(service, page)
    keep_the_files(guarded, job)
    compare(guarded, capsys)


def show_what_was_found(guarded: Guarded, clip: Path) -> None:
    """Drop a clip: its progress is shown, then what was found in it."""
    page = guarded.page
    drop(page, "#picture", clip)
    page.get_by_role("progressbar", name="Progress of the clip").wait_for()
    guarded.until(READY)
    at_rest(guarded)
    page.get_by_role("radio", name="Landmarks").check()
    at_rest(guarded)
    shown = page.locator(".frame img").first
    landmarks = shown.get_attribute("src")
    page.get_by_text("640×360 · 23.98 fps").wait_for()
    page.get_by_role("radio", name="Mask").check()
    guarded.until("() => !document.querySelector('.veil').hidden && document.querySelector('.veil').naturalWidth > 0")
    assert shown.get_attribute("src") != landmarks
    page.get_by_role("radio", name="Look", exact=True).check()


def try_looks(guarded: Guarded, samples: Samples, capsys: pytest.CaptureFixture[str]) -> None:
    """Drop several portraits: the look of the first is shown as soon as it is ready, and follows a slider."""
    page = guarded.page
    drop(page, "#tray", samples.pale_portrait, samples.dark_portrait)
    guarded.until("() => document.querySelectorAll('.card:has(.include:checked) .thumb.loaded').length === 2")
    guarded.until("() => !document.querySelector('#look button.primary').disabled")
    guarded.until("() => document.querySelector('.frame img.after').naturalWidth > 0")
    at_rest(guarded)
    assert difference(page) > 3

    strength = page.get_by_role("slider", name="Strength")
    before = page.locator(".frame img.after").get_attribute("src")
    strength.fill("0")
    took = guarded.until("(was) => document.querySelector('.frame img.after').src !== was", before)
    at_rest(guarded)
    # nothing of the look leaves the clip as it is
    assert difference(page) < 1
    assert strength.get_attribute("aria-valuetext") == "0 %"
    with capsys.disabled():
        print(f" [a look drawn anew for a slider: {took:.2f} s]", end="")
    page.get_by_role("button", name="Reset").click()
    assert strength.input_value() == "1"


def render(service: Service, page: Page) -> dict[str, Any]:
    """Render two looks; what the panel says is what the job has."""
    page.get_by_role("slider", name="Light").fill("0.6")
    page.get_by_role("button", name="Use for all portraits").click()
    page.get_by_role("button", name="Render 2 looks").click()
    page.get_by_role("button", name="Download all").wait_for()
    job: dict[str, Any] = service.client.get("/jobs?kind=transfer").json()["data"][0]
    assert [look["options"]["light"] for look in job["looks"]] == [0.6, 0.6]
    return job


def keep_the_files(guarded: Guarded, job: dict[str, Any]) -> None:
    """Downloads are the results, byte for byte, under the names that the service gives them."""
    files: list[Download] = []
    guarded.page.on("download", lambda one: files.append(one))  # noqa: PLW0108  (Playwright marks its handlers)
    guarded.page.get_by_role("button", name="Download all").click()
    guarded.heard(lambda: len(files) == 2)
    digests = {hashlib.sha256(one.path().read_bytes()).hexdigest() for one in files}
    assert digests == {look["sha256"] for look in job["looks"]}
    assert {one.suggested_filename for one in files} == {"smile-man_deep_brown.mp4", "smile-man_pale.mp4"}


def compare(guarded: Guarded, capsys: pytest.CaptureFixture[str]) -> None:
    """Before and after play as one, and the line between them moves."""
    page = guarded.page
    page.get_by_role("button", name="Compare man_deep_brown.jpg before and after").first.click()
    guarded.until(
        """() => {
          const both = [...document.querySelectorAll('#picture video')];
          return both.length === 2 && both.every((one) => one.readyState > 1 && !one.hidden);
        }"""
    )
    assert [one["width"] for one in videos(page)] == [640, 640]
    drifts = played_together(guarded)
    with capsys.disabled():
        print(f" [before and after apart while playing: {', '.join(f'{one * 1000:.0f}' for one in drifts)} ms]", end="")
    # the player brings them together again whatever keeps one of them up
    assert min(drifts) < TOGETHER_S
    page.get_by_role("button", name="Pause").click()
    guarded.until(
        """(frame_s) => {
          const [one, other] = document.querySelectorAll('#picture video');
          const rest = [one, other].every((each) => each.paused && !each.seeking);
          return rest && Math.abs(one.currentTime - other.currentTime) < frame_s;
        }""",
        1 / 24,
    )
    line = page.get_by_role("slider", name="Before and after")
    line.focus()
    page.keyboard.press("End")
    assert line.get_attribute("aria-valuetext") == "0 % after"
    page.get_by_role("radio", name="man_pale.jpg").check()
    guarded.until("() => document.querySelectorAll('#picture video')[1]?.readyState > 1")
    page.get_by_role("button", name="Back to the look").click()
    at_rest(guarded)


def played_together(guarded: Guarded) -> list[float]:
    """Play, and say how far the two videos are apart, again and again until they are together, in seconds."""
    page = guarded.page
    page.get_by_role("button", name="Play").click()
    began = videos(page)[1]["time"]
    guarded.until("(from) => document.querySelectorAll('#picture video')[1].currentTime > from + 0.1", began)
    drifts: list[float] = []
    end = time.monotonic() + PATIENCE_S
    while len(drifts) < 8 or (min(drifts) >= TOGETHER_S and time.monotonic() < end):
        one, other = videos(page)
        drifts.append(abs(one["time"] - other["time"]))
        time.sleep(0.1)
    return drifts


def test_the_first_preview_comes_by_itself_once_the_clip_is_ready(
    service: Service,
    pages: Pages,
    samples: Samples,
    tiny_clip: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    reference = service.ready("/references", samples.pale_portrait)
    another = tmp_path / "another.mp4"
    another.write_bytes(tiny_clip.read_bytes() + b"\0\0\0\x08free")
    guarded = pages()
    page = guarded.open()
    page.evaluate(
        """() => {
          const told = new MutationObserver(() => {
            const now = performance.now();
            if (document.querySelector('.holder')) window.readyAt ??= now;
            const after = document.querySelector('.frame img.after');
            if (after?.getAttribute('src')) window.seenAt ??= now;
          });
          told.observe(document.getElementById('picture'), { subtree: true, childList: true, attributes: true });
        }"""
    )
    page.get_by_role("button", name=reference["filename"], exact=True).click()
    drop(page, "#picture", another)
    guarded.until("() => window.seenAt !== undefined")
    waited = page.evaluate("() => window.seenAt - window.readyAt") / 1000
    with capsys.disabled():
        print(f" [first preview {waited:.2f} s after the clip is ready; 1 s is wanted of an idle machine]", end="")
    assert difference(page) > 3


def test_a_reload_finds_everything_again(service: Service, pages: Pages, samples: Samples, tiny_clip: Path) -> None:
    video = service.ready("/videos", tiny_clip)
    reference = service.ready("/references", samples.pale_portrait)
    look = {"reference": reference["id"]}
    job = service.client.post("/transfer", json={"video": video["id"], "looks": [look]}).json()
    service.finished(job["id"])
    guarded = pages()
    page = guarded.open()
    page.get_by_role("button", name="smile.mp4").first.click()
    at_rest(guarded)
    assert page.evaluate("() => location.hash") == f"#{video['id']}"
    page.reload()
    guarded.until(READY)
    at_rest(guarded)
    page.get_by_role("button", name="Compare man_pale.jpg before and after").first.click()
    # the clip's own file is not in this tab any more: the service gives it
    for side in (0, 1):
        guarded.until(f"() => document.querySelectorAll('#picture video')[{side}]?.readyState > 1")


def test_a_portrait_that_is_added_twice_at_once_has_one_card(pages: Pages, samples: Samples, tmp_path: Path) -> None:
    """Both are vectorised by one job, and both hear of its end."""
    one, other = tmp_path / "one.jpg", tmp_path / "other.jpg"
    for path in (one, other):
        path.write_bytes(samples.dark_portrait.read_bytes() + b"a portrait that nobody has added before")
    guarded = pages()
    page = guarded.open()
    before = page.locator("#cards .card:not(.adder)").count()
    page.evaluate(
        """() => {
          const cards = () => document.querySelectorAll('#cards .card:not(.adder)').length;
          window.most = 0;
          const told = new MutationObserver(() => { window.most = Math.max(window.most, cards()); });
          told.observe(document.getElementById('cards'), { subtree: true, childList: true });
        }"""
    )
    drop(page, "#tray", one, other)
    guarded.until("(before) => window.most === before + 2", before)
    guarded.until("(before) => document.querySelectorAll('#cards .card:not(.adder)').length < before + 2", before)
    page.wait_for_timeout(1000)  # the second one hears of it, too
    assert page.locator("#cards .card:not(.adder)").count() == before + 1


def test_what_cannot_be_used_says_why(pages: Pages, samples: Samples, tmp_path: Path) -> None:
    guarded = pages()
    page = guarded.open()
    guarded.expected.append("status of 415")
    text = tmp_path / "notes.txt"
    text.write_text("no clip at all")
    drop(page, "#picture", text)
    page.get_by_role("heading", name="notes.txt").wait_for()
    guarded.until("() => document.querySelector('.way.failed') !== null")
    assert "media type" in page.locator(".busy").inner_text()
    page.locator("#picture").get_by_role("button", name="Try again").wait_for()
    assert "could not be used" in page.locator("#assertive").inner_text()
    page.get_by_role("button", name="Choose another clip").click()
    page.get_by_role("button", name="Choose a clip").wait_for()

    drop(page, "#picture", cut_clip(samples.no_face_clip, tmp_path / "nobody.mp4", 0, 10))
    guarded.until("() => document.querySelector('.way.failed') !== null")
    assert "face" in page.locator(".busy").inner_text().lower()


def test_a_service_that_goes_away_is_told_of_and_takes_the_clip_when_it_is_there_again(pages: Pages) -> None:
    guarded = pages()
    page = guarded.open()
    guarded.expected += ["ERR_INTERNET_DISCONNECTED", "status of 415"]
    page.context.set_offline(True)
    clip = {"name": "clip.mp4", "mimeType": "video/mp4", "buffer": b"\0" * 1000}
    page.set_input_files("#picture input[type=file]", [clip])
    page.locator(".way.failed").get_by_text("The service does not answer").wait_for()
    page.context.set_offline(False)
    page.locator("#picture").get_by_role("button", name="Try again").click()
    page.locator(".way.failed").get_by_text("media type").first.wait_for()  # it has come there, and is no clip


def test_a_medium_is_deleted_only_when_that_is_confirmed(service: Service, pages: Pages, samples: Samples) -> None:
    medium = service.ready("/references", samples.portrait)
    guarded = pages()
    page = guarded.open()
    delete = page.get_by_role("button", name="Delete man_outdoor.jpg")
    delete.click()
    page.get_by_role("button", name="Keep").click()
    assert service.client.get(f"/references/{medium['id']}").status_code == 200
    delete.click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    delete.wait_for(state="detached")
    assert service.client.get(f"/references/{medium['id']}").status_code == 404
