from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pvg.video import VideoWriter, probe, read_frames
from pvg.video.encoders import ENCODERS
from pvg.video.scheduling import kept_scheduling
from scripts.samples import Samples

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="scheduling classes are Linux's")


def classes() -> set[int]:
    """Those of all threads of this process."""
    return {os.sched_getscheduler(int(thread)) for thread in os.listdir("/proc/self/task")}


@pytest.mark.parametrize("codec", sorted(set(ENCODERS) - {"raw"}))
def test_no_encoder_goes_before_everything_else_on_the_machine(codec: str, samples: Samples, tmp_path: Path) -> None:
    """SVT-AV1 would, for root: all that the process starts from then on would share time with nobody."""
    assert classes() == {os.SCHED_OTHER}
    info = probe(samples.woman_clip)
    path = tmp_path / ("out.mov" if codec == "dnxhr" else "out.mkv")
    with VideoWriter(path, info, info.format, codec=codec) as writer:
        for frame in read_frames(samples.woman_clip, start=0, stop=3):
            writer.write(frame)
            assert classes() == {os.SCHED_OTHER}
    assert classes() == {os.SCHED_OTHER}


@pytest.fixture
def waiting() -> Iterator[threading.Thread]:
    """A thread that only waits."""
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    yield thread
    over.set()
    thread.join()


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="a class of Linux's")
def test_what_was_in_another_class_before_stays_there(waiting: threading.Thread) -> None:
    assert waiting.native_id is not None
    os.sched_setscheduler(waiting.native_id, os.SCHED_BATCH, os.sched_param(0))
    with kept_scheduling():
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # what an encoder does, with a class for everybody
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert os.sched_getscheduler(waiting.native_id) == os.SCHED_BATCH
