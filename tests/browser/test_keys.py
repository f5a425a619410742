"""The page of a service that wants a key."""

from __future__ import annotations

import pytest

from service.catalog import keys
from service.catalog.keys import Limits
from tests.browser.conftest import OpenPage
from tests.service.fixtures import MP4, Api

pytestmark = pytest.mark.timeout(300)


def test_a_key_is_asked_for_once_and_kept_in_the_tab_alone(api: Api, open_page: OpenPage) -> None:
    with api.services.database.write() as session:
        _, key = keys.create(session, "page", Limits(), now=api.services.database.now())
    api.client.post("/videos", content=MP4, headers={"authorization": f"Bearer {key}", "content-type": "video/mp4"})

    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected.append("status of 401")
    page = guarded.page
    page.goto(guarded.root + "/")
    dialog = page.get_by_role("dialog", name="This service needs a key")
    dialog.wait_for()
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
    other = open_page(guarded.root)
    other.expected.append("status of 401")
    other.page.goto(guarded.root + "/")
    other.page.get_by_role("dialog", name="This service needs a key").wait_for()
