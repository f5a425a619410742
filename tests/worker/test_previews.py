"""Single pictures with the real service: API, broker and the worker of previews, on both settings."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from pvg.video import read_frames
from scripts.samples import Samples
from tests.conftest import cut_clip
from tests.waiting import until
from tests.worker.serving import Service, sandboxed, service_on

#: no picture is given up, and no clip closed, because the machine is busy
QUICK = {"reap_interval_s": "1", "preview_timeout_s": "50", "preview_idle_s": "3600"}


#: the worker of pictures is the same process, on a machine of its own
embedded = pytest.mark.parametrize(
    "service", ["embedded", pytest.param("scaled", marks=pytest.mark.slow)], indirect=True, scope="module"
)


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    yield from service_on(request, tmp_path_factory, **QUICK)


@pytest.fixture(scope="module")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 frames of a woman, 640x360."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clip") / "woman.mp4", 20, 32)


@pytest.fixture
def video(service: Service, clip: Path) -> dict[str, Any]:
    return service.ready("/videos", clip)


@pytest.fixture
def reference(service: Service, samples: Samples) -> dict[str, Any]:
    return service.ready("/references", samples.dark_portrait)


def decoded(answer: httpx.Response) -> NDArray[np.uint8]:
    assert answer.status_code == 200, answer.text
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(picture[..., ::-1], np.uint8)


def preview(service: Service, wanted: dict[str, Any], **headers: str) -> httpx.Response:
    """The answer, once the worker of previews has started."""
    end = time.monotonic() + 180
    while True:
        answer = service.client.post("/preview", json=wanted, headers=headers)
        if answer.status_code != 503 or time.monotonic() > end:
            return answer
        time.sleep(0.2)


def pictures(service: Service) -> list[str]:
    """The keys of the small pictures that were asked for."""
    return [key for key in service.blobs() if "preview/" in key and key.endswith(".jpg")]


def copies(service: Service) -> list[bytes]:
    """What is in the files that are not its own, but copies, or not finished."""
    found = []
    for path in service.files():
        if path.parent.parent.name == "spool":
            with suppress(FileNotFoundError):
                found.append(path.read_bytes())
    return found


def test_frames_looks_and_small_pictures(
    service: Service, clip: Path, video: dict[str, Any], reference: dict[str, Any]
) -> None:
    source = [frame.rgb() for frame in read_frames(clip)]
    wanted = {"video": video["id"], "look": {"reference": reference["id"]}, "frame": 7, "format": "png"}
    before = decoded(preview(service, {**wanted, "before": True}))
    np.testing.assert_array_equal(before, source[7])
    after = decoded(preview(service, wanted))
    changed = np.abs(after.astype(int) - before).max(axis=2) > 8
    assert 0.1 < changed.mean() < 0.5
    none = decoded(preview(service, {**wanted, "look": {"reference": reference["id"], "strength": 0}}))
    assert np.abs(none.astype(int) - before).mean() < 1

    # a part of it is that part
    x, y, width, height = 100, 40, 200, 160
    part = decoded(preview(service, {**wanted, "crop": [x, y, width, height]}))
    np.testing.assert_array_equal(part, after[y : y + height, x : x + width])
    small = preview(service, {**wanted, "format": "jpeg", "max_width": 320, "time_s": 0.2, "frame": None})
    assert decoded(small).shape == (180, 320, 3)
    assert small.headers["content-type"] == "image/jpeg"
    # without a frame, one that shows the face: a key picture
    usual = preview(service, {"video": video["id"], "look": wanted["look"], "face": 0})
    assert decoded(usual).shape[1] < 640
    assert 0 <= int(usual.headers["pvg-frame"]) < 12
    assert preview(service, {**wanted, "crop": [0, 0, 10, 10], "frame": 12}).status_code == 422

    for layer in ("image", "landmarks", "mask", "matte", "curves", "low", "high"):
        shown = decoded(service.client.get(f"/videos/{video['id']}/frames/7?layer={layer}"))
        assert shown.shape == (360, 640, 3)
        if layer == "image":
            np.testing.assert_array_equal(shown, source[7])
    marked = decoded(service.client.get(f"/references/{reference['id']}/frames/0?layer=landmarks"))
    assert marked.shape[:2] == (reference["media"]["height"], reference["media"]["width"])

    # kept with the medium since it was vectorised: no worker is asked
    # who waits is answered before the log is
    made = until(
        lambda: len(events) if len(events := service.events("picture made")) >= 14 else 0,
        said=service.log.read_text,
    )
    for medium in (video, reference):
        poster = decoded(service.client.get(medium["poster"]))
        assert max(poster.shape[:2]) == min(640, max(medium["media"]["width"], medium["media"]["height"]))
        (face,) = medium["faces"]
        assert decoded(service.client.get(face["thumbnail"])).shape == (160, 160, 3)
        left, top, wide, high = face["box"]
        assert 0 <= left < left + wide <= medium["media"]["width"]
        assert 0 <= top < top + high <= medium["media"]["height"]
        kept = service.client.get(medium["poster"])
        etag = {"If-None-Match": kept.headers["etag"]}
        assert service.client.get(medium["poster"], headers=etag).status_code == 304
    assert len(service.events("picture made")) == made


def test_a_clip_stays_open_until_its_medium_is_deleted(service: Service, clip: Path, reference: dict[str, Any]) -> None:
    video = service.ready("/videos", clip)
    wanted = {"video": video["id"], "look": {"reference": reference["id"]}, "max_width": 200}
    assert preview(service, wanted).status_code == 200
    # each worker has tried by now what it can confine, for which it forks a process too
    tried = re.compile("jobs run in a sandbox|the sandbox of jobs is not whole")
    until(lambda: len(tried.findall(service.log.read_text())) >= (2 if service.s3 is None else 3), 180)
    opened = len(sandboxed(service))
    assert opened >= 1
    for strength in (0.2, 0.4, 0.6):
        look = {"reference": reference["id"], "strength": strength}
        assert preview(service, {**wanted, "look": look}).status_code == 200
    assert len(sandboxed(service)) == opened
    assert pictures(service)
    # an object store's file is here as a copy
    content = clip.read_bytes()
    assert copies(service).count(content) == (service.s3 is not None)
    assert service.client.delete(f"/videos/{video['id']}").status_code == 204
    # a busy database has them deleted a little later
    until(lambda: not [path for path in service.files() if ".jpg" in path.name and video["id"] in path.name])
    until(lambda: pictures(service) == [])
    until(lambda: len(sandboxed(service)) < opened)
    until(lambda: content not in copies(service))
    assert service.client.post("/preview", json=wanted).status_code == 404


@embedded
def test_a_long_job_does_not_hold_it_up(service: Service, samples: Samples, reference: dict[str, Any]) -> None:
    video = service.ready("/videos", samples.single_face_clip)
    looks = [{"reference": reference["id"], "seed": seed} for seed in range(16)]
    jobs = [
        service.client.post("/transfer", json={"video": video["id"], "looks": looks, "force": True}).json()["id"]
        for _ in range(4)
    ]
    service.at_work(jobs[0])
    for strength in (0.3, 0.6):
        wanted = {"video": video["id"], "look": {"reference": reference["id"], "strength": strength}}
        assert preview(service, wanted).status_code == 200
    assert not service.job(jobs[-1])["done"]
    for job in jobs:
        service.client.post(f"/jobs/{job}/cancel")
    for job in jobs:
        service.finished(job)
