"""How many looks share a pass follows from the codec that is written, not from the word that asked for it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import pvg
from pvg.memory import rendering_bytes
from pvg.rendering import render_part
from pvg.video import probe, read_frames
from scripts.samples import Samples
from tests.gallery.clips import encode_raw, libav_frame


@pytest.fixture(scope="module")
def deep(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    """Nine frames of 10 bits, which become HEVC, but AV1 in WebM; of 640x360 AV1's encoder takes less."""
    frames = read_frames(samples.woman_clip, start=20, stop=29)
    pictures = [libav_frame(frame.rgb(), "yuv420p10le") for frame in frames]
    clip = encode_raw(tmp_path_factory.mktemp("deep") / "deep.mkv", pictures, "ffv1")
    with pvg.vectorize(clip) as video:
        yield video


def test_a_clip_for_webm_is_planned_as_the_codec_it_gets(deep: pvg.VectorVideo, tmp_path: Path) -> None:
    info, looks = probe(deep.require_source()), [pvg.transfer(deep, deep)] * 2
    totals: list[int] = []

    def note(stage: str, done: int, total: int) -> None:
        totals.append(total)

    def passes() -> int:
        found = totals[-1] // deep.frame_count
        totals.clear()
        return found

    budget = (rendering_bytes(info, 2, "av1") + rendering_bytes(info, 2, "hevc")) // 2
    assert rendering_bytes(info, 2, "av1") < budget < rendering_bytes(info, 2, "hevc")
    for names, expected in ((("a.mkv", "b.mkv"), 2), (("a.webm", "b.webm"), 1), (("a.webm", "b.mkv"), 2)):
        pvg.render(deep, looks, [tmp_path / name for name in names], memory_bytes=budget, progress=note)
        assert passes() == expected
    parts = [tmp_path / "a.part", tmp_path / "b.part"]
    render_part(deep, looks, parts, start=0, stop=9, container="webm", memory_bytes=budget, progress=note)
    assert passes() == 1
