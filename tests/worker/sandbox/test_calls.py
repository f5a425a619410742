"""The calls of a job on media, in the process of the tests."""

from __future__ import annotations

from pathlib import Path

from pvg.video import read_frames
from scripts.samples import Samples
from tests.gallery.clips import encode_raw, libav_frame
from worker.sandbox import calls


def test_a_clip_whose_tags_are_not_read_is_vectorised_by_the_colours_that_it_is_said_to_have(
    samples: Samples, tmp_path: Path
) -> None:
    """As some cameras tag their logarithm."""
    pictures = [libav_frame(frame.rgb()) for frame in read_frames(samples.woman_clip, stop=2)]
    options = {"preset": "ultrafast", "x264-params": "transfer=log100"}
    clip = encode_raw(tmp_path / "log.mp4", pictures, "libx264", **options)
    arguments = {"source": str(clip), "asset": str(tmp_path / "log.pvg"), "pictures": str(tmp_path / "pictures")}
    settings = {"reference": False, "input_color": "slog3", "mask": "landmarks", "matching": "table"}
    arguments |= {"limits": {}, "memory_bytes": 2**33, "options": settings}
    answer = calls.CALLS["vectorize"](arguments, lambda *_: None)
    assert answer["output"] == {"container": "mp4", "refused": None, "lost": []}
