"""A page that stays open: links that expire, connections that die, keys that change, and what is dropped by mistake."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route

from service.catalog import Progress, keys, leases
from tests.browser.conftest import OpenPage
from tests.browser.guarded import Guarded
from tests.service.api.test_authentication import Holder, holder
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results

pytestmark = pytest.mark.timeout(300)

#: how many videos are kept in blobs, and were ever
_BLOBS = """() => {
  window.videoBlobs = new Map();
  window.madeBlobs = 0;
  const [create, revoke] = [URL.createObjectURL, URL.revokeObjectURL];
  URL.createObjectURL = (what) => {
    const url = create.call(URL, what);
    if (what.type.startsWith("video/")) {
      window.videoBlobs.set(url, what.size);
      window.madeBlobs += 1;
    }
    return url;
  };
  URL.revokeObjectURL = (url) => {
    window.videoBlobs.delete(url);
    revoke.call(URL, url);
  };
}"""
#: where the player is when its file fails, how far it could go in the next one, and where it is put in that
_WATCH_PLAYER = """() => {
  const video = document.querySelectorAll('#picture video')[1];
  window.player = { leftAt: null, endedAt: null, places: [] };
  video.addEventListener('error', () => { window.player.leftAt ??= video.currentTime; });
  video.addEventListener('seeking', () => {
    if (window.player.leftAt === null) return;
    window.player.endedAt ??= video.duration;
    window.player.places.push(video.currentTime);
  });
  video.currentTime = 1.4;
}"""
#: whether it has come to where it was, to within a frame
_IS_BACK = """() => {
  const { leftAt, places } = window.player;
  return places.some((place) => Math.abs(place - leftAt) < 1 / 24);
}"""
_DROP_TEXT = """(selector) => {
  const carried = new DataTransfer();
  carried.setData("text/plain", "a word that was marked by mistake");
  const target = document.querySelector(selector);
  for (const kind of ["dragenter", "dragover", "drop"]) {
    target.dispatchEvent(new DragEvent(kind, { bubbles: true, cancelable: true, dataTransfer: carried }));
  }
}"""


@dataclass
class Studio:
    """A key with a clip, a portrait and a finished look, and the page with that key."""

    api: Api
    key: Holder
    video: dict[str, Any]
    portrait: dict[str, Any]
    job: dict[str, Any]
    guarded: Guarded

    def enter(self, path: str = "/") -> Page:
        """Open the page, and give it the key."""
        page = self.guarded.page
        page.goto(self.guarded.root + path)
        self.give(self.key.text)
        self.guarded.until("() => 'ready' in document.documentElement.dataset")
        return page

    def give(self, key: str) -> None:
        """Answer the question for a key."""
        page = self.guarded.page
        page.get_by_role("dialog", name="This service needs a key").wait_for()
        page.get_by_label("Key", exact=True).fill(key)
        page.keyboard.press("Enter")

    def compare(self) -> None:
        """Show the finished look until its player has it."""
        self.guarded.page.get_by_role("button", name="Compare face.png before and after").first.click()
        self.guarded.until("() => document.querySelectorAll('#picture video')[1]?.readyState > 1")


@pytest.fixture
def studio(api: Api, open_page: OpenPage, tiny_clip: Path) -> Studio:
    key = holder(api)
    named = {"Content-Disposition": 'attachment; filename="face.png"'}
    video = key.post("/videos", content=MP4 + b"a").json()
    portrait = key.post("/references", content=PNG + b"a", headers=named).json()
    for medium in (video, portrait):
        make_ready(api.services, medium["id"])
    asked = {"video": video["id"], "looks": [{"reference": portrait["id"]}]}
    job = key.post("/transfer", json=asked).json()
    make_results(api.services, job["id"], [tiny_clip.read_bytes()])
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    # its pictures are made by a worker, which is not there; the clip itself is none
    guarded.expected += ["status of 401", "status of 409", "status of 503"]
    return Studio(api, key, video, portrait, job, guarded)


@pytest.mark.parametrize("plays", [False, True], ids=["paused", "playing"])
def test_a_link_that_has_expired_is_renewed_where_the_player_was(studio: Studio, tiny_clip: Path, plays: bool) -> None:
    page, guarded = studio.guarded.page, studio.guarded
    content = tiny_clip.read_bytes()
    blocks = (len(content) - 8192) // 32768  # the browser keeps whole blocks of this size
    asked: list[Any] = []
    waiting: list[Route] = []

    def shortly(route: Route) -> None:
        asked.append(route.request.post_data_json)
        body = json.dumps({"expires_in_s": 1}) if len(asked) == 1 else None
        route.continue_(post_data=body)

    def in_part(route: Route) -> None:
        """The beginning of the file at once, of the renewed one less; the rest is held up."""
        if route.request.method != "GET":
            route.continue_()
        elif route.request.headers.get("range", "bytes=0-") == "bytes=0-":
            cut = (blocks if len(asked) == 1 else blocks - 2) * 32768
            span = f"bytes 0-{cut - 1}/{len(content)}"
            headers = {"Content-Type": "video/mp4", "Content-Range": span, "Accept-Ranges": "bytes"}
            route.fulfill(status=206, headers=headers, body=content[:cut])
        else:
            waiting.append(route)

    def give_the_rest() -> None:
        guarded.heard(lambda: waiting)
        while waiting:
            waiting.pop().continue_()

    page.route("**/link", shortly)
    page.route("**/results/*signature=*", in_part)
    guarded.expected.append("status of 410")
    studio.enter()
    studio.compare()
    first = page.locator("#picture video").nth(1).get_attribute("src")
    assert first is not None
    assert "signature=" in first
    page.evaluate(_WATCH_PLAYER)
    guarded.until("() => !document.querySelectorAll('#picture video')[1].seeking")
    if plays:
        page.get_by_role("button", name="Play", exact=True).click()
    page.wait_for_timeout(2500)  # the link is good for 1 s
    give_the_rest()
    guarded.until("() => window.player.places.length > 0")
    player = page.evaluate("() => window.player")
    assert len(asked) == 2
    assert page.locator("#picture video").nth(1).get_attribute("src") != first
    # the file begins later than at 0, and the browser finds its end only as it reads on
    assert player["leftAt"] > player["endedAt"] + 0.1
    page.unroute("**/results/*signature=*")
    give_the_rest()
    guarded.until(_IS_BACK)
    guarded.until(
        """(plays) => {
          const video = document.querySelectorAll('#picture video')[1];
          const { leftAt } = window.player;
          return video.readyState > 1 && video.paused !== plays && (video.currentTime === leftAt) !== plays;
        }""",
        plays,
    )
    assert not page.get_by_text("This browser cannot play this format").is_visible()


def test_blobs_of_results_go_with_the_comparison_and_with_the_key(studio: Studio) -> None:
    page = studio.guarded.page
    page.add_init_script(f"({_BLOBS})()")
    page.route("**/link", lambda route: route.fulfill(status=404, body="{}"))
    studio.guarded.expected.append("status of 404")
    studio.enter()
    both = "() => window.videoBlobs.size === 2"  # the result and its clip
    studio.compare()
    studio.guarded.until(both)
    page.get_by_role("button", name="Back to the look").click()
    studio.guarded.until("() => window.videoBlobs.size === 0")

    studio.compare()
    studio.guarded.until(both)
    with studio.api.services.background.write() as session:
        found = keys.get(session, studio.key.id)
        assert found is not None
        assert keys.revoke(session, found, now=studio.api.services.database.now())
    # whatever the page asks for next is answered that the key is no good
    with page.expect_event("load"):
        studio.give(holder(studio.api).text)
    studio.guarded.until("() => window.videoBlobs.size === 0")


def test_a_blob_that_comes_after_the_comparison_was_closed_goes(studio: Studio) -> None:
    page = studio.guarded.page
    page.add_init_script(f"({_BLOBS})()")
    held: list[Route] = []
    page.route("**/link", lambda route: held.append(route))  # noqa: PLW0108  (Playwright marks its handlers)
    studio.guarded.expected.append("status of 404")
    studio.enter()
    page.get_by_role("button", name="Compare face.png before and after").click()
    studio.guarded.heard(lambda: held)
    back = page.get_by_role("button", name="Back to the look")
    back.click()
    back.wait_for(state="detached")
    assert len(held) == 1
    held[0].fulfill(status=404, body="{}")
    studio.guarded.until("() => window.madeBlobs === 1 && window.videoBlobs.size === 0")

    page.unroute("**/link")
    page.route("**/link", lambda route: route.fulfill(status=404, body="{}"))
    studio.compare()
    studio.guarded.until("() => window.videoBlobs.size === 2")  # the result and its clip


def test_a_dead_connection_does_not_stop_the_progress(studio: Studio) -> None:
    page = studio.guarded.page
    page.clock.install()
    opened: list[Route] = []

    def stay_silent(route: Route) -> None:  # as a line does that was cut
        opened.append(route)

    page.route("**/events", stay_silent)
    asked = {"video": studio.video["id"], "looks": [{"reference": studio.portrait["id"], "seed": 7}]}
    job = studio.key.post("/transfer", json=asked).json()
    studio.enter(f"/#{studio.video['id']}")
    card = page.locator(".job").first
    card.get_by_text("Queued").wait_for()
    lease = claim(studio.api.services.background, job["id"])
    with studio.api.services.background.write() as session:
        assert leases.report(session, lease, Progress("render", 0.3, 3, 9), now=studio.api.services.database.now())
    for number in range(6):
        if number < 3:
            studio.guarded.heard(lambda wanted=number + 1: len(opened) == wanted)
        page.clock.fast_forward("00:45")
        page.wait_for_timeout(300)
    card.get_by_text("frame 3 of 9").wait_for()
    assert len(opened) == 3


def test_a_job_that_is_listed_twice_is_told_of_once(studio: Studio) -> None:
    page = studio.guarded.page
    asked = {"video": studio.video["id"], "looks": [{"reference": studio.portrait["id"], "seed": 8}]}
    job = studio.key.post("/transfer", json=asked).json()
    studio.enter(f"/#{studio.video['id']}")  # lists them with the clip, and once all is there
    page.evaluate(
        """() => {
          window.told = [];
          const region = document.getElementById('polite');
          const texts = (record) => [...record.addedNodes].map((node) => node.data);
          const note = (records) => window.told.push(...records.flatMap(texts));
          new MutationObserver(note).observe(region, { childList: true });
        }"""
    )
    make_results(studio.api.services, job["id"], [b"look"])
    studio.guarded.until("() => window.told.some((text) => text.includes('finished'))")
    page.wait_for_timeout(500)
    assert [text.strip("\u00a0") for text in page.evaluate("() => window.told")] == ["1 look finished"]


def test_a_key_that_no_header_carries_is_refused_in_words(studio: Studio) -> None:
    page = studio.guarded.page
    page.goto(studio.guarded.root + "/")
    for wrong in ("pvg_schlüssel", "pvg_a\u200bb", "two words"):
        studio.give(wrong)
        page.get_by_text("letters, digits, _ and - alone").wait_for()
        page.get_by_role("dialog", name="This service needs a key").wait_for()
        assert page.evaluate("() => sessionStorage.length") == 0
    studio.give(studio.key.text)
    studio.guarded.until("() => 'ready' in document.documentElement.dataset")


def test_the_question_for_a_key_listens_once(studio: Studio) -> None:
    page = studio.guarded.page
    page.add_init_script(
        """(() => {
          window.listens = 0;
          const add = EventTarget.prototype.addEventListener;
          EventTarget.prototype.addEventListener = function (kind, listener, options) {
            if (this.id === 'key-dialog' && !options?.once) window.listens += 1;
            return add.call(this, kind, listener, options);
          };
        })()"""
    )
    page.goto(studio.guarded.root + "/")
    for _ in range(3):
        studio.give("pvg_wrong")
        page.get_by_text("That key is not known here").wait_for()
    assert page.evaluate("() => window.listens") <= 1


@pytest.mark.parametrize("part", ["#picture", "#tray"])
def test_text_that_is_dropped_is_told_to_be_no_file(studio: Studio, part: str) -> None:
    page = studio.enter()
    page.evaluate(_DROP_TEXT, part)
    page.get_by_text("That was no file", exact=True).wait_for()
    assert "Drag a clip or a picture" in page.locator("#toasts").inner_text()


def test_a_look_that_was_deleted_with_its_clip_is_not_offered(studio: Studio) -> None:
    assert studio.key.delete(f"/videos/{studio.video['id']}").status_code == 204
    page = studio.enter()
    card = page.locator(".job").first
    card.get_by_text("No longer kept", exact=True).wait_for()
    assert card.get_by_role("button", name="Compare face.png before and after").is_disabled()
    assert card.get_by_role("button", name="Download face.png").is_disabled()


def test_a_list_that_comes_late_is_not_shown_over_a_newer_one(studio: Studio) -> None:
    """The page is looked at again, its queue is read, and a portrait is deleted before the answer has come."""
    page = studio.guarded.page
    studio.enter()
    card = page.locator(".job").first
    card.get_by_role("button", name="Compare face.png before and after").wait_for()

    late: list[tuple[Route, Any]] = []

    def hold(route: Route) -> None:
        late.append((route, route.fetch()))

    page.route("**/v1/jobs?*", hold, times=1)
    page.evaluate("() => window.dispatchEvent(new Event('focus'))")
    studio.guarded.heard(lambda: len(late) == 1)
    page.get_by_role("button", name="Delete face.png").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    lost = card.get_by_text("No longer kept", exact=True)
    lost.wait_for()
    [(route, answer)] = late
    with page.expect_response("**/v1/jobs?*"):
        route.fulfill(response=answer)
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert lost.count() == 1


def test_looks_that_are_not_kept_are_listed_once_and_never_offered(studio: Studio, tiny_clip: Path) -> None:
    api, page = studio.api, studio.guarded.page
    portraits = [studio.portrait]
    for name in ("second", "third", "fourth", "fifth"):
        named = {"Content-Disposition": f'attachment; filename="{name}.png"'}
        portraits.append(studio.key.post("/references", content=PNG + name.encode(), headers=named).json())
        make_ready(api.services, portraits[-1]["id"])
    asked = {"video": studio.video["id"], "looks": [{"reference": one["id"]} for one in portraits]}
    job = studio.key.post("/transfer", json=asked).json()
    make_results(api.services, job["id"], [tiny_clip.read_bytes()] * 5)
    for portrait in portraits[2:4]:
        assert studio.key.delete(f"/references/{portrait['id']}").status_code == 204
    studio.guarded.expected.append("status of 404")  # thumbnails of the portrait that is deleted meanwhile
    studio.enter()
    card = page.locator(".job").first
    lost = card.get_by_text("No longer kept", exact=True)
    lost.nth(1).wait_for()
    assert lost.count() == 2

    page.get_by_role("button", name="Delete fifth.png").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    lost.nth(2).wait_for()  # without another listing by hand
    for check in page.get_by_role("checkbox", name="Render").all()[:2]:  # the page is drawn anew
        check.click()
    assert card.locator(".result").count() == 5

    card.get_by_role("button", name="Compare face.png before and after").click()
    chips = page.get_by_role("group", name="Finished looks").get_by_role("radio")
    chips.first.wait_for(state="attached")
    assert chips.count() == 2
    page.get_by_role("radio", name="second.png").check()
    studio.guarded.until("() => document.querySelectorAll('#picture video')[1]?.readyState > 1")
    assert card.locator(".result").count() == 5

    downloads: list[Any] = []
    page.on("download", lambda one: downloads.append(one))  # noqa: PLW0108
    card.get_by_role("button", name="Download all").click()
    page.get_by_text("2 downloads started").wait_for(state="attached")
    studio.guarded.heard(lambda: len(downloads) == 2)
