from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pvg.video import probe, read_frames, sha256_file

_FRAMES = 45


def test_the_digest_is_that_of_the_bytes(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert sha256_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def recorded(*, live: bool) -> bytes:
    """A WebM of about 30 frames a second, stamped in milliseconds as they came, that states neither rate nor length."""
    written, ends = io.BytesIO(), np.round(np.arange(_FRAMES) * 1000 / 30 + np.random.default_rng(3).uniform(0, 9, 45))
    with av.open(written, "w", format="webm", options={"live": "1"} if live else {}) as output:
        stream = output.add_stream("libvpx-vp9", rate=30, options={"deadline": "realtime", "cpu-used": "8"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for k, at in enumerate(ends):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 4 * k, np.uint8), format="rgb24")
            frame.pts, frame.time_base = int(at), Fraction(1, 1000)
            output.mux(stream.encode(frame.reformat(format="yuv420p")))
        output.mux(stream.encode(None))
    content = written.getvalue()
    at = content.index(b"\x23\xe3\x83\x84")  # DefaultDuration, of four bytes
    return content[:at] + b"\xec\x86" + bytes(6) + content[at + 8 :]  # Void


@pytest.mark.parametrize("live", [False, True])
def test_a_browsers_recording_has_the_rate_of_its_time_stamps(tmp_path: Path, live: bool) -> None:
    """It does not say one, and what libav guesses is the grid of the stamps, a thousand a second."""
    path = tmp_path / "recorded.webm"
    path.write_bytes(recorded(live=live))
    info = probe(path)
    assert info.frame_count == _FRAMES
    assert float(info.frame_rate or 0) == pytest.approx(30, rel=0.02)
    assert info.duration_s == pytest.approx(_FRAMES / 30, abs=0.1)
    assert len(list(read_frames(path))) == _FRAMES
