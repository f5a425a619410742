from __future__ import annotations

import pickle
import socket
from pathlib import Path

import pytest

from pvg.errors import MediaError, TooLargeError, TooLongError
from pvg.video import (
    MediaLimits,
    probe,
)
from scripts.samples import Samples
from tests.gallery.clips import (
    every_frame,
)


def test_every_limit_is_kept_and_named(samples: Samples) -> None:
    clip = samples.woman_clip  # 640x360, 168 frames, 24 a second, 7 s
    for limits, words, kind, limit in (
        (MediaLimits(max_pixels=640 * 360 - 1), "640x360", TooLargeError, (640 * 360 - 1, "pixels")),
        (MediaLimits(max_frames=100), "frames", TooLongError, (100, "frames")),
        (MediaLimits(max_duration_s=3.0), r"3\.0 s", TooLongError, (3.0, "seconds")),
        (MediaLimits(max_streams=0), "stream", TooLargeError, (0, "streams")),
    ):
        for call in (probe, every_frame):
            with pytest.raises(kind, match=words) as caught:
                call(clip, limits)
            assert (caught.value.limit, caught.value.unit) == limit
    with pytest.raises(TooLargeError, match="frames a second") as caught:
        probe(clip, MediaLimits(max_frame_rate=10.0))
    assert (caught.value.limit, caught.value.unit) == (10.0, "frames per second")
    assert every_frame(clip, MediaLimits(max_pixels=640 * 360, max_frames=168, max_duration_s=7.1)) == 168


@pytest.mark.parametrize("limit", [None, "10", float("nan"), -1])
def test_a_limit_is_a_number_from_0_on(limit: object) -> None:
    with pytest.raises(ValueError, match=r"^max_duration_s must be a number from 0 to inf, not "):
        MediaLimits(max_duration_s=limit)  # type: ignore[arg-type]


def test_infinity_is_no_limit(samples: Samples) -> None:
    none = MediaLimits(*[float("inf")] * 5)  # type: ignore[arg-type]
    assert every_frame(samples.woman_clip, none) == 168
    assert every_frame(samples.dark_portrait, none) == 1


def test_an_error_of_a_limit_passes_between_processes() -> None:
    error = TooLongError("a.mp4 lasts 9.0 s; at most 3.0 s are accepted", 3.0, "seconds")
    passed = pickle.loads(pickle.dumps(error))
    assert (type(passed), str(passed), passed.limit, passed.unit) == (TooLongError, str(error), 3.0, "seconds")
    assert isinstance(passed, MediaError)


def test_a_cut_off_clip_is_refused(samples: Samples, tmp_path: Path) -> None:
    body = samples.single_face_clip.read_bytes()
    for part in (0.3, 0.6, 0.9):
        path = tmp_path / "cut.mp4"
        path.write_bytes(body[: int(part * len(body))])
        with pytest.raises(MediaError):
            every_frame(path)


# the labelled media


def test_external_references_are_never_opened(media_dir: Path, tmp_path: Path) -> None:
    """A clip whose data lives at a URL is refused without a connection to it."""
    address = b"http://127.0.0.1:9/"
    body = (media_dir / "odd" / "bad_external_dref_http.mp4").read_bytes()
    assert address in body
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        # a port of five digits in the place of "9/": the box keeps its length when the path loses as much
        ours = f"http://127.0.0.1:{server.getsockname()[1]}/".encode()
        start = body.index(address)
        end = body.index(b"\0", start)
        path = tmp_path / "remote.mp4"
        path.write_bytes(body[:start] + ours.ljust(end - start, b"x")[: max(end - start, len(ours))] + body[end:])
        with pytest.raises(MediaError):
            every_frame(path)
        with pytest.raises(BlockingIOError):
            server.accept()
