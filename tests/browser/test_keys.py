"""The page of a service that wants a key."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Locator, Route

from service.catalog import keys
from service.catalog.keys import Limits
from tests.browser.conftest import OpenPage
from tests.browser.driving import drop
from tests.browser.guarded import Guarded
from tests.service.api.test_authentication import holder
from tests.service.fixtures import MP4, Api, make_ready

pytestmark = pytest.mark.timeout(300)


def asked(open_page: OpenPage, root: str) -> tuple[Guarded, Locator]:
    """A page of a service that has keys, and the dialog in which it asks for one."""
    guarded = open_page(root)
    guarded.expected.append("status of 401")
    guarded.page.goto(root + "/")
    dialog = guarded.page.get_by_role("dialog", name="This service needs a key")
    dialog.wait_for()
    return guarded, dialog


def test_a_key_is_asked_for_once_and_kept_in_the_tab_alone(api: Api, open_page: OpenPage) -> None:
    with api.services.database.write() as session:
        _, key = keys.create(session, "page", Limits(), now=api.services.database.now())
    api.client.post("/videos", content=MP4, headers={"authorization": f"Bearer {key}", "content-type": "video/mp4"})

    guarded, dialog = asked(open_page, str(api.client.base_url).rstrip("/"))
    page = guarded.page
    assert page.evaluate("() => document.activeElement.id") == "key"

    # one that is no good: the page says so and asks again
    page.get_by_label("Key", exact=True).fill("pvg_wrong")
    page.keyboard.press("Enter")
    page.get_by_text("That key is not known here").wait_for()
    page.get_by_label("Key", exact=True).fill(key)
    page.keyboard.press("Enter")
    guarded.until("() => 'ready' in document.documentElement.dataset")
    assert not dialog.is_visible()
    assert page.locator(".clip-card").count() == 1

    # in this tab, and nowhere else: a reload needs no asking, another tab does
    assert page.evaluate("() => localStorage.length + document.cookie.length") == 0
    assert key not in page.content()
    assert page.evaluate("() => document.getElementById('key').value") == ""
    page.reload()
    guarded.until("() => 'ready' in document.documentElement.dataset")
    assert page.locator(".clip-card").count() == 1
    asked(open_page, guarded.root)


def test_the_question_for_another_key_may_be_left(api: Api, open_page: OpenPage) -> None:
    one, other = holder(api), holder(api)
    video = one.post("/videos", content=MP4).json()
    guarded, dialog = asked(open_page, str(api.client.base_url).rstrip("/"))
    page = guarded.page
    # without a key there is no other way
    assert not dialog.get_by_role("button", name="Cancel").is_visible()
    for _ in range(3):
        page.keyboard.press("Escape")
        dialog.wait_for()
    page.get_by_label("Key", exact=True).fill(one.text)
    page.keyboard.press("Enter")
    guarded.until("() => 'ready' in document.documentElement.dataset")
    assert page.evaluate("() => sessionStorage.getItem('pvg-key')") == one.text

    page.evaluate("() => { window.isAsBefore = true; }")
    change = page.get_by_role("button", name="Key", exact=True)
    change.click()
    page.get_by_label("Key", exact=True).fill("pvg_half")
    dialog.get_by_role("button", name="Cancel").click()
    dialog.wait_for(state="hidden")
    change.click()
    page.keyboard.press("Escape")
    dialog.wait_for(state="hidden")
    assert page.evaluate("() => sessionStorage.getItem('pvg-key')") == one.text
    page.locator(".clip-card").click()
    page.locator(".way").wait_for()
    assert page.evaluate("() => window.isAsBefore && location.hash") == f"#{video['id']}"

    # with another one nothing of the first is shown
    change.click()
    page.get_by_label("Key", exact=True).fill(other.text)
    with page.expect_event("load"):
        page.keyboard.press("Enter")
    guarded.until("() => !window.isAsBefore && 'ready' in document.documentElement.dataset")
    page.get_by_role("button", name="Choose a clip").wait_for()
    assert page.evaluate("() => location.hash") == ""
    assert page.locator(".clip-card").count() == 0


def test_a_key_that_comes_for_one_that_ended_begins_anew(api: Api, open_page: OpenPage) -> None:
    one, other = holder(api), holder(api)
    video = one.post("/videos", content=MP4).json()
    make_ready(api.services, video["id"])
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected += ["status of 401", "status of 503"]  # there is no worker for pictures
    page = guarded.page
    page.goto(guarded.root + "/")
    page.get_by_label("Key", exact=True).fill(one.text)
    page.keyboard.press("Enter")
    page.locator(".clip-card").wait_for()
    with api.services.background.write() as session:
        found = keys.get(session, one.id)
        assert found is not None
        assert keys.revoke(session, found, now=api.services.database.now())
    page.evaluate("(id) => { location.hash = id; }", video["id"])  # a thumbnail may have asked before
    page.get_by_text("That key is not known here").wait_for()
    page.get_by_label("Key", exact=True).fill(other.text)
    with page.expect_event("load"):
        page.keyboard.press("Enter")
    guarded.until("() => 'ready' in document.documentElement.dataset")
    assert page.locator(".clip-card").count() == 0


def test_a_key_that_is_kept_for_a_service_without_keys_is_let_go(api: Api, open_page: OpenPage) -> None:
    api.client.post("/videos", content=MP4)
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected.append("status of 401")
    page = guarded.open()
    page.evaluate("() => sessionStorage.setItem('pvg-key', 'pvg_of_before')")
    page.reload()
    guarded.until("() => 'ready' in document.documentElement.dataset")
    assert page.locator(".clip-card").count() == 1
    assert page.evaluate("() => sessionStorage.getItem('pvg-key')") is None
    assert not page.get_by_role("dialog", name="This service needs a key").is_visible()
    assert not page.get_by_role("button", name="Key", exact=True).is_visible()


def test_a_file_is_sent_without_a_key_that_is_wanted_no_more(api: Api, open_page: OpenPage, tmp_path: Path) -> None:
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected.append("status of 401")
    page = guarded.open()
    page.evaluate("() => sessionStorage.setItem('pvg-key', 'pvg_of_before')")
    clip = tmp_path / "clip.mp4"
    clip.write_bytes(MP4)
    drop(page, "#picture", clip)
    page.get_by_text("Waiting for a worker").wait_for()
    assert page.evaluate("() => sessionStorage.getItem('pvg-key')") is None


def test_another_key_is_asked_about_while_a_file_is_uploaded(api: Api, open_page: OpenPage, tmp_path: Path) -> None:
    key = holder(api)
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected.append("status of 401")
    page = guarded.page
    page.goto(guarded.root + "/")
    page.get_by_label("Key", exact=True).fill(key.text)
    page.keyboard.press("Enter")
    guarded.until("() => 'ready' in document.documentElement.dataset")
    held: list[Route] = []
    page.route("**/v1/uploads/*", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    clip = tmp_path / "clip.mp4"
    clip.write_bytes(MP4)
    drop(page, "#picture", clip)
    guarded.heard(lambda: held)
    page.get_by_role("button", name="Key", exact=True).click()
    page.get_by_role("dialog", name="Change the key?").get_by_role("button", name="Keep").click()
    assert not page.get_by_role("dialog", name="This service needs a key").is_visible()
    page.get_by_role("button", name="Key", exact=True).click()
    page.get_by_role("dialog").get_by_role("button", name="Change").click()
    page.get_by_role("dialog", name="This service needs a key").get_by_role("button", name="Cancel").click()
    held[0].continue_()
    page.get_by_text("Waiting for a worker").wait_for()
