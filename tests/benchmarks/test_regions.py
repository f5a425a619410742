from __future__ import annotations

import numpy as np
import pytest

from benchmarks.quality.regions import LabelledFace, RegionChange, measure_regions


def masks() -> LabelledFace:
    """A face with an ear on its left, hair above, and wall around."""
    names = ("face", "ear", "hair", "background", "glow")
    out = {name: np.zeros((60, 60), np.bool_) for name in names}
    out["face"][20:40, 20:40], out["ear"][20:40, 10:20] = True, True
    out["hair"][5:20, 20:40], out["background"][45:, :] = True, True
    out["glow"][42:45, 20:40] = True
    named = {name: mask for name, mask in out.items() if name != "glow"}
    return LabelledFace(named, out["face"], out["face"] | out["ear"], out["glow"], out["glow"])


def changed(parts: dict[str, tuple[float, float, float]]) -> RegionChange | None:
    """The measures when each region changes by a CIELAB difference."""
    where = masks()
    before = np.full((60, 60, 3), (60, 10, 15), np.float32)
    after = before.copy()
    for name, change in parts.items():
        after[where.glow if name == "glow" else where.masks[name]] += np.float32(change)
    return measure_regions(where, before, after)


def test_what_follows_the_face_counts_and_what_does_not_is_left() -> None:
    found = changed({"face": (-20, 0, 0), "ear": (-11, 0, 0), "hair": (-5, 0, 0)})
    assert found is not None
    assert found.change == pytest.approx(20)
    assert found.shares == {"face": 1, "ear": 1, "hair": 1, "background": 0}


def test_skin_needs_half_of_the_change_and_hair_a_fifth_of_it_in_its_direction() -> None:
    found = changed({"face": (-20, 0, 0), "ear": (-9, 0, 0), "hair": (-3, 0, 0), "background": (0, 30, 0)})
    assert found is not None
    assert found.shares == {"face": 1, "ear": 0, "hair": 0, "background": 0}


def test_one_person_is_the_difference_to_the_colour_moved_as_the_face() -> None:
    same = changed({"face": (-20, 0, 0), "ear": (-20, 0, 0)})
    apart = changed({"face": (-20, 0, 0)})
    assert same is not None
    assert apart is not None
    assert "neck" not in same.delta_e
    assert same.delta_e["ear"] == pytest.approx(0, abs=1e-4)
    assert apart.delta_e["ear"] > 10


def test_the_glow_is_the_change_around_skin_over_that_of_skin() -> None:
    found = changed({"face": (-20, 0, 0), "ear": (-20, 0, 0), "glow": (-1, 0, 0)})
    assert found is not None
    assert found.glow == found.wall == pytest.approx(0.05)


def test_a_face_that_stays_as_it_is_has_no_shares() -> None:
    assert changed({"face": (1, 0, 0)}) is None
