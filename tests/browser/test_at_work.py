"""What hands do all day: keys, reloads, a service that is away for a moment, and files that are none."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route

from tests.browser.conftest import Guarded, OpenPage
from tests.browser.driving import READY, at_rest, drop
from tests.service.api.test_authentication import holder
from tests.service.fixtures import MP4, PNG, Api, make_ready, make_results

pytestmark = pytest.mark.timeout(300)


@dataclass
class Desk:
    """A service without a worker, with a clip, and the page."""

    api: Api
    video: dict[str, Any]
    guarded: Guarded

    def portrait(self, name: str) -> str:
        """Another portrait, ready; its id."""
        named = {"Content-Disposition": f'attachment; filename="{name}"'}
        medium = self.api.client.post("/references", content=PNG + name.encode(), headers=named).json()
        make_ready(self.api.services, medium["id"])
        return str(medium["id"])

    def asked(self, reference: str) -> str:
        """A look of the clip that waits; the id of its job."""
        job = {"video": self.video["id"], "looks": [{"reference": reference}]}
        return str(self.api.client.post("/transfer", json=job).json()["id"])

    def edit(self) -> Page:
        """The page with the clip, as after a reload."""
        page = self.guarded.open(f"/#{self.video['id']}")
        self.guarded.until(READY)
        return page


@pytest.fixture
def desk(api: Api, open_page: OpenPage, tiny_clip: Path) -> Desk:
    video = api.client.post("/videos", content=tiny_clip.read_bytes()).raise_for_status().json()
    make_ready(api.services, video["id"])
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected += ["status of 409", "status of 503"]  # pictures are made by a worker, which is not there
    return Desk(api, video, guarded)


#: a picture of one pixel
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
FRAME = "() => Number(document.querySelector('#transport .time').value)"
PLAYS = """() => {
  const video = document.querySelector('#picture video');
  return !video.paused && !video.hidden && video.currentTime > 0;
}"""
RESTS = "() => document.querySelector('#picture video').paused"


def test_keys_work_wherever_the_focus_is(desk: Desk) -> None:
    page = desk.edit()
    page.evaluate("() => document.activeElement.blur()")
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


def cut(route: Route) -> None:
    """As a service that is not there."""
    route.abort()


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


def test_a_file_that_cannot_be_played_is_stepped_through(desk: Desk) -> None:
    page = desk.edit()
    page.route("**/file", lambda route: route.fulfill(status=200, content_type="video/mp4", body="no clip"))
    play = page.get_by_role("button", name="Play", exact=True)
    play.click()
    page.get_by_text("This browser cannot play this format").wait_for()
    play.wait_for(state="hidden")
    page.keyboard.press("Period")
    assert page.evaluate(FRAME) == 1


@pytest.mark.parametrize(
    "away", ["videos/vid_*", "{videos,videos?*,videos/*,references?*,jobs?*}"], ids=["clip", "all"]
)
def test_a_service_that_is_away_for_a_moment_keeps_the_address(desk: Desk, away: str) -> None:
    page = desk.guarded.page
    hash_is = "(id) => location.hash === `#${id}`"
    problem = {"title": "Not just now", "code": "unavailable", "status": 503}
    # longer than the page waits by itself
    page.route(f"**/v1/{away}", lambda route: route.fulfill(status=503, headers={"Retry-After": "60"}, json=problem))
    desk.guarded.open(f"/#{desk.video['id']}")
    page.locator("#picture").get_by_text("Not just now").wait_for()
    assert page.evaluate(hash_is, desk.video["id"])
    assert page.locator("#start-hint").inner_text() == "The clip is not ready yet."
    page.unroute(f"**/v1/{away}")
    page.locator("#picture").get_by_role("button", name="Try again").click()
    desk.guarded.until(READY)
    assert page.evaluate(hash_is, desk.video["id"])
    page.reload()
    desk.guarded.until(READY)


def test_a_clip_that_is_gone_is_told_of(desk: Desk) -> None:
    assert desk.api.client.delete(f"/videos/{desk.video['id']}").status_code == 204
    desk.guarded.expected.append("status of 404")
    page = desk.guarded.open(f"/#{desk.video['id']}")
    page.locator("#toasts").get_by_text("This clip is no longer here").wait_for()
    assert page.evaluate("() => location.hash") == ""
    page.get_by_role("button", name="Choose a clip").wait_for()


def test_the_address_names_a_clip_while_it_is_vectorised(desk: Desk, tiny_clip: Path) -> None:
    content = tiny_clip.read_bytes() + b"\0\0\0\x08free"
    video = desk.api.client.post("/videos", content=content).raise_for_status().json()
    page = desk.guarded.page
    page.goto(f"{desk.guarded.root}/#{video['id']}")
    page.get_by_text("Waiting for a worker").wait_for()
    assert page.evaluate("() => location.hash") == f"#{video['id']}"


def test_a_portrait_that_cannot_be_used_leaves_the_stage_as_it_was(desk: Desk, tmp_path: Path) -> None:
    desk.portrait("face.png")
    desk.guarded.expected.append("status of 415")
    page = desk.edit()
    look = page.get_by_role("radio", name="Look", exact=True)
    assert look.is_checked()
    held: list[Route] = []
    page.route(
        "**/v1/references*", lambda route: held.append(route) if route.request.method == "POST" else route.continue_()
    )
    text = tmp_path / "notes.mp4"
    text.write_text("no clip at all")
    drop(page, "#tray", text)
    desk.guarded.heard(lambda: held)
    assert look.is_checked()
    detail = "is not one of the media types that there are, " * 12
    held[0].fulfill(status=415, json={"title": "Unsupported media type", "detail": detail, "code": "x", "status": 415})
    card = page.locator(".card.failed")
    card.wait_for()
    page.locator(".card.selected", has_text="face.png").wait_for()
    assert page.locator(".card.selected").count() == 1
    assert look.is_checked()
    lines = "(one) => one.getBoundingClientRect().height / parseFloat(getComputedStyle(one).lineHeight)"
    assert 2.5 < card.locator(".status").evaluate(lines) < 3.5
    assert detail.strip() in (card.locator(".pick").get_attribute("title") or "")
    # a finger has no tip to read: the panel says it whole
    card.locator(".pick").click()
    page.locator("#panel .problem").get_by_text(detail.strip()).wait_for()


def test_of_several_portraits_one_that_can_be_used_is_selected(desk: Desk, tmp_path: Path) -> None:
    desk.guarded.expected.append("status of 415")
    page = desk.edit()
    text, picture = tmp_path / "notes.mp4", tmp_path / "face.png"
    text.write_text("no clip at all")
    picture.write_bytes(PNG + b"a")
    drop(page, "#tray", text, picture)
    page.locator(".card.failed").wait_for()
    page.locator(".card.selected", has_text="face.png").wait_for()


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


#: every address that the page gives itself from now on
_WRITTEN = """() => {
  window.written = [];
  const replace = history.replaceState.bind(history);
  history.replaceState = (state, title, address) => {
    window.written.push(address);
    replace(state, title, address);
  };
}"""

FOCUS = "() => document.activeElement.getAttribute('aria-label') ?? document.activeElement.id"


def test_the_skip_link_leaves_the_address_and_a_bookmark_opens_its_clip(desk: Desk, tiny_clip: Path) -> None:
    content = tiny_clip.read_bytes() + b"\0\0\0\x08free"
    named = {"Content-Disposition": 'attachment; filename="other.mp4"'}
    other = desk.api.client.post("/videos", content=content, headers=named).raise_for_status().json()
    make_ready(desk.api.services, other["id"])
    page = desk.edit()
    page.locator(".skip").focus()
    page.keyboard.press("Enter")
    assert page.evaluate(FOCUS) == "stage"
    assert page.evaluate("() => location.hash") == f"#{desk.video['id']}"
    # in between, too, it names a clip: a reload may come at any time
    page.evaluate(_WRITTEN)
    page.evaluate("(id) => { location.hash = id; }", other["id"])
    page.get_by_role("heading", name="other.mp4").wait_for()
    desk.guarded.until(READY)
    assert page.evaluate("() => window.written") == []


def test_a_bookmark_of_a_clip_that_failed_says_why(desk: Desk) -> None:
    page = desk.guarded.page
    failed = {"state": "failed", "error": {"title": "No face was found", "detail": "in none of 95 frames"}}
    page.route(f"**/v1/videos/{desk.video['id']}", lambda route: route.fulfill(json=route.fetch().json() | failed))
    desk.guarded.open(f"/#{desk.video['id']}")
    page.locator("#picture").get_by_text("in none of 95 frames").wait_for()
    page.get_by_role("button", name="Choose another clip").wait_for()


def test_a_clip_that_is_closed_leaves_lists_that_are_up_to_date(desk: Desk, tiny_clip: Path) -> None:
    page = desk.edit()
    desk.api.client.post("/videos", content=tiny_clip.read_bytes() + b"\0\0\0\x08free").raise_for_status()
    desk.asked(desk.portrait("face.png"))
    page.get_by_role("button", name="Close the clip").click()
    page.locator(".clip-card").nth(1).wait_for()
    page.locator(".job").wait_for()


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


@pytest.mark.parametrize("does", ["selects", "sets"])
def test_what_is_done_to_a_look_is_seen_while_another_is_compared(desk: Desk, tiny_clip: Path, does: str) -> None:
    job = desk.asked(desk.portrait("face.png"))
    make_results(desk.api.services, job, [tiny_clip.read_bytes()])
    page = desk.edit()
    page.get_by_role("button", name="Compare face.png before and after").click()
    back = page.get_by_role("button", name="Back to the look")
    back.wait_for()
    if does == "selects":
        page.get_by_role("button", name="face.png", exact=True).click()
    else:
        page.get_by_role("slider", name="Strength").fill("0.5")
    back.wait_for(state="detached")
    page.get_by_role("radio", name="Look", exact=True).wait_for(state="attached")


def test_a_clip_that_was_not_taken_in_cannot_be_deleted(desk: Desk, tmp_path: Path) -> None:
    desk.guarded.expected.append("status of 415")
    page = desk.edit()
    delete = page.get_by_role("button", name="Delete the clip")
    assert delete.is_visible()
    text = tmp_path / "notes.mp4"
    text.write_text("no clip at all")
    drop(page, "#picture", text)
    page.locator(".way.failed").wait_for()
    assert not delete.is_visible()


def test_the_panel_is_seen_whole_while_nothing_is_rendered(desk: Desk) -> None:
    for name in ("one.png", "two.png"):
        desk.portrait(name)
    page = desk.edit()
    assert page.evaluate(
        "() => { const p = document.getElementById('panel'); return p.scrollHeight <= p.clientHeight; }"
    )


def test_a_clip_that_somebody_else_deleted_is_told_of_and_goes(desk: Desk) -> None:
    desk.guarded.expected.append("status of 404")
    page = desk.edit()
    assert desk.api.client.delete(f"/videos/{desk.video['id']}").status_code == 204
    page.keyboard.press("Period")
    page.locator("#picture").get_by_text("This clip is no longer here").wait_for()
    page.get_by_role("button", name="Delete the clip").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    page.get_by_role("button", name="Choose a clip").wait_for()
    page.locator(".clip-card").first.wait_for(state="detached")


def test_the_queue_is_that_of_the_clip_on_the_stage(desk: Desk, tiny_clip: Path, tmp_path: Path) -> None:
    desk.asked(desk.portrait("face.png"))
    page = desk.edit()
    page.locator(".job").wait_for()
    other = tmp_path / "other.mp4"
    other.write_bytes(tiny_clip.read_bytes() + b"\0\0\0\x08free")
    drop(page, "#picture", other)
    page.locator(".way").wait_for()
    assert page.locator(".job").count() == 0


def test_what_was_rendered_is_not_told_before_it_is_known(desk: Desk) -> None:
    desk.asked(desk.portrait("face.png"))
    page = desk.guarded.page
    page.route("**/v1/jobs?*", lambda route: route.fulfill(status=503, json={"title": "Not just now", "status": 503}))
    desk.guarded.open(f"/#{desk.video['id']}")
    desk.guarded.until(READY)
    page.get_by_text("Not just now").first.wait_for()
    assert not page.get_by_text("Nothing rendered yet").is_visible()


def test_messages_leave_the_button_that_renders_free(desk: Desk) -> None:
    page = desk.edit()
    page.evaluate("""async () => {
        const { failure } = await import(new URL("notices.js", document.querySelector("script[type=module]").src));
        for (const number of [1, 2, 3]) failure(new Error(`It did not work, for the reason with the number ${number}`));
    }""")
    page.locator(".toast").nth(2).wait_for()
    desk.guarded.expected.append("It did not work")
    shown, button = page.locator(".toasts"), page.get_by_role("button", name="Render", exact=True)
    left, right = shown.bounding_box(), button.bounding_box()
    assert left is not None
    assert right is not None
    assert left["x"] + left["width"] <= right["x"]


COMPARED = """() => {
  const both = [...document.querySelectorAll('#picture video')];
  return both.length === 2 && both.every((one) => one.readyState > 1 && !one.hidden);
}"""


def test_a_look_that_is_compared_brings_its_clip_to_the_stage(desk: Desk, tiny_clip: Path) -> None:
    job = desk.asked(desk.portrait("face.png"))
    make_results(desk.api.services, job, [tiny_clip.read_bytes()])
    page = desk.guarded.open()
    page.get_by_role("button", name="Compare face.png before and after").click()
    desk.guarded.until(COMPARED)
    assert page.evaluate("() => location.hash") == f"#{desk.video['id']}"
    assert page.locator("#transport .time").get_attribute("max") != "0"
    assert not page.locator(".note").is_visible()
    page.keyboard.press("Period")
    desk.guarded.until("() => document.querySelectorAll('#picture video')[1].currentTime > 0")
    desk.guarded.until(
        """() => {
          const [one, other] = document.querySelectorAll('#picture video');
          return !one.seeking && !other.seeking && Math.abs(one.currentTime - other.currentTime) < 1e-3;
        }"""
    )
    page.get_by_role("button", name="Back to the look").click()
    page.get_by_role("radio", name="Look", exact=True).wait_for(state="attached")


@pytest.mark.parametrize("path", ["results/*", "videos/*/file"], ids=["result", "clip"])
def test_a_comparison_whose_files_nobody_gives_is_tried_again(desk: Desk, tiny_clip: Path, path: str) -> None:
    job = desk.asked(desk.portrait("face.png"))
    make_results(desk.api.services, job, [tiny_clip.read_bytes()])
    desk.guarded.expected.append("ERR_FAILED")
    page = desk.edit()
    page.route(f"**/v1/{path}", cut)
    page.get_by_role("button", name="Compare face.png before and after").click()
    page.locator(".note").get_by_text("The service does not answer").wait_for()
    page.unroute(f"**/v1/{path}")
    page.locator(".note").get_by_role("button", name="Try again").click()
    desk.guarded.until(COMPARED)
    assert not page.locator(".note").is_visible()
    page.get_by_role("button", name="Play", exact=True).click()
    desk.guarded.until("() => document.querySelectorAll('#picture video')[1].currentTime > 0")


def test_a_look_whose_clip_was_deleted_meanwhile_is_told_of(desk: Desk, tiny_clip: Path) -> None:
    job = desk.asked(desk.portrait("face.png"))
    make_results(desk.api.services, job, [tiny_clip.read_bytes()])
    desk.guarded.expected.append("status of 404")
    page = desk.guarded.open()
    assert desk.api.client.delete(f"/videos/{desk.video['id']}").status_code == 204
    page.get_by_role("button", name="Compare face.png before and after").click()
    page.locator("#toasts").get_by_text("The clip of this result is no longer here").wait_for()
    page.locator(".result").get_by_text("No longer kept").wait_for()
    page.get_by_role("button", name="Choose a clip").wait_for()


def test_a_long_name_leaves_the_question_whether_to_delete_in_its_bounds(desk: Desk) -> None:
    desk.portrait("a_portrait_with_a_name_of_one_word_" * 5 + ".png")
    page = desk.guarded.open()
    page.get_by_role("button", name="Delete a_portrait").click()
    dialog = page.get_by_role("dialog")
    around = dialog.bounding_box()
    button = dialog.get_by_role("button", name="Delete").bounding_box()
    assert around is not None
    assert button is not None
    assert button["x"] + button["width"] < around["x"] + around["width"]
    assert dialog.evaluate("(one) => one.scrollWidth <= one.clientWidth")


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


def test_a_thumbnail_that_could_not_be_had_comes_later(desk: Desk) -> None:
    page = desk.guarded.page
    page.clock.install()
    problem = {"title": "Not just now", "code": "unavailable", "status": 503}
    page.route("**/poster", lambda route: route.fulfill(status=503, headers={"Retry-After": "60"}, json=problem))
    with page.expect_response("**/poster"):
        desk.guarded.open()
    page.unroute("**/poster")
    page.route("**/poster", lambda route: route.fulfill(content_type="image/png", body=PIXEL))
    page.wait_for_timeout(500)
    page.clock.fast_forward("00:10")
    page.locator(".clip-card .thumb.loaded").wait_for(state="attached")


def test_a_clip_that_is_on_its_way_becomes_ready_in_the_list(desk: Desk, tiny_clip: Path) -> None:
    content = tiny_clip.read_bytes() + b"\0\0\0\x08free"
    other = desk.api.client.post("/videos", content=content).raise_for_status().json()
    page = desk.guarded.page
    page.route("**/poster", lambda route: route.fulfill(content_type="image/png", body=PIXEL))
    desk.guarded.open()
    card = page.locator(".clip-card").first
    assert "On its way" in card.inner_text()
    make_ready(desk.api.services, other["id"])
    card.get_by_text("On its way").wait_for(state="detached")
    card.locator(".thumb.loaded").wait_for(state="attached")


def stopped(desk: Desk, path: str, name: str, content: bytes) -> dict[str, Any]:
    """A medium whose vectorisation was canceled."""
    named = {"Content-Disposition": f'attachment; filename="{name}"'}
    medium: dict[str, Any] = desk.api.client.post(path, content=content, headers=named).raise_for_status().json()
    assert desk.api.client.post(f"/jobs/{medium['job']}/cancel").status_code == 202
    return medium


def test_every_clip_is_reached_also_one_that_was_stopped(desk: Desk) -> None:
    clips = [stopped(desk, "/videos", f"{n}.mp4", MP4 + bytes([n])) for n in range(7)]
    page = desk.guarded.open()
    cards = page.locator(".clip-card")
    assert cards.count() == 6
    more = page.locator(".past").get_by_role("button", name="Show more")
    more.click()
    desk.guarded.until("() => document.querySelectorAll('.clip-card').length === 8")
    more.wait_for(state="hidden")
    assert "canceled" in cards.first.inner_text()
    page.get_by_role("button", name="Delete 6.mp4").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    desk.guarded.until("() => document.querySelectorAll('.clip-card').length === 7")
    assert desk.api.client.get(f"/videos/{clips[-1]['id']}").status_code == 404
    cards.first.click()
    page.locator("#picture .big").get_by_text("canceled").wait_for()


def test_the_focus_of_a_portrait_that_is_deleted_is_its_neighbours(desk: Desk) -> None:
    for n in range(25):
        stopped(desk, "/references", f"{n}.png", PNG + bytes([n]))
    page = desk.guarded.open()
    page.locator("#tray").get_by_role("button", name="Show more").wait_for()
    page.get_by_role("button", name="Delete 24.png").focus()
    page.keyboard.press("Enter")
    page.get_by_role("dialog").get_by_role("button", name="Delete").press("Enter")
    page.get_by_role("button", name="24.png", exact=True).wait_for(state="detached")
    assert page.evaluate(FOCUS) == "23.png"


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


def test_an_answer_that_comes_after_the_end_of_its_job_changes_nothing(desk: Desk) -> None:
    job = desk.asked(desk.portrait("face.png"))
    page = desk.edit()
    page.locator(".job").get_by_text("Queued").wait_for()
    held: list[Route] = []
    page.route("**/cancel", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    before = desk.api.client.get(f"/jobs/{job}").json()
    page.locator(".job").get_by_role("button", name="Cancel").click()
    desk.guarded.heard(lambda: held)
    assert desk.api.client.post(f"/jobs/{job}/cancel").status_code == 202
    page.locator(".job[data-state=canceled]").wait_for()
    held[0].fulfill(status=202, json=before | {"state": "canceling"})
    page.locator("#polite").get_by_text("Canceled").wait_for(state="attached")
    page.wait_for_timeout(200)
    assert page.locator(".job").get_attribute("data-state") == "canceled"


def test_a_job_that_comes_when_another_clip_is_open_is_not_in_its_queue(desk: Desk, tiny_clip: Path) -> None:
    content = tiny_clip.read_bytes() + b"\0\0\0\x08free"
    named = {"Content-Disposition": 'attachment; filename="other.mp4"'}
    other = desk.api.client.post("/videos", content=content, headers=named).raise_for_status().json()
    make_ready(desk.api.services, other["id"])
    desk.portrait("face.png")
    page = desk.edit()
    held: list[Route] = []
    page.route("**/v1/transfer", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    page.get_by_role("checkbox", name="Render face.png").check()
    page.locator("#look").get_by_role("button", name="Render").click()
    desk.guarded.heard(lambda: held)
    page.evaluate("(id) => { location.hash = id; }", other["id"])
    page.get_by_role("heading", name="other.mp4").wait_for()
    desk.guarded.until(READY)
    held[0].continue_()
    page.locator("#polite").get_by_text("Rendering 1 look").wait_for(state="attached")
    page.wait_for_timeout(200)
    assert page.locator(".job").count() == 0
    page.evaluate("(id) => { location.hash = id; }", desk.video["id"])
    page.locator(".job").get_by_text("Queued").wait_for()


@pytest.mark.parametrize("uploaded", [False, True], ids=["uploading", "vectorizing"])
def test_a_portrait_that_is_deleted_on_its_way_is_no_failure(desk: Desk, tmp_path: Path, uploaded: bool) -> None:
    desk.guarded.expected.append("status of 404")
    page = desk.edit()
    held: list[Route] = []
    if not uploaded:
        page.route("**/v1/references", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    picture = tmp_path / "face.png"
    picture.write_bytes(PNG + b"on its way")
    drop(page, "#tray", picture)
    if uploaded:
        page.locator(".card").get_by_text("Waiting for a worker").wait_for()
    else:
        desk.guarded.heard(lambda: held)
    page.get_by_role("button", name="Delete face.png").click()
    if uploaded:
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    page.get_by_role("button", name="face.png", exact=True).wait_for(state="detached")
    page.wait_for_timeout(1000)  # the end of its job is heard of, too
    assert page.locator("#assertive").inner_text() == ""


def test_every_portrait_is_reached_and_has_its_name_in_the_queue(desk: Desk) -> None:
    desk.asked(desk.portrait("old.png"))
    for n in range(24):
        stopped(desk, "/references", f"{n}.png", PNG + bytes([n]))
    page = desk.guarded.open()
    cards = page.locator(".card:not(.adder)")
    assert cards.count() == 24
    title = page.locator(".job h3")
    assert title.inner_text() == "1 look: a portrait that is not listed here"
    assert page.get_by_role("checkbox", name="Render 0.png").is_disabled()
    page.locator("#tray").get_by_role("button", name="Show more").click()
    title.get_by_text("1 look: old.png").wait_for()
    assert cards.count() == 25
    assert page.locator("#tray").get_by_role("button", name="Show more").count() == 0
    page.get_by_role("button", name="Delete 0.png").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    desk.guarded.until("() => document.querySelectorAll('.card:not(.adder)').length === 24")


def test_every_job_is_reached(desk: Desk) -> None:
    look = {"reference": desk.portrait("face.png")}
    for seed in range(21):
        asked = {"video": desk.video["id"], "looks": [look | {"seed": seed}]}
        job = desk.api.client.post("/transfer", json=asked).raise_for_status().json()
        desk.api.client.post(f"/jobs/{job['id']}/cancel")
    page = desk.edit()
    page.locator("#queue").get_by_role("button", name="Show more").click()
    desk.guarded.until("() => document.querySelectorAll('.job').length === 21")
    page.locator("#queue").get_by_role("button", name="Show more").wait_for(state="hidden")


@pytest.mark.parametrize(
    ("content", "output"),
    [(MP4 + b"again", {"container": "mov", "codec": "prores", "extras": ["matte"]}), (PNG, {"container": "tiff"})],
    ids=["clip", "picture"],
)
def test_a_job_is_tried_again_as_it_was_asked_for(desk: Desk, content: bytes, output: dict[str, Any]) -> None:
    client = desk.api.client
    video = client.post("/videos", content=content).raise_for_status().json()
    make_ready(desk.api.services, video["id"])
    look = {"reference": desk.portrait("face.png"), "light": 0.3, "seed": 7, "beta": 0.5, "iterations": 9}
    asked = {"video": video["id"], "looks": [look], "output": output}
    job = client.post("/transfer", json=asked).raise_for_status().json()
    client.post(f"/jobs/{job['id']}/cancel")
    page = desk.guarded.open()  # no clip is on the stage
    page.get_by_role("button", name="Try again").click()
    desk.guarded.until("() => document.querySelectorAll('.job').length === 2")
    made = client.get("/jobs?kind=transfer").json()["data"][0]
    assert made["id"] != job["id"]
    assert made["looks"][0]["options"] == job["looks"][0]["options"]
    assert made["output"] == job["output"]
