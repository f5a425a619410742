"""The same transfer asked for over HTTP: the service on its embedded default, one look, one look more."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from scripts.demo import running_service

_WAIT_S = 10  # of one long poll
_LIMIT_S = 900.0
_PATIENCE_S = 60.0


@contextmanager
def served(folder: Path) -> Iterator[httpx.Client]:
    """The service on its embedded default with its data in a folder, and a client of it."""
    with running_service(folder) as url, httpx.Client(base_url=f"{url}/v1", timeout=_PATIENCE_S) as client:
        yield client


def upload(client: httpx.Client, path: str, file: Path) -> dict[str, Any]:
    """Send a file as a form; the medium that it becomes."""
    with file.open("rb") as data:
        body: dict[str, Any] = client.post(f"{path}/form", files={"file": (file.name, data)}).raise_for_status().json()
    return body


def until_done(client: httpx.Client, job: str) -> None:
    """Wait for a job. Raises RuntimeError when it does not succeed, or not in time."""
    deadline = time.monotonic() + _LIMIT_S
    while time.monotonic() < deadline:
        body = client.get(f"/jobs/{job}", params={"wait": _WAIT_S}).raise_for_status().json()
        if body["done"]:
            if body["state"] != "succeeded":
                raise RuntimeError(f"job {job} {body['state']}: {body['error']}")
            return
    raise RuntimeError(f"job {job} was not done after {_LIMIT_S:.0f} s")


def over_http(clip: Path, portraits: tuple[Path, ...], repeats: int) -> dict[str, Any]:
    """Wall seconds from a posted transfer to its finished job, for one look, and of upload to vectorised clip.

    Every transfer asks for another strength, since the service does not do the same work twice.
    """
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as client:
        started = time.perf_counter()
        video = upload(client, "/videos", clip)
        reference = upload(client, "/references", portraits[0])
        until_done(client, video["job"])
        vectorised = time.perf_counter() - started
        taken = []
        for turn in range(repeats + 1):  # the first one waits for the reference too
            look = {"reference": reference["id"], "strength": 1.0 - turn / 100.0}
            started = time.perf_counter()
            accepted = client.post("/transfer", json={"video": video["id"], "looks": [look]}).raise_for_status()
            until_done(client, accepted.json()["id"])
            taken.append(time.perf_counter() - started)
    return {"upload and vectorise": vectorised, "first transfer": taken[0], "transfer": taken[1:]}
