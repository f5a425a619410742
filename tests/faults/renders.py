"""Renders that the drills ask for: of a clip or picture with its own colours."""

from __future__ import annotations

from pathlib import Path

import cv2
import httpx

from tests.waiting import until
from tests.worker.serving import Service


def transfer(client: httpx.Client, video: str, *seeds: int, **more: object) -> str:
    """Ask for a look of each seed; the job's id."""
    wanted = {"video": video, "looks": [{"reference": video, "seed": seed} for seed in seeds], **more}
    return str(client.post("/transfer", json=wanted).raise_for_status().json()["id"])


def until_it_draws(service: Service, job_id: str) -> None:
    """Wait until a render has drawn a frame."""

    def draws() -> bool:
        job = service.job(job_id)
        assert not job["done"], job
        return job["progress"]["stage"] == "render" and job["progress"]["frames_done"] >= 1

    until(draws, 240, said=lambda: service.job(job_id))


def small_picture(picture: Path, folder: Path, width: int) -> Path:
    """A copy of so many pixels across, which is drawn in no time."""
    whole = cv2.imread(str(picture))
    assert whole is not None
    path = folder / "small.png"
    cv2.imwrite(str(path), cv2.resize(whole, (width, width * whole.shape[0] // whole.shape[1])))
    return path
