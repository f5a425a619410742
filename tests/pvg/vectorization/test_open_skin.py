from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import ArrayLike

import pvg
from pvg.face import layout
from pvg.rendering import source_frame
from pvg.vectorization.open_skin import SAMPLES, skin_sample
from scripts.samples import Samples


@pytest.fixture(scope="module")
def image(samples: Samples) -> Iterator[pvg.VectorVideo]:
    with pvg.vectorize(samples.dark_portrait) as vectorized:
        yield vectorized


def test_the_sample_is_the_faces_skin(image: pvg.VectorVideo) -> None:
    """It has the cheeks' colour, not that of lips, brows, hair or background."""
    data = image.face_at(0, 0)
    assert data is not None
    rgb = source_frame(image, 0).rgb()
    sample = image.records[0].key_frames[0].skin
    assert sample.shape == (SAMPLES, 3)
    for cheek in (layout.LEFT_CHEEK, layout.RIGHT_CHEEK):
        x, y = np.rint(data.landmarks.skin_points[cheek].mean(axis=0)).astype(int)
        around = rgb[y - 4 : y + 5, x - 4 : x + 5].reshape(-1, 3).mean(axis=0)
        assert np.linalg.norm(sample - around, axis=1).min() < 20
    lips = np.rint(data.landmarks.points[layout.LIPS_OUTER].mean(axis=0)).astype(int)
    assert np.linalg.norm(sample - rgb[lips[1], lips[0]].astype(float), axis=1).min() > 3


def lower_face_is_sampled(image: pvg.VectorVideo, upper: ArrayLike, lower: ArrayLike) -> bool:
    """Whether skin is taken from below the nose's tip, where a picture has these colours above and below it."""
    data = image.face_at(0, 0)
    assert data is not None
    picture = np.empty_like(source_frame(image, 0).rgb())
    ys, xs = np.indices(picture.shape[:2])
    at, down = data.landmarks.points[layout.NOSE_TIP], data.landmarks.axes.down
    picture[:] = upper
    picture[(xs - at[0]) * down[0] + (ys - at[1]) * down[1] > 0] = np.clip(lower, 0, 255)
    _, places = skin_sample(picture, np.ones(picture.shape[:2], np.float32), data.landmarks)
    return bool(((places - at) @ down > 0).any())


@pytest.mark.parametrize(
    ("gain", "left_out"), [(0.3, True), (0.62, True), (0.8, False), (1.15, False), (1.34, False)], ids=str
)
def test_a_beard_is_no_sample_and_shade_is_one(image: pvg.VectorVideo, gain: float, left_out: bool) -> None:
    skin = np.array((190, 140, 115))
    assert lower_face_is_sampled(image, skin, gain * skin) is not left_out


@pytest.mark.parametrize("light", [1.3, 1.0, 0.7, 0.4])
@pytest.mark.parametrize(("gain", "left_out"), [(0.6, True), (0.8, False)], ids=["beard", "shade"])
def test_a_beard_is_one_and_shade_is_none_in_any_light(
    image: pvg.VectorVideo, light: float, gain: float, left_out: bool
) -> None:
    """Else a clip's open skin would change with its light, and its exposure be taken for another one."""
    skin = light * np.array((190, 140, 115))
    assert lower_face_is_sampled(image, skin, gain * skin) is not left_out


@pytest.mark.parametrize("shade", [0.7, 0.4, 0.2])
def test_what_the_sun_lights_below_a_hat_is_sampled_and_a_bright_veil_is_not(
    image: pvg.VectorVideo, shade: float
) -> None:
    skin = np.array((230, 180, 150))
    for color, sampled in ((skin, True), ((240, 238, 245), False), ((150, 190, 230), False)):
        assert lower_face_is_sampled(image, shade * skin, color) is sampled


@pytest.mark.parametrize("color", [(200, 20, 30), (120, 190, 220), (20, 20, 22), (240, 240, 245)], ids=str)
@pytest.mark.parametrize("above", [0.0, 0.2], ids=["over the nose", "up to the eyes"])
def test_a_mask_is_no_skin(image: pvg.VectorVideo, color: tuple[int, int, int], above: float) -> None:
    data = image.face_at(0, 0)
    assert data is not None
    rgb = source_frame(image, 0).rgb().copy()
    axes, tip = data.landmarks.axes, data.landmarks.points[layout.NOSE_TIP]
    ys, xs = np.indices(rgb.shape[:2])
    places = np.stack([xs, ys], axis=-1) - tip
    covered = (places @ axes.down > -above * axes.width) & (np.abs(places @ axes.across) < 0.45 * axes.width)
    plain, _ = skin_sample(rgb, np.ones(rgb.shape[:2], np.float32), data.landmarks)
    rgb[covered] = color
    sample, _ = skin_sample(rgb, np.ones(rgb.shape[:2], np.float32), data.landmarks)
    assert np.linalg.norm(sample - np.array(color), axis=1).min() > 20
    ours, theirs = (np.median(colors, axis=0) / colors.sum(axis=1).mean() for colors in (sample, plain))
    assert np.abs(ours - theirs).max() < 0.05


def test_red_cheeks_are_skin(image: pvg.VectorVideo) -> None:
    data = image.face_at(0, 0)
    assert data is not None
    rgb = np.full((*source_frame(image, 0).rgb().shape[:2], 3), (190, 140, 115), np.uint8)
    for cheek in (layout.LEFT_CHEEK, layout.RIGHT_CHEEK):
        middle = data.landmarks.skin_points[cheek].mean(axis=0)
        near = np.hypot(*(np.indices(rgb.shape[:2])[::-1] - middle[:, None, None])) < 0.12 * data.landmarks.axes.width
        rgb[near] = (200, 120, 105)
    sample, _ = skin_sample(rgb, np.ones(rgb.shape[:2], np.float32), data.landmarks)
    assert (np.linalg.norm(sample - np.array((200, 120, 105)), axis=1) < 10).any()


def test_without_enough_skin_there_is_no_sample(image: pvg.VectorVideo) -> None:
    data = image.face_at(0, 0)
    assert data is not None
    rgb = source_frame(image, 0).rgb()
    nothing = np.zeros(rgb.shape[:2], np.float32)
    assert [part.shape for part in skin_sample(rgb, nothing, data.landmarks)] == [(0, 3), (0, 2)]


@pytest.mark.parametrize("lit", ["left", "right"])
def test_a_face_lit_from_one_side_is_sampled_on_both(image: pvg.VectorVideo, lit: str) -> None:
    """Whatever the number of pixels: equal steps through them would fall on one side for some sizes of faces."""
    data = image.face_at(0, 0)
    assert data is not None
    rgb = source_frame(image, 0).rgb()
    ys, xs = np.indices(rgb.shape[:2])
    axes = data.landmarks.axes
    across = (xs - axes.center[0]) * axes.across[0] + (ys - axes.center[1]) * axes.across[1]
    bright = across > 0 if lit == "right" else across < 0
    shares = []
    for cut in range(0, 60):  # the matte a row shorter each time
        matte = np.ones(rgb.shape[:2], np.float32)
        matte[int(axes.center[1] + 0.2 * axes.width) + cut :] = 0
        _, places = skin_sample(rgb, matte, data.landmarks)
        columns, rows = np.rint(places).astype(int).T
        shares.append(float(bright[rows, columns].mean()))
    assert np.ptp(shares) < 0.04
    assert 0.4 < np.mean(shares) < 0.6
