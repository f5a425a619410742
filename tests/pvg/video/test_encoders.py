"""What is written where PyAV was built without some encoders, as without the GPL's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av.codec
import pytest

from pvg.video import VideoWriter, probe, read_frames
from pvg.video.encoders import choose_codec
from scripts.samples import Samples


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that takes encoders away by their libav names."""
    real = av.codec.Codec

    def take_away(*names: str) -> None:
        def codec(name: str, mode: str = "r") -> av.codec.Codec:
            if mode == "w" and name in names:
                raise av.codec.codec.UnknownCodecError(name)
            return real(name, mode)  # type: ignore[arg-type]

        monkeypatch.setattr(av.codec, "Codec", codec)

    return take_away


def test_auto_takes_the_next_encoder_that_is_there(without: Any) -> None:
    assert [choose_codec("auto", "mp4", depth) for depth in (8, 10)] == ["h264", "hevc"]
    assert [choose_codec("auto", "webm", depth) for depth in (8, 10)] == ["vp9", "av1"]
    without("libx264")
    assert [choose_codec("auto", "mp4", depth) for depth in (8, 10)] == ["hevc", "hevc"]
    without("libx264", "libx265")
    assert [choose_codec("auto", "mp4", depth) for depth in (8, 10)] == ["vp9", "av1"]
    without("libx264", "libx265", "libvpx-vp9")
    assert choose_codec("auto", "matroska", 8) == "av1"
    assert choose_codec("auto", "webm", 8) == "av1"


def test_what_has_no_encoder_is_refused_in_words(without: Any) -> None:
    without("libx264", "libx265")
    with pytest.raises(ValueError, match="no libx264 for h264; leave the codec to auto"):
        choose_codec("h264", "mp4", 8)
    with pytest.raises(ValueError, match="no encoder for mov: none of libx264, libx265"):
        choose_codec("auto", "mov", 8)


def test_a_clip_is_written_without_x264_and_x265(without: Any, samples: Samples, tmp_path: Path) -> None:
    without("libx264", "libx265")
    info = probe(samples.woman_clip)
    with VideoWriter(tmp_path / "out.mp4", info, info.format) as writer:
        for frame in read_frames(samples.woman_clip, start=0, stop=3):
            writer.write(frame)
    assert (probe(tmp_path / "out.mp4").codec, probe(tmp_path / "out.mp4").frame_count) == ("vp9", 3)
