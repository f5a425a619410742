"""Hair over the forehead, and the shade of a brim."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.quality.measures import iou
from pvg.face import layout
from pvg.skin import SkinTracker, fit_skin_model, skin_mask
from pvg.skin.hair import Hair, _hair_fraction
from tests.gallery.scenes import Scene, drawn_face, mask_of


def _with_hair(scene: Scene, hair: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The drawn face with hair around the head and a half-see-through fringe; and where the fringe is on the face."""
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    oval = scene.landmarks.oval
    top, middle = oval[:, 1].min(), oval[:, 0].mean()
    brow = scene.landmarks.points[layout.UPPER_BROW_EDGES, 1].min()
    head = np.hypot((xs - middle) / 100, (ys - oval[:, 1].mean()) / 120) < 1
    around = head & (scene.skin == 0) & (ys < brow + 15)
    fringe = scene.skin & (ys < top + 0.6 * (brow - top)) & (xs < middle + 15)
    cover = np.where(around, 1.0, np.where(fringe, 0.6 + 0.15 * np.sin(xs), 0.0))
    cover = cv2.GaussianBlur(cover, (0, 0), 0.7)[..., None]
    strands = np.array(hair) * (1 + 0.08 * np.sin(xs * 1.7))[..., None]
    return np.clip(scene.rgb * (1 - cover) + strands * cover, 0, 255).astype(np.uint8), fringe


@pytest.mark.parametrize("hair", [(45, 33, 26), (190, 162, 105)], ids=["dark", "fair"])
def test_a_fringe_is_left_out_of_the_still_and_of_the_matte(hair: tuple[float, float, float]) -> None:
    scene = drawn_face(width=120, tone="pale" if hair[0] < 100 else "tan")
    rgb, fringe = _with_hair(scene, hair)
    bare = scene.skin & ~fringe
    still = skin_mask(rgb, scene.landmarks)
    model = fit_skin_model(rgb, scene.landmarks)
    matte = SkinTracker(model).step(rgb, scene.landmarks)
    for mask in (still, mask_of(matte, rgb.shape)):
        assert mask[fringe].mean() < 0.1
        assert iou(mask, bare) > 0.95
    assert fringe.sum() > 400


@pytest.mark.parametrize(("fringe", "above"), [((118, 82, 66), (90, 80, 74)), ((130, 96, 80), (101, 86, 77))])
def test_a_fringe_that_goes_over_softly_into_the_forehead_is_not_its_own_proof(
    fringe: tuple[int, ...], above: tuple[int, ...]
) -> None:
    """Once taken for skin it was the skin nearby by which hair is told, and stayed so."""
    scene = drawn_face(width=150, center=(160, 170), tone=((216, 151, 130), (60, 110, 220)))
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    oval, brow = scene.landmarks.oval, scene.landmarks.points[layout.UPPER_BROW_EDGES, 1].min()
    middle = oval[:, 0].mean()
    head = np.hypot((xs - middle) / 125, (ys - oval[:, 1].mean()) / 150) < 1
    fallen = scene.skin & (ys < brow - 2) & (xs < middle - 5 + (brow - ys) * 0.8)
    rgb = scene.rgb.astype(np.float32)
    rgb[head & ~scene.skin & (ys < brow + 15)] = above
    cover = cv2.GaussianBlur(fallen.astype(np.float32), (0, 0), 6) * scene.skin
    strands = np.array(fringe) * (1 + 0.1 * np.sin(xs * 0.9))[..., None]
    rgb = rgb * (1 - cover[..., None]) + strands * cover[..., None]
    mask = skin_mask(np.clip(rgb, 0, 255).astype(np.uint8), scene.landmarks)
    hair = fallen & (cover > 0.8)
    assert hair.sum() > 500
    assert mask[hair].mean() < 0.1


def test_the_deep_shade_of_a_brim_is_skin() -> None:
    scene = drawn_face(width=150)
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    oval, brow = scene.landmarks.oval, scene.landmarks.points[layout.UPPER_BROW_EDGES, 1].min()
    hat = np.hypot((xs - oval[:, 0].mean()) / 135, (ys - oval[:, 1].mean()) / 170) < 1
    shade = scene.skin & (ys < brow - 4)
    rgb = np.where(shade[..., None], scene.rgb * 0.1, scene.rgb).astype(np.uint8)
    rgb[hat & ~scene.skin & (ys < brow - 4)] = (45, 60, 150)
    mask = skin_mask(rgb, scene.landmarks)
    assert shade.sum() > 500
    assert mask[shade].mean() > 0.9
    assert iou(mask, scene.skin) > 0.95


@given(st.floats(0, 1), st.booleans())
@settings(deadline=None, max_examples=30)
def test_a_mixture_of_skin_and_hair_tells_its_fraction(t: float, fair: bool) -> None:
    skin, dark = np.array([200.0, 160.0, 140.0], np.float32), np.array([40.0, 30.0, 25.0], np.float32)
    color = ((1 - t) * skin + t * dark)[None, None].astype(np.float32)
    hair = Hair(fair, dark, np.eye(3, dtype=np.float32) / 100)
    np.testing.assert_allclose(_hair_fraction(color, skin[None, None], hair), t, atol=1e-4)


def test_a_colour_off_the_line_from_skin_to_hair_is_no_mixture() -> None:
    skin, dark = np.array([200.0, 160.0, 140.0], np.float32), np.array([40.0, 30.0, 25.0], np.float32)
    blue = np.array([[[40.0, 90.0, 220.0]]], np.float32)
    hair = Hair(False, dark, np.eye(3, dtype=np.float32) / 100)
    assert _hair_fraction(blue, skin[None, None], hair).item() < 0.05
