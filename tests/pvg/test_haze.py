from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.quality.labels import LABELS, read_label
from pvg.haze import cleared, haze_of, through_haze, without_haze
from pvg.picture import as_picture
from pvg.skin import Scene, SceneReader, haze_over
from tests.gallery.faces import read_rgb

CLEAR, BLACK, STEADY = 36, 10, 6  # levels


def _picture() -> np.ndarray:
    """(90, 160, 3) of all colours, black among them."""
    picture = np.random.default_rng(3).integers(0, 256, (90, 160, 3)).astype(np.uint8)
    picture[40:50, 40:60] = 0
    return picture


def _hazy(picture: np.ndarray, haze: float) -> np.ndarray:
    return np.rint(picture * (1 - haze / 255) + haze).astype(np.uint8)


@pytest.mark.parametrize("haze", [0, 10, CLEAR])
def test_a_picture_is_clear_though_its_black_is_a_dark_grey(haze: int) -> None:
    assert haze_of(_hazy(_picture(), haze)) == 0


@pytest.mark.parametrize("haze", [70, 90, 130])
def test_what_is_surely_haze_is_told_whole(haze: int) -> None:
    assert haze_of(_hazy(_picture(), haze)) == pytest.approx(haze - BLACK, abs=1)


def test_haze_begins_without_a_jump() -> None:
    told = [haze_of(_hazy(_picture(), haze)) for haze in range(CLEAR, 100)]
    assert max(np.diff(told)) <= 3
    assert min(np.diff(told)) >= 0


def test_without_its_haze_a_picture_is_what_it_was_and_white_is_white() -> None:
    picture = _picture()
    hazy = _hazy(picture, 80)
    assert np.abs(without_haze(hazy, 80).astype(int) - picture).max() <= 2
    assert (without_haze(np.full((1, 1, 3), 255, np.uint8), 80) == 255).all()
    assert without_haze(hazy, 0) is hazy


def test_black_bars_do_not_hide_haze() -> None:
    hazy = _hazy(_picture(), 90)
    barred = np.full((130, 200, 3), 4, np.uint8)
    barred[20:110, 20:180] = hazy
    assert haze_of(barred) == haze_of(hazy) > 0
    assert haze_of(np.zeros((20, 30, 3), np.uint8)) == 0


@pytest.mark.parametrize("rows", [139, 277])
def test_bars_that_end_within_a_cell_do_not_hide_haze(rows: int) -> None:
    """Cells of a bar's black and of the picture are darker than any haze: there are more than a thousandth of them."""
    hazy = cv2.resize(_hazy(_picture(), 90), (1280, 720), interpolation=cv2.INTER_NEAREST)
    letterbox, pillars = (np.full((720, 1280, 3), 4, np.uint8) for _ in range(2))
    letterbox[rows:-rows], pillars[:, rows:-rows] = hazy[rows:-rows], hazy[:, rows:-rows]
    told = _scene(hazy).haze
    assert told == pytest.approx(90 - BLACK, abs=1)
    assert (_scene(letterbox).haze, _scene(pillars).haze) == (told, told)


def test_a_picture_that_is_narrower_than_the_edges_of_its_bars_is_looked_at() -> None:
    barred = np.full((40, 60, 3), 4, np.uint8)
    barred[:, 29:32] = 100
    assert haze_of(barred) == 90


def test_the_first_scene_has_the_haze_that_a_single_picture_has() -> None:
    """Then a picture is the same as a clip's and as a reference, and its own colours return it."""
    for haze in range(CLEAR, CLEAR + STEADY):
        picture = _hazy(_picture(), haze)
        assert _scene(picture).haze == haze_over(as_picture(picture))


def test_haze_of_a_clip_does_not_tremble() -> None:
    """A few levels more or less are noise: they would let every cell of the picture change."""
    reader, clear = SceneReader(), _picture()
    hazes = [reader.step(_hazy(clear, haze)).haze for haze in (90, 91, 88, 90 + STEADY, 90 + 2 * STEADY)]
    assert hazes[:4] == [hazes[0]] * 4
    assert hazes[4] > hazes[0] > 0
    assert reader.step(_hazy(clear, 20)).haze == 0


def _scene(rgb: np.ndarray) -> Scene:
    return SceneReader().step(rgb)


def test_a_scene_shows_the_picture_without_haze_and_tells_of_it_as_it_is() -> None:
    clear, hazy = _scene(_picture()), _scene(_hazy(_picture(), 100))
    assert hazy.haze > 0
    assert clear.haze == 0
    assert hazy.contrast < 0.8 * clear.contrast
    assert hazy.rgb.std() > 0.9 * clear.rgb.std()  # 0.6 as it is


def test_real_pictures_are_clear(media_dir: Path) -> None:
    names = [*sorted((media_dir / "portraits").glob("*.jpg"))]
    assert len(names) > 10
    assert [path.stem for path in names if _scene(read_rgb(path)).haze > 0] == []
    frames = [read_label(path) for path in sorted(LABELS.glob("*--*.json"))]
    assert [one for one in frames if _scene(one.picture(media_dir)).haze > 0] == []


@pytest.mark.parametrize("haze", [0, 30, 110])
def test_colours_come_back_from_under_haze(haze: int) -> None:
    colors = _picture().reshape(-1, 3).astype(np.float32)
    hazy = through_haze(colors, haze)
    np.testing.assert_allclose(hazy, colors * (1 - haze / 255) + haze, atol=1e-3)
    np.testing.assert_allclose(cleared(hazy, haze), colors, atol=1e-3)
    assert hazy.dtype == np.float32
