"""Profiles of pictures, against the tristimulus values they are defined by."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.video import color_space
from pvg.video.icc import profile_space
from tests.gallery.profiles import ADOBE, P3, SRGB, gamma_curve, profile, srgb_curve, table_curve


@pytest.mark.parametrize("curve", [srgb_curve(), table_curve(2.2)], ids=["parametric", "table"])
def test_srgb_is_taken_as_it_is(curve: bytes) -> None:
    if curve[:4] == b"para":
        assert profile_space(profile(SRGB, curve)) is None
    else:  # a plain power is not quite sRGB
        assert profile_space(profile(SRGB, curve)) is not None


def test_display_p3_is_p3() -> None:
    space, tagged = profile_space(profile(P3, srgb_curve())), color_space(12, 13)
    assert space is not None
    assert tagged is not None
    colors = np.random.default_rng(1).uniform(0, 255, (200, 3))
    np.testing.assert_allclose(space.to_sdr(colors), tagged.to_sdr(colors), atol=1.0)


def test_adobe_rgb_green_is_greener_than_srgb_can_be() -> None:
    space = profile_space(profile(ADOBE, gamma_curve(563 / 256)))
    assert space is not None
    # skin of AdobeRGB values looks paler when they are taken for sRGB
    skin = np.array([[180.0, 130.0, 110.0]])
    shown = space.to_sdr(skin)[0]
    assert shown[0] - shown[1] > 1.2 * (180 - 130)
    np.testing.assert_allclose(space.from_sdr(shown[None]), skin, atol=0.1)


@pytest.mark.parametrize(
    ("damaged", "says"),
    [
        (profile(P3, srgb_curve(), kind=b"CMYK"), "one of CMYK"),
        (profile(P3, srgb_curve(), pcs=b"Lab "), "one of tables"),
        (profile(P3, b"sngl" + bytes(12)), "a kind that is not read"),
        (profile(((0, 0, 0),) * 3, srgb_curve()), "damaged"),
        (profile(P3, srgb_curve())[:180], "damaged"),
        (b"", "damaged"),
        (profile(P3, srgb_curve()).replace(b"gTRC", b"oops"), "has no gTRC"),
    ],
)
def test_other_profiles_are_refused_in_words(damaged: bytes, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        profile_space(damaged)


@given(st.binary(max_size=300), st.integers(0, 380), st.integers(0, 255))
def test_damage_is_never_worse_than_a_refusal(noise: bytes, at: int, value: int) -> None:
    whole = bytearray(profile(P3, table_curve(2.2, 20)))
    whole[min(at, len(whole) - 1)] = value
    for data in (bytes(whole), bytes(whole[:at]) + noise):
        try:
            space = profile_space(data)
        except ValueError:
            continue
        assert space is None or np.isfinite(space.to_sdr(np.full((1, 3), 128.0))).all()


@pytest.mark.parametrize("name", [b"desc", b"rTRC"])
def test_tags_that_each_claim_the_whole_profile_are_not_copied_out(name: bytes) -> None:
    size = 8 * 2**20
    tags = struct.pack(">I", 200) + struct.pack(">4sII", name, 0, size) * 200
    data = profile(P3, srgb_curve())[:128] + tags + bytes(size)
    tracemalloc.start()
    with pytest.raises(ValueError, match="has no"):
        profile_space(data)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**20


def test_few_profiles_are_kept() -> None:
    kept = profile_space.cache_info().maxsize
    assert kept is not None
    assert kept * 16 * 2**20 <= 2**25  # of the largest that are read
