"""A page of the browser that is watched for whatever it should not do."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import ConsoleMessage, Page, Request

from tests.waiting import FIRST_S, longer

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
        began, pause_s = time.monotonic(), FIRST_S
        while not self.page.evaluate(script, argument):
            assert time.monotonic() < began + seconds, f"not so after {seconds} s: {script}\n{self.wrongs}"
            time.sleep(pause_s)
            pause_s = longer(pause_s)
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


def watch(guarded: Guarded) -> None:
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
