"""Fixtures of the rendering's tests: a real face of the short clip."""

from __future__ import annotations

import pytest

import pvg
from pvg.asset import FaceInFrame


@pytest.fixture(scope="session")
def face(video: pvg.VectorVideo) -> FaceInFrame:
    """The woman of the short clip, in the middle of it."""
    found = video.face_at(0, 20)
    assert found is not None
    return found
