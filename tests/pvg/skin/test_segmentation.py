"""The skin mask of one picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.quality.measures import iou
from pvg.face import layout
from pvg.skin import SkinTracker, fit_skin_model, skin_mask
from pvg.skin.prior import face_box
from pvg.skin.segmentation import red_chroma_mask
from tests.gallery.scenes import TONES, Scene, drawn_face, mask_of, with_forehead


@pytest.mark.parametrize("tone", TONES)
def test_the_skin_of_a_drawn_face_is_found(tone: str) -> None:
    scene = drawn_face(tone=tone)
    mask = skin_mask(scene.rgb, scene.landmarks)
    assert iou(mask, scene.skin) > 0.96
    col, row = np.rint(np.delete(scene.landmarks.points, layout.CONTOUR, axis=0)).astype(int).T
    assert mask[row, col].all()  # eyes, brows, nose and mouth are inside, filled


@pytest.mark.parametrize(("taller", "paler"), [(2.2, (0.06, 0.1, 0.14)), (1.8, (0.1, 0.16, 0.2))])
def test_a_receding_hair_line_leaves_a_high_forehead_skin(taller: float, paler: tuple[float, ...]) -> None:
    """It is seldom of the cheeks' own colour: learned as surroundings, 56 and 66 % of what is added were found."""
    scene = drawn_face(width=130, center=(160, 160), tone=((205, 150, 125), (170, 150, 140)))
    rgb, skin = with_forehead(scene, taller)
    brow = float(scene.landmarks.points[layout.LEFT_BROW, 1].min())
    above = np.clip((brow - np.arange(len(rgb)))[:, None] / 40, 0, 1) * skin
    above = cv2.GaussianBlur(above.astype(np.float32), (0, 0), 2)[..., None]
    mask = skin_mask(np.clip(rgb * (1 + above * np.array(paler)), 0, 255).astype(np.uint8), scene.landmarks)
    assert mask[skin & ~scene.skin].mean() > 0.9
    assert iou(mask, skin) > 0.99


def test_a_bald_head_is_skin_up_to_its_crown() -> None:
    scene = drawn_face(width=100, center=(160, 200))
    rgb, skin = with_forehead(scene, 3.8)
    above = skin & (np.arange(len(rgb))[:, None] < face_box(scene.landmarks)[1])
    assert above.sum() > 800  # beyond the box of a face with hair
    matte = SkinTracker(fit_skin_model(rgb, scene.landmarks)).step(rgb, scene.landmarks)
    for mask in (skin_mask(rgb, scene.landmarks), mask_of(matte, rgb.shape)):
        assert mask[above].mean() > 0.85
        assert iou(mask, skin) > 0.96


def _in_its_own_light(
    scene: Scene, neck: tuple[int, ...], clothes: tuple[int, ...], ends: float
) -> tuple[np.ndarray, np.ndarray]:
    """A drawn face with a neck of another colour, which goes over into it below the chin; and where clothes are."""
    rgb, chin = scene.rgb.astype(np.float32), scene.landmarks.points[layout.CHIN]
    below = np.arange(len(rgb), dtype=np.float32)[:, None, None] - chin[1]
    share = np.clip((below - 4) / 20, 0, 1) * scene.skin[..., None]
    rgb += share * (np.array(neck) - rgb + (rgb - np.array(TONES["tan"][0])) * 0.5)
    covered = np.broadcast_to(below[..., 0] > ends, scene.skin.shape)
    rgb[covered] = np.array(clothes) + np.random.default_rng(1).normal(0, 2, (int(covered.sum()), 3))
    return np.clip(rgb, 0, 255).astype(np.uint8), covered


def test_a_bare_neck_in_a_light_of_its_own_is_skin() -> None:
    """A lamp before the face, a window beside the neck: the neck is five spreads from the face's colour."""
    scene = drawn_face(width=130, center=(160, 110))
    rgb, clothes = _in_its_own_light(scene, (152, 130, 125), (170, 180, 186), 62)
    neck = scene.skin & ~clothes & (np.arange(len(rgb))[:, None] > scene.landmarks.points[layout.CHIN][1] + 8)
    mask = skin_mask(rgb, scene.landmarks)
    assert neck.sum() > 1500
    assert mask[neck].mean() > 0.95
    assert mask[clothes].mean() < 0.02


@pytest.mark.parametrize("knitted", [(168, 140, 118), (200, 185, 170), (90, 60, 45)], ids=["camel", "beige", "brown"])
def test_a_roll_neck_is_no_neck(knitted: tuple[int, ...]) -> None:
    scene = drawn_face(width=130, center=(160, 110))
    rgb, clothes = _in_its_own_light(scene, TONES["tan"][0], knitted, 6)
    assert skin_mask(rgb, scene.landmarks)[clothes].mean() < 0.05


def test_a_face_half_in_the_shade_is_all_skin() -> None:
    """A window from one side: what it lights would be driven into white where the shade is brought to usual light."""
    scene = drawn_face(width=130, center=(160, 150), tone=((236, 196, 172), (110, 105, 100)))
    left, right = (float(end(scene.landmarks.points[:, 0])) for end in (np.min, np.max))
    shade = np.clip((right - 0.3 * (right - left) - np.arange(scene.rgb.shape[1])) / 14, 0, 1)
    rgb = (scene.rgb * (1 - 0.5 * shade[:, None] * scene.skin[..., None])).astype(np.uint8)
    matte = SkinTracker(fit_skin_model(rgb, scene.landmarks)).step(rgb, scene.landmarks)
    for mask in (skin_mask(rgb, scene.landmarks), mask_of(matte, rgb.shape)):
        assert mask[scene.skin & (shade == 0)].mean() > 0.95  # 0.83 of it


def test_a_tie_of_the_skins_colour_is_left_out() -> None:
    scene = drawn_face()
    chin = scene.landmarks.points[layout.CHIN]
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    shirt = ys > chin[1] + 25
    tie = shirt & (np.abs(xs - chin[0]) < np.where(ys < chin[1] + 40, 4, 12))
    rgb = scene.rgb.copy()
    rgb[shirt & ~tie] = (235, 236, 240)
    rgb[tie] = TONES["tan"][0]
    mask = skin_mask(rgb, scene.landmarks)
    assert mask[tie].mean() < 0.15
    assert iou(mask, scene.skin & ~shirt) > 0.95


def test_a_face_cut_by_the_pictures_edge_is_found_as_far_as_it_is_seen() -> None:
    for center in ((20, 130), (300, 130), (160, 20), (160, 290)):
        scene = drawn_face(center=center)
        assert iou(skin_mask(scene.rgb, scene.landmarks), scene.skin) > 0.94, center


def test_a_face_outside_the_picture_has_no_skin() -> None:
    scene = drawn_face()
    far = scene.landmarks.moved(np.array([5000, 5000], np.float32))
    assert not skin_mask(scene.rgb, far).any()
    model = fit_skin_model(scene.rgb, far)
    assert not SkinTracker(model).step(scene.rgb, far).alpha.any()


def test_a_face_of_sixty_four_pixels_is_found() -> None:
    scene = drawn_face(width=64)
    assert iou(skin_mask(scene.rgb, scene.landmarks), scene.skin) > 0.93


def test_the_papers_rule_is_red_chroma_between_140_and_160() -> None:
    scene = drawn_face()
    mask = skin_mask(scene.rgb, scene.landmarks, mask="ycbcr")
    red, luma = scene.rgb[..., 0].astype(float), scene.rgb @ np.array([0.299, 0.587, 0.114])
    chroma = np.rint(0.713 * (red - luma) + 128)
    skin = ((chroma >= 140) & (chroma <= 160)).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(skin, connectivity=4)
    largest = labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
    assert (mask | ~largest).mean() > 0.998  # all of it, but for rounding
    assert iou(mask, scene.skin) > 0.9
    background = 1 - mask.astype(np.uint8)
    assert cv2.connectedComponents(np.pad(background, 1, constant_values=1), connectivity=4)[0] == 2  # no holes


def test_the_papers_rule_finds_nothing_where_no_red_touches_the_face() -> None:
    rgb = np.full((60, 80, 3), 128, np.uint8)
    rgb[2:5, 2:5] = (170, 120, 110)
    face = np.zeros((60, 80), np.bool_)
    assert red_chroma_mask(rgb, ~face).sum() == 9
    face[20:40, 30:50] = True
    assert not red_chroma_mask(rgb, face).any()
