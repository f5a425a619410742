"""Fixtures of the rendering's tests: a real face of the short clip, and where it lies in its picture."""

from __future__ import annotations

import pytest

import pvg
from pvg.asset import FaceInFrame
from pvg.curves import table_labels
from pvg.rendering.placed_face import PlacedFace, place_face


@pytest.fixture(scope="session")
def face(video: pvg.VectorVideo) -> FaceInFrame:
    """The woman of the short clip, in the middle of it."""
    found = video.face_at(0, 20)
    assert found is not None
    return found


@pytest.fixture(scope="session")
def placed(face: FaceInFrame) -> PlacedFace:
    """The same face in its picture of 640x360."""
    found = place_face(face, table_labels(), 640, 360)
    assert found is not None
    return found
