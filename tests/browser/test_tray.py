"""Portraits of the tray: those that can be used, those that cannot, and those that are deleted."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Route

from tests.browser.desk import FOCUS, PIXEL, Desk, stopped
from tests.browser.driving import drop
from tests.service.fixtures import PNG

pytestmark = pytest.mark.timeout(300)


def test_a_portrait_that_cannot_be_used_leaves_the_stage_as_it_was(desk: Desk, tmp_path: Path) -> None:
    desk.portrait("face.png")
    desk.guarded.expected.append("status of 415")
    page = desk.edit()
    look = page.get_by_role("radio", name="Look", exact=True)
    assert look.is_checked()
    held: list[Route] = []
    page.route(
        "**/v1/uploads/*", lambda route: held.append(route) if route.request.method == "PATCH" else route.continue_()
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


@pytest.mark.parametrize("uploaded", [False, True], ids=["uploading", "vectorizing"])
def test_a_portrait_that_is_deleted_on_its_way_is_no_failure(desk: Desk, tmp_path: Path, uploaded: bool) -> None:
    desk.guarded.expected.append("status of 404")
    page = desk.edit()
    held: list[Route] = []
    if not uploaded:
        page.route("**/v1/uploads/*", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    picture = tmp_path / "face.png"
    picture.write_bytes(PNG + b"on its way")
    drop(page, "#tray", picture)
    if uploaded:
        page.locator(".card").get_by_text("Waiting for a worker").wait_for()
    else:
        desk.guarded.heard(lambda: held)
    page.get_by_role("button", name="Delete face.png").click()
    if uploaded:
        with page.expect_response(lambda answer: answer.status == 404) as gone:  # the end of its job is heard of, too
            page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        gone.value.finished()
    page.get_by_role("button", name="face.png", exact=True).wait_for(state="detached")
    page.wait_for_timeout(100)
    assert page.locator("#assertive").inner_text() == ""


def test_every_portrait_is_reached_and_has_its_name_in_the_queue(desk: Desk) -> None:
    desk.asked(desk.portrait("old.png"))
    for n in range(24):
        stopped(desk, "/references", f"{n}.png", PNG + bytes([n]))
    page = desk.guarded.open()
    cards = page.locator(".card:not(.adder)")
    assert cards.count() == 24
    title = page.locator(".job h3")
    title.get_by_text("1 look: old.png").wait_for()
    assert page.get_by_role("checkbox", name="Render 0.png").is_disabled()
    page.locator("#tray").get_by_role("button", name="Show more").click()
    page.get_by_role("checkbox", name="Render old.png").wait_for()
    assert cards.count() == 25
    assert page.locator("#tray").get_by_role("button", name="Show more").count() == 0
    page.get_by_role("button", name="Delete 0.png").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    desk.guarded.until("() => document.querySelectorAll('.card:not(.adder)').length === 24")


def test_a_portrait_that_is_gone_is_said_to_be_without_a_request_that_fails(desk: Desk) -> None:
    """And it is asked for once, not with everything that changes on the page."""
    reference = desk.portrait("gone.png")
    desk.asked(reference)
    page = desk.guarded.page
    asked: list[str] = []
    page.on("request", lambda one: asked.append(one.url) if "/references" in one.url else None)
    desk.api.client.delete(f"/references/{reference}?cancel_jobs=true").raise_for_status()
    desk.edit()
    page.locator(".job h3").get_by_text("1 look: a portrait that is no longer here").wait_for()
    page.evaluate("() => window.dispatchEvent(new Event('focus'))")
    page.wait_for_timeout(500)
    assert len([url for url in asked if "limit=200" in url]) == 1


def test_portraits_of_another_page_are_seen_when_the_page_is_looked_at_again(desk: Desk) -> None:
    desk.portrait("kept.png")
    going = desk.portrait("going.png")
    page = desk.edit()
    names = page.locator(".card .name")
    page.locator(".card.selected", has_text="going.png").wait_for()
    assert desk.api.client.delete(f"/references/{going}").status_code == 204
    desk.portrait("new.png")
    page.evaluate("() => window.dispatchEvent(new Event('focus'))")
    page.locator(".card", has_text="going.png").wait_for(state="detached")
    page.locator(".card.selected", has_text="kept.png").wait_for()
    assert names.all_text_contents() == ["new.png", "kept.png"]
    assert not page.get_by_role("checkbox", name="Render new.png").is_checked()
