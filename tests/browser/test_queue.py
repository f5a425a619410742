"""The queue and what is rendered: jobs that wait, end, are tried again and compared."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import APIResponse, Route

from scripts.samples import Samples
from tests.browser.desk import PIXEL, Desk, cut
from tests.browser.driving import READY, drop
from tests.service.fixtures import MP4, PNG, make_ready, make_results

pytestmark = pytest.mark.timeout(300)


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


def test_a_job_that_failed_names_the_portrait_that_is_at_fault(desk: Desk) -> None:
    bad = desk.api.client.post(
        "/references", content=PNG + b"bad", headers={"Content-Disposition": 'attachment; filename="bad.png"'}
    ).json()
    looks = [{"reference": desk.portrait("good.png")}, {"reference": bad["id"]}]
    desk.api.client.post("/transfer", json={"video": desk.video["id"], "looks": looks}).raise_for_status()
    desk.api.client.post(f"/jobs/{bad['job']}/cancel").raise_for_status()
    page = desk.edit()
    told = page.locator(".job .problem")
    told.wait_for()
    assert ": bad.png: " in told.inner_text()
    assert "good.png" not in told.inner_text()


@pytest.mark.parametrize("size", [(1024, 768), (1440, 900), (390, 844)])
def test_of_many_looks_the_picture_and_its_player_stay_in_sight(
    desk: Desk, tiny_clip: Path, size: tuple[int, int]
) -> None:
    names = [f"{number} of a person whose name is as long as people make names of files.png" for number in range(16)]
    looks = [{"reference": desk.portrait(name)} for name in names]
    job = desk.api.client.post("/transfer", json={"video": desk.video["id"], "looks": looks}).json()["id"]
    make_results(desk.api.services, job, [tiny_clip.read_bytes()] * len(looks))
    desk.guarded.page.set_viewport_size({"width": size[0], "height": size[1]})
    page = desk.edit()
    page.get_by_role("button", name=f"Compare {names[12]} before and after").click()
    chosen = page.get_by_role("group", name="Finished looks").get_by_role("radio", name=names[12])
    for one in (chosen, page.locator(".frame"), page.get_by_role("button", name="Play", exact=True)):
        one.wait_for(state="attached")
        shown = one.evaluate("""(one) => new Promise((tell) => {
            new IntersectionObserver(([seen]) => tell(seen.intersectionRatio)).observe(one);
        })""")
        assert shown > 0.98


def test_finished_looks_are_gone_through_by_arrow_keys(desk: Desk, tiny_clip: Path) -> None:
    names = ["one.png", "two.png", "three.png"]
    job = {"video": desk.video["id"], "looks": [{"reference": desk.portrait(name)} for name in names]}
    made = desk.api.client.post("/transfer", json=job).json()["id"]
    make_results(desk.api.services, made, [tiny_clip.read_bytes()] * 3)
    page = desk.edit()
    page.get_by_role("button", name="Compare one.png before and after").click()
    looks = page.get_by_role("group", name="Finished looks")
    focused = "(name) => document.activeElement.closest('.choices .chip')?.title === name"
    looks.wait_for()
    page.keyboard.press("Tab")  # whoever uses keys: the focus is shown
    looks.get_by_role("radio", name="one.png").focus()
    for name in names[1:]:
        page.keyboard.press("ArrowRight")
        page.wait_for_function(focused, arg=name)
        assert looks.get_by_role("radio", name=name).is_checked()
    # a hand that has clicked on one plays by Space, as before
    looks.get_by_role("radio", name="one.png").click()
    page.wait_for_function("() => document.activeElement.id === 'stage'")


def test_looks_of_portraits_that_are_not_listed_have_their_names(desk: Desk, tiny_clip: Path) -> None:
    job = {"video": desk.video["id"], "looks": [{"reference": desk.portrait(f"{n}.png")} for n in range(2)]}
    made = desk.api.client.post("/transfer", json=job).json()["id"]
    make_results(desk.api.services, made, [tiny_clip.read_bytes()] * 2)
    for number in range(24):  # as many as are listed at first
        desk.portrait(f"newer {number}.png")
    page = desk.edit()
    page.get_by_role("button", name=re.compile("^Compare")).first.click()
    chips = page.get_by_role("group", name="Finished looks").locator(".chip")
    chips.first.wait_for()
    assert chips.all_inner_texts() == ["0.png", "1.png"]


def test_the_panel_is_seen_whole_while_nothing_is_rendered(desk: Desk) -> None:
    for name in ("one.png", "two.png"):
        desk.portrait(name)
    page = desk.edit()
    assert page.evaluate(
        "() => { const p = document.getElementById('panel'); return p.scrollHeight <= p.clientHeight; }"
    )


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


@pytest.mark.parametrize("heard", [False, True])
def test_a_look_that_the_browser_cannot_play_is_compared_frame_by_frame(
    desk: Desk, heard_clip: Path, heard: bool
) -> None:
    job = desk.asked(desk.portrait("face.png"))
    content = heard_clip.read_bytes() if heard else MP4 + b"of a kind that no browser plays"
    make_results(desk.api.services, job, [content])
    (look,) = desk.api.client.get(f"/jobs/{job}").json()["looks"]
    drawn: list[dict[str, Any]] = []

    def draw(route: Route) -> None:
        drawn.append(route.request.post_data_json)
        route.fulfill(content_type="image/png", body=PIXEL)

    page = desk.edit()
    page.route("**/v1/preview", draw)
    page.get_by_role("button", name="Compare face.png before and after").click()
    page.locator(".note").get_by_text("This browser cannot play this format; you see single frames").wait_for()
    page.get_by_role("button", name="Play", exact=True).wait_for(state="hidden")
    desk.guarded.until(
        "() => [...document.querySelectorAll('.side-of img')].every((one) => !one.hidden && one.naturalWidth > 0)"
    )
    assert page.locator("#picture video:visible").count() == 0
    page.keyboard.press("Period")

    def of_the_second_frame() -> list[dict[str, Any]]:
        return [one for one in drawn if one["frame"] == 1]

    desk.guarded.heard(lambda: len(of_the_second_frame()) == 2)
    assert {one["video"] for one in of_the_second_frame()} == {desk.video["id"]}
    looks = [one["look"] for one in of_the_second_frame() if "look" in one]
    assert looks == [{"reference": look["reference"], **look["options"]}]


def test_a_clip_of_which_only_the_sound_plays_stands_still_beside_its_look(
    desk: Desk, heard_clip: Path, tiny_clip: Path
) -> None:
    make_results(desk.api.services, desk.asked(desk.portrait("face.png")), [tiny_clip.read_bytes()])
    page = desk.edit()
    body = heard_clip.read_bytes()
    page.route("**/file", lambda route: route.fulfill(status=200, content_type="video/mp4", body=body))
    page.route("**/v1/preview", lambda route: route.fulfill(content_type="image/png", body=PIXEL))
    page.get_by_role("button", name="Compare face.png before and after").click()
    desk.guarded.until(
        """() => {
          const [before] = document.querySelectorAll('.side-of img');
          return before && !before.hidden && before.naturalWidth > 0;
        }"""
    )
    assert page.locator("#picture video:visible").count() == 1


#: where the clip before is put, and how fast it plays, when it was so many seconds from the one after
_LED = """async (apart) => {
  const { Player } = await import(new URL('player.js', document.querySelector('script[type=module]').src));
  const made = () => Object.assign(new EventTarget(), {
    currentTime: 0, playbackRate: 1, duration: 60, paused: false, ended: false, error: null,
    async play() {}, pause() {}, requestVideoFrameCallback(step) { this.step = step; },
  });
  const [before, after] = [made(), made()];
  new Player(before, after, { rate: 24, length: 60 });
  for (const one of [before, after]) one.dispatchEvent(new Event('loadeddata'));
  after.currentTime = 10;
  return apart.map((by) => {
    Object.assign(before, { currentTime: 10 + by, playbackRate: 1 });
    after.step();
    return [Number((before.currentTime - 10).toFixed(3)), Number(before.playbackRate.toFixed(3))];
  });
}"""
#: where both clips are while the browser finds their ends; they begin at 2, and 4 seconds after that is wanted, then 1
_FOUND = """async () => {
  const { Player } = await import(new URL('player.js', document.querySelector('script[type=module]').src));
  const made = () => {
    const video = Object.assign(new EventTarget(), {
      at: 2, playbackRate: 1, duration: 3, paused: true, ended: false, error: null, requestVideoFrameCallback() {},
    });
    const currentTime = { get: () => video.at, set: (to) => { video.at = Math.min(to, video.duration); } };
    return Object.defineProperty(video, 'currentTime', currentTime);
  };
  const [before, after] = [made(), made()];
  const player = new Player(before, after, { rate: 24, length: 7 });
  for (const one of [before, after]) one.dispatchEvent(new Event('loadeddata'));
  const found = (video, end) => {
    video.duration = end;
    video.dispatchEvent(new Event('durationchange'));
    return [before.currentTime, after.currentTime];
  };
  player.time = 4;
  const places = [found(after, 5), found(after, 7), found(before, 7)];
  player.time = 9;
  player.time = 1;
  return [...places, found(after, 12)];
}"""
#: put the clip before so far from the one after, once in each round of them; whether they are together soon after that
_MET = """(by) => {
  const [before, after] = document.querySelectorAll('#picture video');
  const now = after.currentTime;
  const isNext = !(now >= window.seenAt);
  window.seenAt = now;
  if (isNext) {
    window.putAt = now;
    before.currentTime = now + by;
    return false;
  }
  const isSoon = window.putAt < 3 && now < window.putAt + 3 && !after.paused && !before.seeking;
  return isSoon && Math.abs(before.currentTime - now) < 0.08;
}"""


def test_of_two_clips_that_play_as_one_that_before_is_held_to_that_after(desk: Desk, samples: Samples) -> None:
    guarded, client = desk.guarded, desk.api.client
    clip = samples.woman_clip.read_bytes()
    video = client.post("/videos", content=clip).raise_for_status().json()
    make_ready(desk.api.services, video["id"])
    look = {"reference": desk.portrait("face.png")}
    job = client.post("/transfer", json={"video": video["id"], "looks": [look]}).raise_for_status().json()
    make_results(desk.api.services, job["id"], [clip])
    page = guarded.open()
    led = page.evaluate(_LED, [0, 0.05, 0.2, -0.2, 1, -1])
    assert led == [[0, 1], [0.05, 0.9], [0.2, 0.85], [-0.2, 1.15], [0, 1], [0, 1]]
    page.get_by_role("button", name="Compare face.png before and after").click()
    guarded.until(COMPARED)
    page.get_by_role("button", name="Play", exact=True).click()
    for by in (0.2, 1):
        page.evaluate("() => { window.seenAt = Infinity; }")
        guarded.until(_MET, by)


def test_two_clips_go_where_they_are_wanted_once_the_browser_knows_that_they_are_so_long(desk: Desk) -> None:
    assert desk.guarded.open().evaluate(_FOUND) == [[3, 5], [3, 6], [6, 6], [3, 3]]


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


def test_a_job_in_the_queue_is_canceled(desk: Desk) -> None:
    desk.asked(desk.portrait("first.png"))
    desk.portrait("face.png")
    page = desk.edit()
    page.get_by_role("checkbox", name="Render face.png").check()
    page.get_by_role("slider", name="Make-up", exact=True).fill("0.31")
    page.locator("#look").get_by_role("button", name="Render").click()
    newest = page.locator(".job", has_text="face.png")
    newest.get_by_role("button", name="Cancel").click()
    newest.get_by_text("Canceled at").wait_for()
    newest.get_by_role("button", name="Try again").wait_for()
    first, other = reversed(desk.api.client.get("/jobs?kind=transfer").json()["data"])
    assert (first["state"], other["state"]) == ("queued", "canceled")
    assert other["looks"][0]["options"]["makeup"] == 0.31


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
    page.locator("#polite").get_by_text("Canceled").wait_for(state="attached")  # once the answer was taken
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
    with page.expect_response("**/v1/jobs/*/events"):  # it is followed
        held[0].continue_()
    page.locator("#polite").get_by_text("Rendering 1 look").wait_for(state="attached")
    assert page.locator(".job").count() == 0
    page.evaluate("(id) => { location.hash = id; }", desk.video["id"])
    page.locator(".job").get_by_text("Queued").wait_for()


def test_a_job_that_is_asked_for_while_the_list_is_read_stays_in_it(desk: Desk) -> None:
    desk.asked(desk.portrait("before.png"))
    desk.portrait("face.png")
    page = desk.guarded.page
    held: list[tuple[Route, APIResponse]] = []
    page.route("**/v1/jobs?kind=*", lambda route: held.append((route, route.fetch())))
    page.goto(f"{desk.guarded.root}/#{desk.video['id']}")
    desk.guarded.until(READY)
    page.get_by_role("checkbox", name="Render face.png").check()
    page.locator("#look").get_by_role("button", name="Render").click()
    page.locator(".job").get_by_text("1 look: face.png").wait_for()
    for route, answer in held:  # as the service had it before
        route.fulfill(response=answer)
    page.unroute_all(behavior="ignoreErrors")  # a question that is open at the end belongs to no test
    page.locator(".job").get_by_text("1 look: before.png").wait_for()
    assert page.locator(".job h3").all_text_contents() == ["1 look: face.png", "1 look: before.png"]


@pytest.mark.parametrize("kind", ["focus", "visibilitychange"])
def test_what_another_page_has_asked_for_is_seen_when_the_page_is_looked_at_again(desk: Desk, kind: str) -> None:
    portrait = desk.portrait("face.png")
    page = desk.edit()
    page.locator("#queue").get_by_text("Nothing rendered yet").wait_for()
    desk.asked(portrait)
    page.evaluate("(kind) => (kind === 'focus' ? window : document).dispatchEvent(new Event(kind))", kind)
    page.locator(".job").get_by_text("1 look: face.png").wait_for()


def test_a_job_that_is_asked_for_again_while_it_waits_is_not_said_to_be_done(desk: Desk) -> None:
    desk.portrait("face.png")
    page = desk.edit()
    page.get_by_role("checkbox", name="Render face.png").check()
    render = page.locator("#look").get_by_role("button", name="Render")
    render.click()
    page.locator(".job").get_by_text("1 look: face.png").wait_for()
    page.wait_for_timeout(700)  # a second click within 600 ms is one too many
    render.click()
    page.locator(".toast").get_by_text("This is in the queue already").wait_for()
    assert page.locator(".job").count() == 1


def test_a_job_of_another_day_is_told_with_its_day(desk: Desk) -> None:
    job = desk.asked(desk.portrait("face.png"))
    desk.api.client.post(f"/jobs/{job}/cancel")
    page = desk.edit()
    page.locator(".job").get_by_text(re.compile(r"^Canceled at [\d:]+ ?(AM|PM)?$")).wait_for()

    jobs = desk.api.client.get("/jobs?kind=transfer").json()
    jobs["data"][0]["finished_at"] = "2026-01-05T12:00:00Z"
    page.route("**/v1/jobs?kind=*", lambda route: route.fulfill(json=jobs))
    page.reload()
    page.locator(".job").get_by_text(re.compile("^Canceled on .*(5 Jan|Jan 5)")).wait_for()


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
