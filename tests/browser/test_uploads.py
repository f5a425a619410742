"""Files on their way from the page to the service: connections break, and whoever sends them changes their mind."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route

from tests.browser.desk import Desk, cut
from tests.browser.driving import drop
from tests.service.fixtures import MP4

pytestmark = pytest.mark.timeout(300)

PATCHES = "**/v1/uploads/*"
#: pauses pass a hundred times as fast, and those of minutes never
_HASTE = "const slow = setTimeout; window.setTimeout = (act, ms) => (ms > 60_000 ? 0 : slow(act, ms / 100));"
#: the first byte goes at once, as the browser sees it
_BEGINS = """const { send } = XMLHttpRequest.prototype;
XMLHttpRequest.prototype.send = function (body) {
  send.call(this, body);
  this.upload.dispatchEvent(new ProgressEvent("progress", { lengthComputable: true, loaded: 1, total: body.size }));
};"""


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    path = tmp_path / "clip.mp4"
    path.write_bytes(MP4 + b"\0" * 1000)
    return path


def uploads(desk: Desk) -> list[dict[str, Any]]:
    """What the service keeps of files that have not arrived."""
    found: list[dict[str, Any]] = desk.api.client.get("/uploads").json()["data"]
    return found


def arrives_in_part(desk: Desk, clip: Path, size_bytes: int) -> Callable[[Route], None]:
    """A connection that breaks once the service has so many bytes."""

    def handle(route: Route) -> None:
        headers = route.request.headers | {"content-length": str(size_bytes)}
        at = int(headers["upload-offset"])
        desk.api.client.patch(
            f"/uploads/{route.request.url.rpartition('/')[2]}",
            content=clip.read_bytes()[at : at + size_bytes],
            headers={name: headers[name] for name in ("tus-resumable", "upload-offset", "content-type")},
        ).raise_for_status()
        route.abort("connectionreset")

    return handle


def begin(desk: Desk, clip: Path, handle: Callable[[Route], Any]) -> Page:
    """A clip that is dropped, with what becomes of requests to its upload."""
    desk.guarded.page.add_init_script(_HASTE)
    desk.guarded.expected.append("net::ERR_")
    page = desk.guarded.open()
    page.route(PATCHES, handle)
    drop(page, "#picture", clip)
    return page


def test_an_upload_goes_on_where_its_connection_broke(desk: Desk, clip: Path) -> None:
    offsets: list[int] = []
    breaks = arrives_in_part(desk, clip, 400)

    def handle(route: Route) -> None:
        if route.request.method != "PATCH":
            route.continue_()
            return
        offsets.append(int(route.request.headers["upload-offset"]))
        if len(offsets) < 3:
            breaks(route)
        else:
            route.continue_()

    page = begin(desk, clip, handle)
    page.get_by_text("Waiting for a worker").wait_for()
    assert offsets == [0, 400, 800]
    newest = desk.api.client.get("/videos").json()["data"][0]
    assert (newest["filename"], newest["sha256"]) == ("clip.mp4", hashlib.sha256(clip.read_bytes()).hexdigest())
    assert uploads(desk) == []


def test_a_large_file_that_is_no_clip_is_refused_before_it_is_sent(desk: Desk, tmp_path: Path) -> None:
    large = tmp_path / "notes.mp4"
    large.write_bytes(b"no clip" * 1024**2)
    offsets: list[str] = []

    def handle(route: Route) -> None:
        offsets.append(route.request.headers.get("upload-offset", ""))
        route.continue_()

    desk.guarded.expected.append("status of 415")
    page = begin(desk, large, handle)
    page.locator(".way.failed").get_by_text("media type").first.wait_for()
    assert offsets == ["0"]


def test_a_large_clip_comes_whole(desk: Desk, tmp_path: Path) -> None:
    large = tmp_path / "large.mp4"
    large.write_bytes(MP4 + b"\0" * 5 * 1024**2)
    page = desk.guarded.open()
    drop(page, "#picture", large)
    page.get_by_text("Waiting for a worker").wait_for()
    newest = desk.api.client.get("/videos").json()["data"][0]
    assert newest["sha256"] == hashlib.sha256(large.read_bytes()).hexdigest()


def test_an_upload_that_broke_for_good_goes_on_when_it_is_tried_again(desk: Desk, clip: Path) -> None:
    breaks = arrives_in_part(desk, clip, 400)
    page = begin(desk, clip, lambda route: breaks(route) if route.request.method == "PATCH" else cut(route))
    page.locator(".way.failed").get_by_text("The service does not answer").wait_for()
    assert [one["offset_bytes"] for one in uploads(desk)] == [400]
    page.unroute(PATCHES)
    with page.expect_request(lambda request: request.method == "PATCH") as asked:
        page.locator("#picture").get_by_role("button", name="Try again").click()
    assert asked.value.headers["upload-offset"] == "400"
    page.get_by_text("Waiting for a worker").wait_for()


def test_a_connection_that_is_waited_for_is_told_of(desk: Desk, clip: Path) -> None:
    page = begin(desk, clip, cut)
    page.get_by_text("The connection broke; trying again").wait_for()


def test_a_connection_that_stands_still_is_taken_for_broken(desk: Desk, clip: Path) -> None:
    held: list[Route] = []

    def handle(route: Route) -> None:
        if route.request.method == "PATCH" and not held:
            held.append(route)
        else:
            route.continue_()

    desk.guarded.page.add_init_script(_BEGINS)
    page = begin(desk, clip, handle)
    page.get_by_text("Waiting for a worker").wait_for()
    assert held


def test_an_upload_that_waits_for_its_turn_is_not_taken_for_broken(desk: Desk, clip: Path) -> None:
    held: list[Route] = []
    page = begin(desk, clip, lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    desk.guarded.heard(lambda: held)
    page.wait_for_timeout(1000)  # three times as long as one that has begun may stand still
    assert len(held) == 1
    held[0].continue_()
    page.get_by_text("Waiting for a worker").wait_for()


def test_an_upload_that_the_service_has_no_more_begins_anew(desk: Desk, clip: Path) -> None:
    lost: list[str] = []

    def lose(route: Route) -> None:
        if lost:
            route.continue_()
            return
        lost.append(route.request.url)
        assert desk.api.client.delete(f"/uploads/{route.request.url.rpartition('/')[2]}").status_code == 204
        route.abort("connectionreset")

    desk.guarded.expected.append("status of 404")
    page = begin(desk, clip, lose)
    page.get_by_text("Waiting for a worker").wait_for()
    assert len(lost) == 1


@pytest.mark.parametrize("way", ["cancel", "leave", "close"])
def test_what_is_not_wanted_any_more_is_not_kept(desk: Desk, clip: Path, way: str) -> None:
    """It would count as stored bytes of the key for a day."""
    held: list[Route] = []

    def handle(route: Route) -> None:
        if route.request.method == "PATCH":
            held.append(route)
        else:
            route.continue_()

    page = begin(desk, clip, handle)
    desk.guarded.heard(lambda: held)
    assert len(uploads(desk)) == 1
    if way == "leave":
        page.goto(desk.guarded.root + "/docs/problems")
    else:
        label = {"cancel": "Cancel", "close": "Close the clip; what is not uploaded yet is dropped"}[way]
        page.get_by_role("button", name=label).click()
    desk.guarded.heard(lambda: uploads(desk) == [])


def test_a_page_that_is_shown_again_sends_what_it_had_dropped(desk: Desk, clip: Path) -> None:
    """A browser may keep a page that is left, and go on with it: that it was hidden is no wish to cancel."""
    broken: list[str] = []
    held: list[Route] = []

    def handle(route: Route) -> None:
        method = route.request.method
        if method == "PATCH" and not broken:
            broken.append(route.request.url)
            route.abort("connectionreset")
        elif method == "GET" and not held:
            held.append(route)
        else:
            route.continue_()

    desk.guarded.expected.append("status of 404")
    page = begin(desk, clip, handle)
    desk.guarded.heard(lambda: held)
    page.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: true }))")
    desk.guarded.heard(lambda: uploads(desk) == [])
    held[0].continue_()
    page.get_by_text("Waiting for a worker").wait_for()
    assert uploads(desk) == []
