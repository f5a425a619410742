"""What hands do on the stage: keys, playing, frames, and files that do not come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Route

from tests.browser.desk import FOCUS, PIXEL, Desk, cut
from tests.browser.driving import READY, at_rest
from tests.service.api.test_authentication import holder
from tests.service.fixtures import make_ready

pytestmark = pytest.mark.timeout(300)


FRAME = "() => Number(document.querySelector('#transport .time').value)"


PLAYS = """() => {
  const video = document.querySelector('#picture video');
  return !video.paused && !video.hidden && video.currentTime > 0;
}"""


RESTS = "() => document.querySelector('#picture video').paused"


def test_keys_work_on_the_whole_stage(desk: Desk) -> None:
    page = desk.edit()
    told = [page.get_by_role("button", name=f"One frame {way}").get_attribute("title") for way in ("back", "on")]
    assert told == ["One frame back (,)", "One frame on (.)"]
    page.locator("#stage-name").click()  # as anything of the stage that is no control
    for key, frame in (("Period", 1), ("Period", 2), ("Comma", 1)):
        page.keyboard.press(key)
        assert page.evaluate(FRAME) == frame
    # a button that was pressed last has Space, and no other key
    page.get_by_role("button", name="One frame on").click()
    page.keyboard.press("Period")
    assert page.evaluate(FRAME) == 3
    page.keyboard.press("Space")
    assert page.evaluate(FRAME) == 4
    page.get_by_role("radio", name="Mask").check()
    page.keyboard.press("Comma")
    assert page.evaluate(FRAME) == 3
    page.get_by_role("slider", name="Frame").focus()
    page.keyboard.press("Period")
    assert page.evaluate(FRAME) == 4


def test_single_characters_do_nothing_outside_the_stage(desk: Desk) -> None:
    desk.portrait("one.png")
    page = desk.edit()
    page.evaluate("() => document.activeElement.blur()")
    page.keyboard.type(".,.")
    assert page.evaluate(FRAME) == 0
    page.get_by_role("slider", name="Strength").focus()
    page.keyboard.type("..")
    assert page.evaluate(FRAME) == 0
    page.get_by_role("slider", name="Frame").focus()
    page.keyboard.type(".")
    assert page.evaluate(FRAME) == 1


def test_keys_are_left_to_what_is_written_or_asked(desk: Desk) -> None:
    page = desk.edit()
    page.get_by_role("button", name="Delete the clip").click()
    page.keyboard.press("Period")
    page.get_by_role("button", name="Keep").click()
    page.evaluate("() => document.getElementById('picture').append(document.createElement('textarea'))")
    page.locator("#picture textarea").fill("a")
    page.keyboard.type(" .")
    assert page.locator("#picture textarea").input_value() == "a ."
    assert page.evaluate(FRAME) == 0


def test_space_scrolls_where_nothing_plays(desk: Desk) -> None:
    page = desk.guarded.open()
    page.evaluate("() => window.addEventListener('keydown', (event) => { window.kept = event.defaultPrevented; })")
    page.keyboard.press("Space")
    assert page.evaluate("() => window.kept") is False


def test_a_clip_plays_after_a_reload(desk: Desk) -> None:
    page = desk.edit()
    page.keyboard.press("Period")
    page.get_by_role("button", name="Play", exact=True).click()
    desk.guarded.until(PLAYS)
    page.get_by_role("button", name="Pause").click()
    desk.guarded.until(RESTS)
    page.evaluate("() => document.activeElement.blur()")
    page.keyboard.press("Space")
    desk.guarded.until(PLAYS)


def test_a_clip_plays_after_a_reload_with_a_key(desk: Desk, tiny_clip: Path) -> None:
    key = holder(desk.api)
    video = key.post("/videos", content=tiny_clip.read_bytes()).json()
    make_ready(desk.api.services, video["id"])
    desk.guarded.expected.append("status of 401")
    page = desk.guarded.page
    page.goto(f"{desk.guarded.root}/#{video['id']}")
    page.get_by_label("Key", exact=True).fill(key.text)
    page.keyboard.press("Enter")
    desk.guarded.until(READY)
    page.get_by_role("button", name="Play", exact=True).click()
    desk.guarded.until(PLAYS)


def refuse(route: Route) -> None:
    """As a service that is not ready."""
    route.fulfill(status=503, body="{}")


@pytest.mark.parametrize("fail", [refuse, cut])
def test_a_file_that_does_not_come_is_asked_for_again(desk: Desk, fail: Callable[[Route], None]) -> None:
    desk.guarded.expected.append("ERR_FAILED")
    page = desk.edit()
    page.route("**/file", fail)
    play = page.get_by_role("button", name="Play", exact=True)
    play.click()
    page.get_by_text("The clip cannot be played just now").first.wait_for()
    page.unroute("**/file")
    play.click()
    desk.guarded.until(PLAYS)


@pytest.mark.parametrize("heard", [False, True])
def test_a_file_that_cannot_be_played_is_stepped_through(desk: Desk, heard_clip: Path, heard: bool) -> None:
    page = desk.edit()
    body = heard_clip.read_bytes() if heard else b"no clip"
    page.route("**/file", lambda route: route.fulfill(status=200, content_type="video/mp4", body=body))
    play = page.get_by_role("button", name="Play", exact=True)
    play.click()
    page.get_by_text("This browser cannot play this format").wait_for()
    play.wait_for(state="hidden")
    page.keyboard.press("Period")
    assert page.evaluate(FRAME) == 1


def test_what_is_the_matter_is_said_over_the_whole_stage_however_narrow_the_clip_is(desk: Desk) -> None:
    desk.guarded.page.set_viewport_size({"width": 360, "height": 740})
    page = desk.edit()
    page.route("**/file", lambda route: route.fulfill(status=200, content_type="video/mp4", body="no clip"))
    page.get_by_role("button", name="Play", exact=True).click()
    page.get_by_text("This browser cannot play this format").wait_for()
    page.evaluate("() => document.querySelector('.frame').style.setProperty('--ratio', '0.5')")
    note, stage = (page.locator(one).bounding_box() for one in (".note", ".holder"))
    assert note is not None
    assert stage is not None
    assert note["width"] > 0.8 * stage["width"]
    assert stage["x"] <= note["x"] <= note["x"] + note["width"] <= stage["x"] + stage["width"]


@pytest.mark.parametrize(("kind", "words"), [("image", "Still picture"), ("video", "1 frame")])
def test_a_picture_is_told_from_a_clip_of_one_frame(desk: Desk, kind: str, words: str) -> None:
    page = desk.guarded.page
    media = desk.api.client.get(f"/videos/{desk.video['id']}").json()["media"] | {"kind": kind, "frame_count": 1}

    def shorter(route: Route) -> None:
        answer = route.fetch()
        body = answer.json()
        for one in body.get("data", [body]):
            one["media"] = media
        route.fulfill(response=answer, json=body)

    page.route("**/v1/videos?*", shorter)
    page.route("**/v1/videos/vid_*", shorter)
    desk.guarded.open()
    card = page.locator(".clip-card")
    assert words in card.inner_text()
    card.click()
    page.locator("#stage-facts").get_by_text(words).wait_for()


def test_the_focus_stays_where_the_work_is(desk: Desk) -> None:
    desk.guarded.expected.append("status of 404")  # a picture of what is deleted may be under way
    for name in ("one.png", "two.png"):
        desk.portrait(name)
    page = desk.guarded.open()

    def press(name: str, *, exact: bool = True) -> None:
        page.get_by_role("button", name=name, exact=exact).first.focus()
        page.keyboard.press("Enter")

    page.locator(".clip-card").focus()
    page.keyboard.press("Enter")
    desk.guarded.until(READY)
    assert page.evaluate(FOCUS) == "stage"
    page.get_by_role("slider", name="Strength").fill("0.5")
    press("Reset")
    assert page.evaluate("() => document.activeElement.labels[0].textContent") == "Strength"
    page.get_by_role("checkbox", name="Render one.png").check()
    press("Render")
    page.locator(".job").get_by_text("Queued").wait_for()
    assert page.evaluate("() => document.activeElement.textContent") == "Render"
    press("Cancel")
    page.locator(".job[data-state=canceled]").wait_for()
    assert page.evaluate("() => document.activeElement.className") == "job"
    press("Delete two.png")
    page.get_by_role("dialog").get_by_role("button", name="Delete").press("Enter")
    page.get_by_role("button", name="two.png", exact=True).wait_for(state="detached")
    assert page.evaluate(FOCUS) == "one.png"
    press("Close the clip", exact=False)
    page.get_by_role("button", name="Choose a clip").wait_for()
    assert page.evaluate(FOCUS) == "stage"


def test_the_clock_is_not_read_out_as_it_runs(desk: Desk) -> None:
    page = desk.edit()
    assert page.locator(".clock").inner_text() != ""
    assert page.locator("#transport :is(output, [role=status], [aria-live])").count() == 0


def test_a_frame_that_could_not_be_drawn_is_tried_again(desk: Desk) -> None:
    desk.portrait("face.png")
    page = desk.guarded.page
    problem = {"title": "Not just now", "code": "unavailable", "status": 503}
    asked: list[Route] = []

    def away(route: Route) -> None:
        asked.append(route)
        route.fulfill(status=503, headers={"Retry-After": "60"}, json=problem)

    page.route("**/v1/preview", away)
    desk.edit()
    page.locator(".note").get_by_text("Not just now").wait_for()
    before = len(asked)
    page.locator(".note").get_by_role("button", name="Try again").click()
    desk.guarded.heard(lambda: len(asked) > before)
    page.locator(".note").get_by_text("Not just now").wait_for()
    page.unroute("**/v1/preview")
    page.route("**/v1/preview", lambda route: route.fulfill(content_type="image/png", body=PIXEL))
    page.locator(".note").get_by_role("button", name="Try again").click()
    at_rest(desk.guarded)
    assert not page.locator(".note").is_visible()


def test_of_two_pictures_the_one_that_was_asked_for_last_is_shown(desk: Desk) -> None:
    page = desk.guarded.open()
    shown = page.evaluate("""async () => {
        const { showPicture } = await import(new URL("dom.js", document.querySelector("script[type=module]").src));
        const held = [];
        HTMLImageElement.prototype.decode = () => new Promise((resolve) => { held.push(resolve); });
        const image = new Image();
        const [one, other] = [1, 2].map(() => URL.createObjectURL(new Blob([], { type: "image/png" })));
        const works = [showPicture(image, one), showPicture(image, other)];
        held[1]();
        await works[1];
        const seen = [image.src === other];
        held[0]();
        await works[0];
        seen.push(image.src === other);
        // back to the one that is shown, while another one is decoded
        const late = showPicture(image, one);
        await showPicture(image, other);
        held[2]();
        await late;
        return [...seen, image.src === other];
    }""")
    assert shown == [True, True, True]
