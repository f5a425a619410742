"""Single pictures of the real service."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg_client import ApiError, Client, Look
from scripts.samples import Samples
from tests.waiting import until
from tests.worker.serving import Service


@pytest.fixture(autouse=True)
def worker_of_previews(service: Service) -> None:
    """It is a process of its own, and starts in its own time."""
    until(lambda: "pvg_preview_workers 0.0" not in service.client.get("/metrics").raise_for_status().text, 180)


def picture(data: bytes) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), int)


def test_a_preview_shows_the_look_before_it_is_drawn(client: Client, clip: Path, samples: Samples) -> None:
    video, reference = client.upload(clip), client.upload(samples.dark_portrait, role="reference")
    client.wait(video)
    client.wait(reference)
    before = picture(client.preview(video, frame=3, format="png"))
    after = picture(client.preview(video, Look(reference), frame=3, format="png"))
    half = picture(client.preview(video, Look(reference, strength=0.5), frame=3, format="png"))
    assert before.shape == after.shape == (360, 640, 3)
    assert 0 < np.abs(half - before).mean() < np.abs(after - before).mean()
    assert picture(client.preview(video, reference, max_width=320, nearest=True)).shape == (180, 320, 3)
    assert picture(client.preview(video, reference, crop=(100, 50, 64, 32))).shape == (32, 64, 3)
    with pytest.raises(ApiError) as caught:
        client.preview(video, reference, frame=12)
    assert [one.pointer for one in caught.value.errors] == ["/frame"]


def test_frames_and_their_layers_posters_and_faces(client: Client, clip: Path, samples: Samples) -> None:
    video, reference = client.upload(clip), client.upload(samples.dark_portrait, role="reference")
    client.wait(video)
    client.wait(reference)
    own = picture(client.frame(video, 3))
    assert np.array_equal(own, picture(client.preview(video, frame=3, format="png")))
    matte = picture(client.frame(video.id, 3, layer="matte"))
    assert matte.shape == own.shape == (360, 640, 3)
    assert matte.min() == 0
    assert matte.max() == 255
    (face,) = client.medium(video.id).faces
    assert face.box is not None
    assert face.frame is not None
    x, y, width, height = face.box
    assert 0 <= x < x + width <= 640
    assert 0 <= y < y + height <= 360
    assert picture(client.thumbnail(video, face.index)).shape == (160, 160, 3)
    assert picture(client.poster(video)).shape == (360, 640, 3)
    assert max(picture(client.poster(reference)).shape) == 640
    with pytest.raises(ApiError) as caught:
        client.frame(video, 12)
    assert (caught.value.status, caught.value.code) == (404, "not-found")
