from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.clips import Window, make_clip
from pvg.video import probe, read_frames


def test_a_clip_is_played_there_and_back_through_a_window(short_clip: Path, tmp_path: Path) -> None:
    info = probe(short_clip)
    window = Window(info.width / 2, info.height / 2, 480, 400, 0.5)
    made = make_clip(short_clip, tmp_path / "made.mp4", 90, window)
    assert (probe(made).width, probe(made).height) == (480, 400)
    frames = [frame.planes[0].astype(np.float32) for frame in read_frames(made)]
    assert len(frames) == 90
    middle = (slice(120, 280), slice(120, 360))  # the picture itself, half as large, without the repeated edge

    def apart(a: int, b: int) -> float:
        return float(np.abs(frames[a][middle] - frames[b][middle]).mean())

    assert apart(0, 39) > 2.0  # the clip moves
    assert max(apart(k, 79 - k) for k in range(0, 40, 8)) < 0.5 * apart(0, 39)  # frames 40 to 79 go back
    assert max(apart(k, 80 + k) for k in range(0, 10, 3)) < 0.5 * apart(0, 39)
    source = next(read_frames(short_clip))
    whole = source.planes[0][::2, ::2].astype(np.float32)
    rows = slice(120 - (400 - whole.shape[0]) // 2, 280 - (400 - whole.shape[0]) // 2)
    columns = slice(120 - (480 - whole.shape[1]) // 2, 360 - (480 - whole.shape[1]) // 2)
    assert np.abs(frames[0][middle] - whole[rows, columns]).mean() < 4.0
