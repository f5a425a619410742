"""When a change of light makes a key frame: on drawn faces whose light is known."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import cv2
import numpy as np
import pytest

from pvg.picture import as_picture
from pvg.skin import SkinTracker, fit_skin_model
from pvg.vectorization.exposure import LOOKAHEAD, ExposureWatch, Sight
from pvg.vectorization.face_patch import FacePatch
from tests.gallery.scenes import Scene, drawn_face

Keys = list[tuple[int, int | None]]


def keys_of(scenes: Sequence[Scene], main_row: int = 0, unseen: Collection[int] = ()) -> Keys:
    """(row, since) of the key frames that a watch asks for, the main one among them; since None: from the beginning.

    unseen: rows in which the face is not seen well.
    """
    main = scenes[main_row]
    model = fit_skin_model(main.rgb, main.landmarks)
    matte = SkinTracker(model).step(main.rgb, main.landmarks)
    watch = ExposureWatch(main_row, FacePatch.of(as_picture(main.rgb), main.landmarks, matte))
    tracker, due = SkinTracker(model), []
    for row, scene in enumerate(scenes):
        matte, picture = tracker.step(scene.rgb, scene.landmarks), as_picture(scene.rgb)
        patch = None if row in unseen else FacePatch.of(picture, scene.landmarks, matte)
        due += watch.see(Sight(row, picture, scene.landmarks, matte, patch))
    due += watch.end()
    keys: Keys = [(key.sight.row, key.since) for key in due]
    return sorted([*keys, (main_row, watch.main_since)])


def lit(gains: Sequence[float] | np.ndarray) -> list[Scene]:
    """A small face, since what is proved does not hang on its size."""
    small = {"center": (80, 65), "width": 60, "size": (160, 160)}
    return [drawn_face(**small, gain=gain, seed=seed) for seed, gain in enumerate(gains)]  # type: ignore[arg-type]


def test_steady_light_with_noise_and_a_sway_of_exposure_makes_no_key() -> None:
    assert keys_of(lit([1 + 0.1 * np.sin(k / 4) for k in range(40)])) == [(0, None)]


def test_a_flash_makes_no_key() -> None:
    gains = np.ones(30)
    gains[10 : 10 + LOOKAHEAD // 2] = 0.5
    assert keys_of(lit(gains)) == [(0, None)]


def test_a_step_of_light_makes_a_key_at_the_step_that_goes_over_at_once() -> None:
    assert keys_of(lit([1.0] * 15 + [0.6] * 20)) == [(0, None), (15, 14)]


@pytest.mark.parametrize("gains", [np.linspace(0.4, 1.0, 60), np.linspace(1.0, 0.4, 60)], ids=["up", "down"])
def test_a_ramp_makes_keys_a_fifth_apart_and_one_at_its_end(gains: np.ndarray) -> None:
    keys = keys_of(lit(gains))
    rows = [row for row, _ in keys]
    assert rows[0] == 0
    assert rows[-1] == 59
    steps = np.exp(np.abs(np.diff(np.log(gains[rows]))))
    assert steps.max() < 1.3
    assert 4 <= len(keys) <= 7
    for (row, since), before in zip(keys[1:], rows, strict=False):
        assert since is not None
        assert before <= since <= before + 1  # light that runs on has colours that do: none wait, then hurry
        assert since < row


def test_a_main_key_behind_a_ramp_gets_keys_before_it() -> None:
    keys = keys_of(lit([0.5] * 12 + [1.0] * 20), main_row=14)
    assert keys == [(0, None), (12, 11), (14, 13)]


def test_what_covers_part_of_the_face_makes_no_key() -> None:
    scenes = lit([1.0] * 30)
    for scene in scenes[8:]:  # a hand of the skin's hue, but dimmer, over half of the face
        scene.rgb[:, 75:] = (scene.rgb[:, 75:] * 0.55).astype(np.uint8)
    assert keys_of(scenes) == [(0, None)]


def test_what_covers_the_whole_face_makes_no_key() -> None:
    scenes = lit([1.0] * 30)
    for scene in scenes[8:]:
        palm = np.full_like(scene.rgb, (120, 85, 65)) + cv2.resize(
            np.random.default_rng(3).integers(0, 40, (10, 10, 3), np.uint8), scene.rgb.shape[1::-1]
        )
        scene.rgb[scene.skin] = palm[scene.skin]
    assert keys_of(scenes) == [(0, None)]


def test_a_face_without_a_pattern_tells_no_gain() -> None:
    everywhere = np.ones((24, 24), np.bool_)
    pattern = 100.0 + np.random.default_rng(0).normal(0.0, 5.0, (24, 24)).astype(np.float32)
    hues = np.zeros((24, 24, 2), np.float32)
    flat = FacePatch(np.full((24, 24), 200.0, np.float32), hues, everywhere)
    assert np.isnan(flat.gain_over(FacePatch(pattern, hues, everywhere)))


def test_rows_that_do_not_show_the_face_well_make_no_key() -> None:
    scenes = lit([1.0] * 10 + [0.6] * 20)
    assert keys_of(scenes, unseen=range(8, 30)) == [(0, None)]


def test_flicker_cannot_make_keys_without_end() -> None:
    gains = [1.0 if k // 12 % 2 else 0.55 for k in range(144)]
    assert len(keys_of(lit(gains))) <= 8  # of 12 levels


def under(lamps: Sequence[Sequence[float]]) -> list[Scene]:
    """Faces in light of such R, G, B."""
    scenes = lit([1.0] * len(lamps))
    for scene, lamp in zip(scenes, lamps, strict=True):
        scene.rgb[:] = np.clip(scene.rgb * np.array(lamp), 0, 255).astype(np.uint8)
    return scenes


WHITE, RED, GREEN = (0.8, 0.8, 0.8), (1.0, 0.72, 0.72), (0.66, 0.9, 0.7)


def test_a_lamp_that_changes_its_colour_makes_a_key_at_once() -> None:
    """As bright as before."""
    assert keys_of(under([RED] * 15 + [GREEN] * 20)) == [(0, None), (15, 14)]
    assert keys_of(under([RED] * 12 + [GREEN] * 20), main_row=14) == [(0, None), (12, 11), (14, 13)]


def test_a_sway_and_a_flash_of_colour_make_no_key() -> None:
    sway = [(0.8 + 0.04 * np.sin(k / 4), 0.8, 0.8 - 0.04 * np.sin(k / 4)) for k in range(40)]
    assert keys_of(under(sway)) == [(0, None)]
    assert keys_of(under([WHITE] * 12 + [RED] * (LOOKAHEAD // 2) + [WHITE] * 14)) == [(0, None)]


def test_what_reddens_a_part_of_the_face_and_what_loses_its_colours_make_no_key() -> None:
    flushed = under([WHITE] * 30)
    for scene in flushed[10:]:
        scene.rgb[:, 75:] = (scene.rgb[:, 75:] * np.array((1.2, 0.7, 0.7))).clip(0, 255).astype(np.uint8)
    assert keys_of(flushed) == [(0, None)]
    fading = under([WHITE] * 30)
    for scene in fading[10:]:
        scene.rgb[:] = cv2.cvtColor(scene.rgb, cv2.COLOR_RGB2GRAY)[..., None]
    assert keys_of(fading) == [(0, None)]
