"""The page in a real browser, against the whole service with its worker."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Playwright, Request, sync_playwright

from scripts.samples import Samples
from tests.gallery.clips import cut_clip
from tests.service.fixtures import api, plain_logs, settings
from tests.service.servers import missing
from tests.worker.serving import Service, running_service

__all__ = ["api", "plain_logs", "settings"]

#: seconds that anything may take on a machine with much else to do
PATIENCE_S = 180.0


@dataclass
class Guarded:
    """A page of the browser, and whatever it should not have done."""

    page: Page
    root: str
    #: parts of lines of the console that a test expects
    expected: list[str] = field(default_factory=list)
    wrongs: list[str] = field(default_factory=list)

    def open(self, path: str = "/") -> Page:
        self.page.goto(self.root + path)
        self.until("() => 'ready' in document.documentElement.dataset")
        return self.page

    def until(self, script: str, argument: Any = None, seconds: float = PATIENCE_S) -> float:
        """Wait until a function of the page is true; the seconds that took.

        Playwright's own waiting evaluates text inside the page, which the page's policy forbids.
        """
        began = time.monotonic()
        while not self.page.evaluate(script, argument):
            assert time.monotonic() < began + seconds, f"not so after {seconds} s: {script}\n{self.wrongs}"
            time.sleep(0.02)
        return time.monotonic() - began

    def heard(self, reached: Callable[[], object]) -> None:
        """Wait until what the handlers of the page note is so; they run while Playwright waits."""
        end = time.monotonic() + PATIENCE_S
        while not reached():
            assert time.monotonic() < end, f"not heard of after {PATIENCE_S} s\n{self.wrongs}"
            self.page.wait_for_timeout(20)

    def check(self) -> None:
        """Fail when the page logged an error, asked another host or broke its policy."""
        wrongs = [one for one in self.wrongs if not any(part in one for part in self.expected)]
        assert wrongs == []


def _watch(guarded: Guarded) -> None:
    own = urlsplit(guarded.root).netloc

    def logged(message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            guarded.wrongs.append(f"{message.type}: {message.text}")

    def asked(request: Request) -> None:
        address = urlsplit(request.url)
        if address.scheme in {"http", "https", "ws", "wss"} and address.netloc != own:
            guarded.wrongs.append(f"asked {request.url}")
        if "pvg_" in request.url:
            guarded.wrongs.append(f"a key in {request.url}")

    guarded.page.on("console", logged)
    guarded.page.on("pageerror", lambda error: guarded.wrongs.append(f"thrown: {error}"))
    guarded.page.on("request", asked)


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    # not for the session: while it runs, nothing else in this thread can run an event loop
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def chromium(playwright: Playwright) -> Iterator[Browser]:
    """The installed Chromium, without a window. It finds no host but this machine."""
    command = shutil.which("chromium") or shutil.which("chromium-browser")
    if command is None:
        missing("chromium is not installed")
        return
    arguments = [
        *("--no-sandbox", "--disable-dev-shm-usage", "--autoplay-policy=no-user-gesture-required"),
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
        _watch(guarded)
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
    if not (shutil.which("chromium") or shutil.which("chromium-browser")):
        missing("chromium is not installed")
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


@pytest.fixture
def pages(service: Service, open_page: OpenPage) -> Callable[..., Guarded]:
    """Opens pages of the service: on a machine that stands still it may answer 503, and the page asks again."""
    root = str(service.client.base_url).rstrip("/")

    def make(**options: Any) -> Guarded:
        guarded = open_page(root, **options)
        guarded.expected.append("status of 503")
        return guarded

    return make
