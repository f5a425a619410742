"""Cubes: the map of a skin as a table, and its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pvg.haze import through_haze
from pvg.looks import SkinMap, look_cube, write_cube
from pvg.video import ColorSpace, color_space, named_space
from tests.gallery.cubes import apply_cube, read_cube


def a_map() -> SkinMap:
    rng = np.random.default_rng(0)
    skin = rng.normal((190, 140, 120), (16, 14, 12), (500, 3)).astype(np.float32)
    return SkinMap.between(skin, skin.astype(np.float64) * (0.6, 0.55, 0.5))


def skin_colors() -> np.ndarray:
    return np.random.default_rng(1).normal((190, 140, 120), (14, 12, 10), (300, 3))


@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0])
def test_a_cube_is_the_map(strength: float) -> None:
    skin, colors = a_map(), skin_colors()
    wanted = colors + strength * (skin(colors.astype(np.float32)) - colors)
    np.testing.assert_allclose(apply_cube(look_cube(skin, strength, None), colors), wanted, atol=1.0)


def test_a_cube_of_an_hdr_clip_works_on_its_own_values() -> None:
    space, skin, colors = color_space(9, 16), a_map(), skin_colors()
    assert space is not None
    table = look_cube(skin, 1.0, space)
    drawn = space.to_sdr(apply_cube(table, space.from_sdr(colors)))
    error = np.abs(drawn - skin(colors.astype(np.float32)))  # nodes of PQ lie wider apart in SDR
    assert error.mean() < 0.3
    assert error.max() < 4.0


@pytest.mark.parametrize(
    "space", [color_space(9, 16), color_space(9, 18), named_space("slog3")], ids=["pq", "hlg", "slog3"]
)
def test_what_shines_brighter_than_white_stays_as_bright(space: ColorSpace) -> None:
    greys = np.repeat(np.linspace(0.0, 255.0, 33)[:, None], 3, axis=1)
    shining = greys[space.to_sdr(greys)[:, 1] > 255.0]
    assert len(shining) > 3
    # the map takes a little of white, too
    np.testing.assert_allclose(apply_cube(look_cube(a_map(), 1.0, space), shining), shining, atol=4.0)


def test_a_file_holds_the_table(tmp_path: Path) -> None:
    table = look_cube(a_map(), 1.0, None, size=5)
    write_cube(tmp_path / "look.cube", table, 'a "look"')
    lines = (tmp_path / "look.cube").read_text().splitlines()
    assert lines[:2] == ['TITLE "a look"', "LUT_3D_SIZE 5"]
    assert len(lines) == 4 + 125
    np.testing.assert_allclose(read_cube(tmp_path / "look.cube"), table, atol=1e-6)
    # red runs fastest
    np.testing.assert_allclose([float(v) for v in lines[5].split()], table[0, 0, 1], atol=1e-6)


def test_a_cube_has_at_least_two_nodes_a_side() -> None:
    with pytest.raises(ValueError, match="2 to 256"):
        look_cube(a_map(), 1.0, None, size=1)


@pytest.mark.parametrize("space", [None, color_space(9, 18)], ids=["sdr", "hlg"])
def test_a_cube_of_a_hazy_clip_leaves_its_haze(space: ColorSpace | None) -> None:
    skin, colors, haze = a_map(), skin_colors(), 70
    own = through_haze(colors, haze)
    table = look_cube(skin, 1.0, space, haze=haze)
    drawn = apply_cube(table, own) if space is None else space.to_sdr(apply_cube(table, space.from_sdr(own)))
    error = np.abs(drawn - through_haze(np.asarray(skin(colors.astype(np.float32)), np.float64), haze))
    assert error.mean() < 0.5
    assert error.max() < 4.0


@pytest.mark.parametrize("space", [None, color_space(9, 18)], ids=["sdr", "hlg"])
def test_a_cube_without_strength_leaves_what_is_darker_than_haze_as_it_is(space: ColorSpace | None) -> None:
    """Black bars, and what a hazy picture has of black, ended at the haze's grey."""
    clear = look_cube(a_map(), 0.0, space, 9)
    np.testing.assert_allclose(look_cube(a_map(), 0.0, space, 9, haze=70), clear, atol=1e-5)
