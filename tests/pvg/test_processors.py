"""Encoders and decoders have no more threads than this process may use processors, nor than there is memory for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

import pvg
from pvg import _processors
from pvg._processors import MOST, decoding_threads, processors, usable_processors
from pvg.memory import rendering_bytes
from pvg.rendering import clip as rendering
from pvg.video import MediaLimits, VideoWriter, probe, read_frames
from pvg.video.encoders import encoder_threads
from pvg.video.opening import open_clip
from scripts.samples import Samples


def machine_of(count: int, monkeypatch: pytest.MonkeyPatch, *, usable: int | None = None) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(usable or count)))


@pytest.fixture
def large_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    machine_of(64, monkeypatch)


@pytest.mark.parametrize(
    ("limits", "granted"),
    [
        ({}, 64),
        ({"": "max 100000"}, 64),
        ({"": "400000 100000"}, 4),
        ({"": "150000 100000"}, 2),
        ({"a/b": "max 100000", "a": "50000 100000"}, 1),
        ({"a/b": "300000 100000", "a": "600000 100000"}, 3),
        ({"": "3200000 100000"}, 32),
        ({"": "9600000 100000"}, 64),
    ],
)
@pytest.mark.usefixtures("large_machine")
def test_the_quota_is_the_least_of_all_groups(limits: dict[str, str], granted: int, tmp_path: Path) -> None:
    own, root = tmp_path / "own", tmp_path / "cgroup"
    own.write_text("3:cpuset:/x\n0::/a/b\n")
    for name, text in limits.items():
        (root / name).mkdir(parents=True, exist_ok=True)
        (root / name / "cpu.max").write_text(f"{text}\n")
    (tmp_path / "cpu.max").write_text("100000 100000\n")  # outside
    assert _processors._quota(root, own) == granted
    assert _processors._quota(root, tmp_path / "none") == 64


def test_what_may_be_used_is_the_least_of_affinity_quota_and_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_processors, "_quota", lambda _: 64)
    machine_of(64, monkeypatch)
    assert (usable_processors(), processors()) == (64, MOST)
    machine_of(64, monkeypatch, usable=3)
    assert (usable_processors(), processors()) == (3, 3)
    monkeypatch.setattr(_processors, "_quota", lambda _: 1)
    assert (usable_processors(), processors()) == (1, 1)


@pytest.mark.parametrize("count", [1, 2])
def test_on_a_small_machine_libraries_choose_by_themselves(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    machine_of(count, monkeypatch)
    assert decoding_threads() == 0
    for codec in ("h264", "hevc", "vp9", "av1", "prores"):
        assert encoder_threads(codec, 0) == (0, {})
        assert encoder_threads(codec, 1) == (1, {})


@pytest.mark.usefixtures("large_machine")
@pytest.mark.parametrize(
    ("codec", "all_of_them", "two"),
    [
        ("h264", (8, {}), (2, {})),
        ("hevc", (3, {"x265-params": "pools=8"}), (1, {"x265-params": "pools=2"})),
        ("av1", (8, {"svtav1-params": "lp=4"}), (2, {"svtav1-params": "lp=2"})),
        ("vp9", (8, {}), (2, {})),
    ],
)
def test_on_a_large_machine_encoders_are_told_how_many(codec: str, all_of_them: Any, two: Any) -> None:
    assert encoder_threads(codec, 0) == all_of_them
    assert encoder_threads(codec, 2) == two


@pytest.mark.usefixtures("large_machine")
@pytest.mark.parametrize(
    ("name", "codec", "threads"),
    [("a.mp4", "h264", 8), ("a.mp4", "hevc", 3), ("a.mp4", "av1", 8), ("a.webm", "vp9", 8)],
)
def test_a_clip_is_coded_and_read_with_so_many_threads(
    name: str, codec: str, threads: int, samples: Samples, tmp_path: Path
) -> None:
    info = probe(samples.woman_clip)
    with VideoWriter(tmp_path / name, info, info.format, codec=codec) as writer:
        for frame in read_frames(samples.woman_clip, stop=3):
            writer.write(frame)
        assert writer._encoder._context.thread_count == threads
    with open_clip(tmp_path / name, MediaLimits()) as opened:
        assert opened.context.thread_count == 3
    assert len(list(read_frames(tmp_path / name))) == 3


@pytest.mark.usefixtures("large_machine")
def test_a_pass_has_as_many_threads_as_there_is_memory_for(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    look, seen, writer_of = pvg.transfer(video, dark_reference), list[int](), rendering.writer_of

    def noted(*given: Any) -> Any:
        seen.append(given[-1])
        return writer_of(*given)

    monkeypatch.setattr(rendering, "writer_of", noted)
    media = probe(video.require_source())
    needed = [rendering_bytes(media, 1, "h264", count) for count in (2, 5, 8)]
    assert needed == sorted(set(needed))
    for budget in (*needed, 1):
        pvg.render(video, [look], [tmp_path / "out.mp4"], memory_bytes=budget)
    pvg.render(video, [look] * 2, [tmp_path / "a.mp4", tmp_path / "b.mp4"])
    assert seen == [2, 5, 0, 2, 4, 4]
