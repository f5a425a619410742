"""Two applications in one process share what FastAPI makes of their routes, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.settings import Settings
from tests.service.fixtures import MP4, Api, serve


@pytest.fixture
def other(tmp_path: Path) -> Iterator[Api]:
    """An API beside the first, behind a proxy that adds a path."""
    yield from serve(Settings(data_dir=tmp_path / "other", reap_interval_s=3600, root_path="/faces"))


def test_applications_of_one_process_share_their_routes_and_no_records(api: Api, other: Api) -> None:
    shared = {id(route) for route in api.app.routes} & {id(route) for route in other.app.routes}
    assert len(shared) > len(api.app.routes) / 2
    video = api.client.post("/videos", content=MP4).json()["id"]
    assert [one.client.get(f"/videos/{video}").status_code for one in (api, other)] == [200, 404]
    assert other.client.post("/videos", content=MP4).headers["location"].startswith("/faces/v1/videos/")
    assert api.client.post("/videos", content=MP4 + b"2").headers["location"].startswith("/v1/videos/")
