from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import Frame, MediaLimits, SingleFrames, display_order, read_frames, single_frames, write_image
from pvg.video.opening import OpenClip
from tests.gallery import odd_clips
from tests.gallery.clips import encode_raw, libav_frame, pixel_format, smooth_frames, write_clip
from tests.gallery.pictures import colorful
from tests.side_by_side import at_once

_FRAMES = 40

Same = tuple[int, int, float, int, str, tuple[bytes, ...]]


def _all_of(frame: Frame) -> Same:
    planes = tuple(plane.tobytes() for plane in frame.planes)
    return frame.index, frame.pts, frame.time_s, frame.duration, frame.format.name, planes


def _raw(layout: str = "yuv420p", count: int = _FRAMES) -> list[Any]:
    base = colorful(11, (160, 96))
    return [libav_frame(np.roll(base, 3 * k, 1), layout) for k in range(count)]


_KINDS: dict[str, Callable[[Path], Path]] = {
    "8 bits, one key picture": lambda folder: encode_raw(
        folder / "c.mp4", _raw(), "libx264", g="200", bf="3", preset="veryfast"
    ),
    "open groups": lambda folder: encode_raw(
        folder / "c.mp4", _raw(), "libx264", bf="4", refs="4", **{"x264-params": "keyint=12:open-gop=1:scenecut=0"}
    ),
    "10 bits, open groups": lambda folder: encode_raw(
        folder / "c.mp4", _raw("yuv420p10le"), "libx265", **{"x265-params": "log-level=none:keyint=12:open-gop=1"}
    ),
    "no order of decoding told": lambda folder: encode_raw(folder / "c.avi", _raw(), "mpeg4", g="10"),
    "AV1": lambda folder: write_clip(folder / "c.mp4", smooth_frames(_FRAMES, pixel_format()), codec="av1"),
    "VP9": lambda folder: encode_raw(
        folder / "c.webm", _raw(), "libvpx-vp9", g="20", deadline="realtime", **{"cpu-used": "8"}
    ),
    "sideways": lambda folder: encode_raw(folder / "c.mp4", _raw(), "libx264", degrees=90, g="24", bf="2"),
    "sideways 4:2:2": lambda folder: encode_raw(
        folder / "c.mov", _raw("yuv422p10le"), "libx264", degrees=90, g="24", bf="2"
    ),
    "variable rate": odd_clips.variable_rate,
    "late start": odd_clips.late_start_mkv,
    "edit list": odd_clips.edit_list,
}


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 frames with a key picture at the first and every tenth one."""
    return encode_raw(tmp_path_factory.mktemp("single") / "c.mp4", _raw(), "libx264", g="10", bf="2", sc_threshold="0")


@pytest.fixture
def frames() -> Iterator[SingleFrames]:
    single = SingleFrames()
    yield single
    single.close()


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Grows by the path of each clip that is opened."""
    paths: list[Path] = []

    def noted(path: Path, limits: MediaLimits) -> Any:
        paths.append(path)
        return open_clip(path, limits)

    open_clip = single_frames.open_clip
    monkeypatch.setattr(single_frames, "open_clip", noted)
    return paths


def _places(frames: SingleFrames) -> list[int]:
    kept = frames._kept
    return [] if kept is None else sorted(one.frame.index for one in kept.decoders if one.frame is not None)


def _at(frames: SingleFrames, clip: Path, index: int) -> Frame:
    frame = frames.frame(clip, index)
    assert frame is not None
    return frame


def _packets_of(monkeypatch: pytest.MonkeyPatch, work: Callable[[], Any]) -> int:
    """How many packets `work` decodes."""
    count = 0
    plain = OpenClip.decode

    def counted(self: OpenClip, packet: Any) -> list[Any]:
        nonlocal count
        count += 1
        return plain(self, packet)

    with monkeypatch.context() as patched:
        patched.setattr(OpenClip, "decode", counted)
        work()
    return count


@pytest.mark.parametrize("kind", _KINDS)
def test_frames_in_any_order_are_those_of_the_clip_read_in_its_order(kind: str, tmp_path: Path) -> None:
    path, frames = _KINDS[kind](tmp_path), SingleFrames()
    expected = [_all_of(frame) for frame in read_frames(path)]
    count = len(expected)
    order = [*random.Random(3).choices(range(count), k=40), *range(0, count, 3), *range(count - 1, -1, -5)]
    seen = [(index, frames.frame(path, index, frame_count=count)) for index in order]
    assert all(frame is None or _all_of(frame) == expected[index] for index, frame in seen)
    # where the order is told all of them are come by
    told = display_order(path, MediaLimits(), count) is not None
    assert sum(frame is not None for _, frame in seen) == (len(order) if told else 0)


def test_threads_that_ask_at_once_get_their_frames(clip: Path, frames: SingleFrames) -> None:
    expected = [_all_of(frame) for frame in read_frames(clip)]

    def ask(seed: int) -> list[int]:
        indices = random.Random(seed).choices(range(_FRAMES), k=15)
        return [index for index in indices if _all_of(_at(frames, clip, index)) != expected[index]]

    assert at_once([partial(ask, seed) for seed in range(6)]) == [[]] * 6
    assert len(_places(frames)) == 3


def test_a_frame_ahead_is_decoded_from_where_the_last_one_was(
    tmp_path: Path, frames: SingleFrames, opened: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = encode_raw(tmp_path / "c.mp4", _raw(), "libx264", g="200", bf="2")
    _at(frames, clip, 25)
    again = _packets_of(monkeypatch, lambda: _at(SingleFrames(), clip, 28))
    opened.clear()
    onward = _packets_of(monkeypatch, lambda: _at(frames, clip, 28))
    assert not opened
    assert onward <= 4
    assert again >= 28
    assert _packets_of(monkeypatch, lambda: _at(frames, clip, 28)) == 0
    assert _places(frames) == [28]


def test_an_earlier_frame_is_decoded_beside_and_both_places_stay(
    clip: Path, frames: SingleFrames, opened: list[Path]
) -> None:
    for index in (35, 12, 14, 36):
        _at(frames, clip, index)
    assert len(opened) == 2
    assert _places(frames) == [14, 36]


def test_a_key_picture_in_between_is_gone_to(clip: Path, frames: SingleFrames, monkeypatch: pytest.MonkeyPatch) -> None:
    _at(frames, clip, 2)
    assert _packets_of(monkeypatch, lambda: _at(frames, clip, 31)) < 15


def test_of_three_places_the_one_that_saves_least_is_given_up(
    clip: Path, frames: SingleFrames, opened: list[Path]
) -> None:
    for index in (38, 15, 14, 27):
        _at(frames, clip, index)
    # 14 is on the way to itself alone
    assert _places(frames) == [15, 27, 38]
    assert len(opened) == 3


@pytest.mark.parametrize(("frames_worth", "places"), [(0.9, []), (1, [31]), (2.5, [22, 31])])
def test_large_pictures_have_fewer_decoders(
    frames_worth: float, places: list[int], clip: Path, frames: SingleFrames, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = 160 * 96 * 3 // 2
    monkeypatch.setattr(single_frames, "_KEPT_BYTES", int(frames_worth * single_frames._HELD * picture))
    for index in (31, 21, 22, 22):
        assert _at(frames, clip, index).index == index
    assert set(_places(frames)) <= {22, 31}
    assert len(_places(frames)) == len(places)


def test_a_clip_in_the_place_of_another_is_told_from_it(clip: Path, frames: SingleFrames, tmp_path: Path) -> None:
    path = tmp_path / "c.mp4"
    shutil.copy(clip, path)
    before = _all_of(_at(frames, path, 7))
    other = encode_raw(tmp_path / "other.mp4", _raw()[::-1], "libx264", g="10")
    os.replace(other, path)
    (expected,) = read_frames(path, start=7, stop=8)
    assert _all_of(_at(frames, path, 7)) == _all_of(expected) != before
    assert len(_places(frames)) == 1


def test_how_it_is_read_counts_too(clip: Path, frames: SingleFrames) -> None:
    _at(frames, clip, 3)
    assert frames.frame(clip, 3, limits=MediaLimits(max_pixels=1000)) is None
    seen = frames.frame(clip, 3, input_color="slog3")
    assert seen is not None
    assert seen.format.color is not None


def test_what_cannot_be_come_by_is_left_to_reading(tmp_path: Path, clip: Path, frames: SingleFrames) -> None:
    write_image(tmp_path / "p.png", colorful(2, (64, 48)))
    assert frames.frame(tmp_path / "p.png", 0) is None
    assert frames.frame(clip, _FRAMES) is None
    assert frames.frame(clip, -1) is None
    assert frames.frame(clip, 3, frame_count=_FRAMES + 1) is None
    assert frames.frame(encode_raw(tmp_path / "c.avi", _raw(), "mpeg4", bf="2"), 3) is None
    (tmp_path / "no.mp4").write_text("no clip at all")
    assert frames.frame(tmp_path / "no.mp4", 0) is None


def test_a_decoder_that_fails_is_given_up(clip: Path, frames: SingleFrames, monkeypatch: pytest.MonkeyPatch) -> None:
    _at(frames, clip, 3)

    def broken(self: OpenClip, packet: Any) -> Sequence[Any]:
        raise MediaError("damaged")

    with monkeypatch.context() as patched:
        patched.setattr(OpenClip, "decode", broken)
        assert frames.frame(clip, 8) is None
    assert _places(frames) == []
    assert _at(frames, clip, 8).index == 8


def test_frames_are_not_to_be_written_to(tmp_path: Path, frames: SingleFrames) -> None:
    """They are given again to whoever asks for the same."""
    turned = encode_raw(tmp_path / "c.mp4", _raw(), "libx264", degrees=90)
    for plane in _at(frames, turned, 4).planes:
        with pytest.raises(ValueError, match="read-only"):
            plane[:] = 0


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="tells the open files of a process")
def test_closing_leaves_no_file_open(clip: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(clip, tmp_path / "c.mp4")).resolve()

    def held() -> int:
        return sum(os.path.realpath(link) == str(path) for link in Path("/proc/self/fd").iterdir())

    frames = SingleFrames()
    _at(frames, path, 3)
    assert held() == 1
    frames.close()
    assert held() == 0
    assert _at(frames, path, 4).index == 4
    del frames
    assert held() == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_forked_process_opens_the_clip_for_itself(clip: Path) -> None:
    """A decoder's threads do not go along: who closed it, or went on with it, would wait for them for ever."""
    program = f"""
        import os
        from pathlib import Path
        from pvg.video import SingleFrames
        path, frames = Path({str(clip)!r}), SingleFrames()
        assert frames.frame(path, 5).index == 5
        pid = os.fork()
        assert frames.frame(path, 8).index == 8
        frames.close()
        if pid:
            assert os.waitpid(pid, 0)[1] == 0
    """
    subprocess.run([sys.executable, "-W", "ignore", "-c", textwrap.dedent(program)], check=True, timeout=60)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_what_is_collected_while_a_process_forks_may_close_its_clip() -> None:
    """As a `VectorVideo` does that nobody refers to any more but itself."""
    program = """
        import gc, os
        os.register_at_fork(before=gc.collect)  # comes after those that are registered later
        from pvg.video import SingleFrames

        class Owner:
            def __init__(self):
                self.frames, self.itself = SingleFrames(), self

            def __del__(self):
                self.frames.close()

        gc.disable()
        Owner()
        if pid := os.fork():
            assert os.waitpid(pid, 0)[1] == 0
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True, timeout=60)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_several_threads_may_fork_while_others_open_clips() -> None:
    program = """
        import os, sys, threading
        from pvg.video import SingleFrames
        wrong, kept, done = [], [SingleFrames() for _ in range(300)], threading.Event()
        sys.unraisablehook = lambda one: wrong.append(one.exc_value)
        sys.setswitchinterval(1e-6)

        def open_clips():
            while not done.is_set():
                [SingleFrames() for _ in range(50)]

        def fork():
            for _ in range(25):
                pid = os.fork()
                if not pid:
                    os._exit(not all(one._lock.acquire(timeout=1) for one in kept))
                if os.waitpid(pid, 0)[1]:
                    wrong.append("a lock that nobody has any more")

        others = [threading.Thread(target=open_clips) for _ in range(2)]
        threads = [threading.Thread(target=fork) for _ in range(2)]
        for thread in others + threads:
            thread.start()
        for thread in threads:
            thread.join()
        done.set()
        sys.exit(f"{len(wrong)}: {wrong[:3]}" if wrong else 0)
    """
    subprocess.run([sys.executable, "-W", "ignore", "-c", textwrap.dedent(program)], check=True, timeout=120)
