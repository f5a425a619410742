from __future__ import annotations

from dataclasses import replace

import pytest

from pvg.memory import frame_bytes, looks_at_once, rendering_bytes, vectorizing_bytes
from pvg.video import MediaInfo, PixelFormat, probe
from scripts.samples import Samples

BUDGET = 6 * 2**30
DEEP = PixelFormat("yuv444p10le", 10, (0, 0), (0.2627, 0.0593), False)

# MB of data at the peak, measured (see the module): what is said must not be less, nor more than a third above
MEASURED = [
    ((640, 360), 882, 494, None),
    ((1920, 1080), 1010, 828, 1171),
    ((3840, 2160), 1320, 1722, 2864),
    ((7680, 4320), None, 5239, None),  # of 24 frames: vectorising had not reached its peak
]


@pytest.fixture(scope="module")
def clip(samples: Samples) -> MediaInfo:
    return probe(samples.single_face_clip)


@pytest.mark.parametrize(("size", "vectorizing", "one", "three"), MEASURED)
def test_what_is_said_is_what_was_measured_and_up_to_a_third_more(
    clip: MediaInfo, size: tuple[int, int], vectorizing: int | None, one: int, three: int | None
) -> None:
    media = replace(clip, width=size[0], height=size[1])
    said = [vectorizing_bytes(media), rendering_bytes(media, 1), rendering_bytes(media, 3)]
    for figure, measured in zip(said, (vectorizing, one, three), strict=True):
        if measured is not None:
            assert measured * 1e6 <= figure <= measured * 4e6 / 3


def test_a_pass_draws_fewer_looks_of_larger_frames(clip: MediaInfo) -> None:
    sizes = [(1920, 1080), (3840, 2160), (5760, 2880), (7680, 4320)]
    at_once = [looks_at_once(replace(clip, width=w, height=h), BUDGET, most=3) for w, h in sizes]
    assert at_once == [3, 3, 3, 1]
    deep = replace(clip, width=7680, height=4320, format=DEEP)
    assert frame_bytes(deep) == 7680 * 4320 * 3 * 2
    assert looks_at_once(deep, BUDGET, most=3) == 1
    assert rendering_bytes(deep, 1) > BUDGET  # it is refused
