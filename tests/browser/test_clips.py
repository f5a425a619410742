"""Clips that are opened, bookmarked, closed and deleted, while the service is there and while it is away."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Dialog, Route

from tests.browser.desk import FOCUS, PIXEL, Desk, stopped
from tests.browser.driving import READY, drop
from tests.service.fixtures import MP4, make_ready

pytestmark = pytest.mark.timeout(300)


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


def test_a_clip_whose_end_the_service_could_not_tell_is_tried_again_without_its_file(
    desk: Desk, tiny_clip: Path
) -> None:
    content = tiny_clip.read_bytes() + b"\0\0\0\x08free"
    video = desk.api.client.post("/videos", content=content).raise_for_status().json()
    page = desk.guarded.page
    page.goto(f"{desk.guarded.root}/#{video['id']}")
    page.get_by_text("Waiting for a worker").wait_for()
    problem = {"title": "Not just now", "code": "unavailable", "status": 503}
    at = f"**/v1/videos/{video['id']}"
    page.route(at, lambda route: route.fulfill(status=503, headers={"Retry-After": "60"}, json=problem))
    make_ready(desk.api.services, video["id"])
    page.locator("#picture").get_by_text("Not just now").wait_for()
    page.unroute(at)
    page.locator("#picture").get_by_role("button", name="Try again").click()
    desk.guarded.until(READY)


#: every address that the page gives itself from now on
_WRITTEN = """() => {
  window.written = [];
  for (const kind of ['pushState', 'replaceState']) {
    const write = history[kind].bind(history);
    history[kind] = (state, title, address) => {
      window.written.push(address);
      write(state, title, address);
    };
  }
}"""


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


def test_back_and_forward_go_between_the_list_and_the_clips_that_were_opened(desk: Desk) -> None:
    desk.guarded.expected.append("status of 404")  # a frame of what is deleted
    page = desk.guarded.open()
    hash_is = "(hash) => location.hash === hash"
    page.locator(".clip-card").click()
    desk.guarded.until(READY)
    page.go_back()
    page.get_by_role("button", name="Choose a clip").wait_for()
    assert page.evaluate(hash_is, "")
    page.go_forward()
    desk.guarded.until(READY)
    assert page.evaluate(hash_is, f"#{desk.video['id']}")
    page.get_by_role("button", name="Close the clip").click()
    page.get_by_role("button", name="Choose a clip").wait_for()
    page.go_back()
    desk.guarded.until(READY)
    page.get_by_role("button", name="Delete the clip").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    page.get_by_role("button", name="Choose a clip").wait_for()
    page.go_back()  # to what is before it: there is no way to a clip that is gone
    desk.guarded.until(hash_is, "")
    assert page.locator("#toasts").get_by_text("no longer here").count() == 0


def test_a_clip_that_comes_after_its_address_was_left_is_not_opened(desk: Desk) -> None:
    page, held = desk.guarded.open(), list[Route]()
    page.locator(".clip-card").click()
    desk.guarded.until(READY)
    page.go_back()
    page.get_by_role("button", name="Choose a clip").wait_for()
    page.route(f"**/v1/videos/{desk.video['id']}", lambda route: held.append(route))  # noqa: PLW0108
    page.go_forward()
    desk.guarded.heard(lambda: held)
    page.go_back()
    with page.expect_response(f"**/v1/videos/{desk.video['id']}"):
        held[0].continue_()
    page.wait_for_timeout(300)  # more than the page takes to open it
    assert page.evaluate("() => location.hash") == ""
    assert page.get_by_role("button", name="Choose a clip").is_visible()


def test_back_asks_before_it_drops_what_is_uploaded(desk: Desk, tiny_clip: Path, tmp_path: Path) -> None:
    page, held = desk.edit(), list[Route]()
    page.route("**/v1/uploads/*", lambda route: held.append(route))  # noqa: PLW0108
    other = tmp_path / "other.mp4"
    other.write_bytes(tiny_clip.read_bytes() + b"\0\0\0\x08free")
    drop(page, "#picture", other)
    desk.guarded.heard(lambda: held)
    page.go_back()
    page.get_by_role("dialog").get_by_role("button", name="Keep").click()
    desk.guarded.until("() => location.hash === ''")
    assert page.get_by_role("heading", name="other.mp4").is_visible()
    page.go_back()
    page.get_by_role("dialog").get_by_role("button", name="Stop it").click()
    desk.guarded.until(READY)
    assert page.evaluate("() => location.hash") == f"#{desk.video['id']}"


def test_the_browser_asks_before_a_file_that_is_uploaded_goes_with_the_page(desk: Desk, tiny_clip: Path) -> None:
    page, held, asked = desk.guarded.open(), list[Route](), list[str]()

    def dismiss(dialog: Dialog) -> None:
        asked.append(dialog.type)
        dialog.dismiss()

    page.on("dialog", dismiss)
    page.route("**/v1/uploads/*", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    drop(page, "#picture", tiny_clip)
    desk.guarded.heard(lambda: held)
    page.get_by_role("heading", name="Portraits").click()  # browsers ask those who have done something
    page.evaluate("() => { setTimeout(() => location.reload()); }")
    desk.guarded.heard(lambda: asked)
    held[0].continue_()
    desk.guarded.until(READY)
    page.reload()
    desk.guarded.until(READY)
    assert asked == ["beforeunload"]


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
