from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from service.settings import Settings
from tests.service.fixtures import MP4, Api, serve


@pytest.fixture
def brokerless(settings: Settings) -> Iterator[Api]:
    """An API whose broker is away."""
    yield from serve(settings.model_copy(update={"broker_url": "redis://127.0.0.1:1/0"}))


def test_a_running_service_is_live_and_ready(api: Api) -> None:
    assert api.client.get("/livez").json() == {"status": "ok"}
    ready = api.client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json() == {"status": "ok", "checks": {"database": "ok", "storage": "ok", "broker": "ok"}}
    assert api.blobs == []


def test_without_its_broker_the_service_takes_work(brokerless: Api) -> None:
    ready = brokerless.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (200, "degraded")
    assert ready.json()["checks"]["broker"] == "unavailable"
    video = brokerless.client.post("/videos", content=MP4)
    assert video.status_code == 202
    look = {"reference": video.json()["id"]}
    assert brokerless.client.post("/transfer", json={"video": video.json()["id"], "looks": [look]}).status_code == 202


def test_without_its_storage_the_service_is_not_ready(api: Api) -> None:
    folder = api.services.settings.local_storage_folder
    assert folder is not None
    shutil.rmtree(folder)
    folder.write_text("in the way")
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (503, "unavailable")
    assert ready.json()["checks"]["storage"] == "unavailable"
