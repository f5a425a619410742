"""Which Matroska files lack blocks, and which are only cut or written carelessly."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from benchmarks.quality.lossless import write_lossless
from pvg.errors import MediaError
from pvg.video import probe, read_frames
from pvg.video.ebml import CLUSTER, SEGMENT

FRAMES = 12


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    path = tmp_path / "clip.mkv"
    write_lossless(path, (rng.integers(0, 256, (48, 64, 3), np.uint8) for _ in range(FRAMES)))
    return path


def understated(clip: Path, by: int) -> None:
    """Make the segment's size so many bytes less than it is."""
    data = bytearray(clip.read_bytes())
    size = data.index(SEGMENT) + len(SEGMENT)
    assert data[size] == 1, "a size of eight bytes"
    length = int.from_bytes(data[size + 1 : size + 8], "big")
    data[size + 1 : size + 8] = (length - by).to_bytes(7, "big")
    clip.write_bytes(data)


@pytest.mark.parametrize("by", [8, 500])
def test_a_segment_that_is_longer_than_it_says_has_all_its_pictures(clip: Path, by: int) -> None:
    understated(clip, by)
    info = probe(clip, strict=True)
    assert (info.frame_count, info.warnings) == (FRAMES, ())
    assert len(list(read_frames(clip))) == FRAMES


def test_a_cut_picture_that_holds_a_clusters_name_is_cut_and_not_damaged(clip: Path) -> None:
    with av.open(str(clip)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    last = packets[-2]
    assert last.pos is not None
    data = bytearray(clip.read_bytes()[: last.pos + last.size * 3 // 4])
    at = len(data) - last.size // 4
    data[at : at + len(CLUSTER)] = CLUSTER
    clip.write_bytes(data)
    (warning,) = probe(clip).warnings
    assert "is cut short" in warning
    with pytest.raises(MediaError, match="is cut short"):
        probe(clip, strict=True)
