"""Fixtures of the video tests: a long clip, and one with sound."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.gallery.clips import (
    add_tone,
    encode_raw,
    libav_frame,
    short_clip,
)
from tests.gallery.pictures import colorful


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """600 frames with a key picture every 24 and reordered frames between them."""
    base = colorful(9, (160, 96))
    raw = [libav_frame(np.roll(base, k, 1)) for k in range(600)]
    return encode_raw(tmp_path_factory.mktemp("long") / "clip.mp4", raw, "libx264", g="24", preset="veryfast", bf="3")


@pytest.fixture(scope="module")
def sounding_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 s of pictures and 3 s of sound, silent for its first second."""
    folder = tmp_path_factory.mktemp("sound")
    return add_tone(short_clip(folder / "silent.mp4", 50), 3.0, 1.0, folder / "clip.mp4")
