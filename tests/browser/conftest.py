"""The page in a real browser, against the whole service with its worker."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Playwright, sync_playwright

from scripts.samples import Samples
from tests.browser.desk import Desk
from tests.browser.guarded import PATIENCE_S, Guarded, watch
from tests.gallery.clips import add_tone, cut_clip, encode_raw, libav_frame
from tests.service.fixtures import Api, api, make_ready, plain_logs, settings
from tests.service.servers import installed
from tests.worker.serving import Service, running_service

__all__ = ["api", "plain_logs", "settings"]


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    # not for the session: while it runs, nothing else in this thread can run an event loop
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def chromium(playwright: Playwright) -> Iterator[Browser]:
    """The installed Chromium, without a window. It finds no host but this machine."""
    command = installed("chromium", "chromium-browser")
    arguments = [
        *("--no-sandbox", "--disable-dev-shm-usage", "--autoplay-policy=no-user-gesture-required"),
        *("--disable-gpu", "--in-process-gpu"),  # which spares a process that would draw by the processor as well
        "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
    ]
    browser = playwright.chromium.launch(executable_path=command, args=arguments)
    yield browser
    browser.close()


OpenPage = Callable[..., Guarded]


@pytest.fixture
def open_page(chromium: Browser) -> Iterator[OpenPage]:
    """Opens pages with options of a browser's context, and checks them all at the end."""
    opened: list[Guarded] = []

    def make(root: str, **options: Any) -> Guarded:
        context = chromium.new_context(
            **{"viewport": {"width": 1440, "height": 900}, "accept_downloads": True} | options
        )
        context.set_default_timeout(PATIENCE_S * 1000)
        guarded = Guarded(context.new_page(), root)
        watch(guarded)
        opened.append(guarded)
        return guarded

    yield make
    for guarded in opened:
        guarded.page.context.close()
    for guarded in opened:
        guarded.check()


@pytest.fixture(scope="package")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One service with a worker for all tests here."""
    installed("chromium", "chromium-browser")
    folder = tmp_path_factory.mktemp("browser")
    # how soon pictures come is not tried here, and the page shows none that came too late
    with running_service(folder, worker_concurrency="1", preview_timeout_s="60") as running:
        until = time.monotonic() + PATIENCE_S * 3
        while running.client.get("/readyz").json()["status"] != "ok":  # the worker loads and warms the method
            assert time.monotonic() < until, running.log.read_text()[-4000:]
            time.sleep(0.2)
        yield running


@pytest.fixture(scope="session")
def tiny_clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One second of a woman who smiles, 640x360."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clips") / "smile.mp4", 20, 44)


@pytest.fixture(scope="session")
def heard_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of which the browser plays the sound and cannot show the pictures, as it does with HEVC in many."""
    folder = tmp_path_factory.mktemp("heard")
    pictures = [libav_frame(np.full((64, 96, 3), 90, np.uint8))] * 25
    return add_tone(encode_raw(folder / "mute.mp4", pictures, "mpeg4"), 1, 0, folder / "heard.mp4")


@pytest.fixture
def pages(service: Service, open_page: OpenPage) -> Callable[..., Guarded]:
    """Opens pages of the service: on a machine that stands still it may answer 503, and the page asks again."""
    root = str(service.client.base_url).rstrip("/")

    def make(**options: Any) -> Guarded:
        guarded = open_page(root, **options)
        guarded.expected.append("status of 503")
        return guarded

    return make


@pytest.fixture
def desk(api: Api, open_page: OpenPage, tiny_clip: Path) -> Desk:
    video = api.client.post("/videos", content=tiny_clip.read_bytes()).raise_for_status().json()
    make_ready(api.services, video["id"])
    guarded = open_page(str(api.client.base_url).rstrip("/"))
    guarded.expected += ["status of 409", "status of 503"]  # pictures are made by a worker, which is not there
    return Desk(api, video, guarded)
