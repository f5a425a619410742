"""A service without a worker, with a clip, and the page: what hands do all day is tried on it."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

from playwright.sync_api import Page, Route

from tests.browser.driving import READY
from tests.browser.guarded import Guarded
from tests.service.fixtures import PNG, Api, make_ready

#: a picture of one pixel
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)

FOCUS = "() => document.activeElement.getAttribute('aria-label') ?? document.activeElement.id"


@dataclass
class Desk:
    """A service without a worker, with a clip, and the page."""

    api: Api
    video: dict[str, Any]
    guarded: Guarded

    def portrait(self, name: str) -> str:
        """Another portrait, ready; its id."""
        named = {"Content-Disposition": f'attachment; filename="{name}"'}
        medium = self.api.client.post("/references", content=PNG + name.encode(), headers=named).json()
        make_ready(self.api.services, medium["id"])
        return str(medium["id"])

    def asked(self, reference: str) -> str:
        """A look of the clip that waits; the id of its job."""
        job = {"video": self.video["id"], "looks": [{"reference": reference}]}
        return str(self.api.client.post("/transfer", json=job).json()["id"])

    def edit(self) -> Page:
        """The page with the clip, as after a reload."""
        page = self.guarded.open(f"/#{self.video['id']}")
        self.guarded.until(READY)
        return page


def stopped(desk: Desk, path: str, name: str, content: bytes) -> dict[str, Any]:
    """A medium whose vectorisation was canceled."""
    named = {"Content-Disposition": f'attachment; filename="{name}"'}
    medium: dict[str, Any] = desk.api.client.post(path, content=content, headers=named).raise_for_status().json()
    assert desk.api.client.post(f"/jobs/{medium['job']}/cancel").status_code == 202
    return medium


def cut(route: Route) -> None:
    """As a service that is not there."""
    route.abort()
