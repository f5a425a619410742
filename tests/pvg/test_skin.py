"""Skin masks and mattes: of one picture, and of a face through a clip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pvg.landmarks import detect_faces, fit_landmarks, jd_106, skin_88
from pvg.skin import Matte, SkinTracker, face_box, fit_skin_model, skin_mask
from scripts.samples import fetch_samples

MASKS = ("man_cap_beard_dim", "man_fringe_pale", "woman_earrings_bright", "woman_fringe_dark_background")
INSIDE = (1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 13, 14)
ON_SKIN = [*range(43, 64), *range(72, 104)]  # eyes, nose and mouth; brows end at the temples, maybe under hair
TONES = {
    "pale": ((235, 200, 185), (70, 90, 120)),
    "tan": ((190, 140, 105), (40, 60, 50)),
    "dark": ((85, 55, 42), (150, 165, 175)),
    "in blue light": ((120, 115, 190), (60, 70, 60)),
    "grey": ((170, 168, 166), (60, 61, 60)),
}


def _read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _points(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    faces = [fit_landmarks(rgb, face) for face in detect_faces(rgb)]
    mesh = max(faces, key=lambda mesh: np.ptp(mesh.points[:, 0])).points
    return jd_106(mesh), skin_88(mesh)


@cache
def _template() -> np.ndarray:
    """(194, 2) landmarks of a real frontal face, 1 wide, chin line downwards, around the origin."""
    points, skin_points = _points(_read(fetch_samples().pale_portrait))
    stacked = np.concatenate([points, skin_points])
    return (stacked - skin_points[:36].mean(axis=0)) / np.ptp(points[:33, 0])


@dataclass(frozen=True)
class Scene:
    """A drawn face on a plain ground, and its true skin."""

    rgb: np.ndarray
    points: np.ndarray
    skin_points: np.ndarray
    truth: np.ndarray


def _scene(
    center: tuple[float, float] = (160, 130),
    width: float = 120,
    tone: str = "tan",
    size: tuple[int, int] = (320, 320),
    gain: float = 1.0,
    seed: int = 0,
) -> Scene:
    stacked = (_template() * width + np.array(center)).astype(np.float32)
    points, skin_points = stacked[:106], stacked[106:]
    chin = points[16]
    neck = np.array([[-0.33, -0.5], [0.33, -0.5], [0.33, 0.75], [-0.33, 0.75]]) * width + chin
    face = cv2.convexHull(stacked)[:, 0]
    truth = np.zeros(size, np.uint8)
    for polygon in (face, neck):
        cv2.fillPoly(truth, [np.rint(polygon * 16).astype(np.int32)], (1,), shift=4)
    skin, ground = (np.array(color, np.float32) for color in TONES[tone])
    ys, xs = np.mgrid[: size[0], : size[1]]
    shade = 1 - 0.25 * np.clip((xs - center[0]) / width, -1, 1) - 0.15 * np.clip((ys - chin[1]) / width, 0, 1)
    picture = np.where(truth[..., None] > 0, skin * shade[..., None], ground)
    features = (
        ((52, 53, 54, 55, 56, 57), 0.3),
        ((58, 59, 60, 61, 62, 63), 0.3),
        (tuple(range(84, 96)), 0.8),
        ((33, 34, 35, 36, 37, 67, 66, 65, 64), 0.35),
        ((38, 39, 40, 41, 42, 71, 70, 69, 68), 0.35),
    )
    for indices, dark in features:
        hole = np.zeros(size, np.uint8)
        cv2.fillPoly(hole, [np.rint(points[list(indices)] * 16).astype(np.int32)], (1,), shift=4)
        picture[hole > 0] = skin * dark
    picture = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.8) * gain
    picture += np.random.default_rng(seed).normal(0, 2, picture.shape)
    return Scene(np.clip(picture, 0, 255).astype(np.uint8), points, skin_points, truth > 0)


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def _mask_of(matte: Matte, shape: tuple[int, ...]) -> np.ndarray:
    return matte.mask_at(np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32))


def _alpha_of(matte: Matte, shape: tuple[int, ...]) -> np.ndarray:
    return matte.alpha_at(np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32))


def _first_matte(scene: Scene, **options: Any) -> Matte:
    model = fit_skin_model(scene.rgb, scene.points, scene.skin_points, **options)
    return SkinTracker(model).step(scene.rgb, scene.points, scene.skin_points)


# the box


def test_the_box_holds_all_landmarks_and_a_neck() -> None:
    scene = _scene()
    x0, y0, x1, y1 = face_box(scene.points, scene.skin_points)
    stacked = np.concatenate([scene.points, scene.skin_points])
    assert (stacked > [x0, y0]).all()
    assert (stacked < [x1, y1]).all()
    assert y1 > scene.points[16, 1] + 0.8 * np.ptp(scene.skin_points[:36, 1])


@settings(deadline=None, max_examples=30)
@given(st.floats(0.3, 8), st.floats(-500, 2000), st.floats(-500, 2000), st.floats(-1.2, 1.2), st.integers(0, 2**31))
def test_the_box_moves_and_scales_with_the_face_and_never_jumps(
    scale: float, dx: float, dy: float, roll: float, seed: int
) -> None:
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    face = (_template() * 100 @ turn.T).astype(np.float32)
    box = face_box(face[:106], face[106:])
    moved = (face * scale + [dx, dy]).astype(np.float32)
    expected = box * scale + [dx, dy, dx, dy]
    np.testing.assert_allclose(face_box(moved[:106], moved[106:]), expected, atol=0.02 * scale + 0.01)
    nudged = (face + np.random.default_rng(seed).uniform(-0.1, 0.1, face.shape)).astype(np.float32)
    assert np.abs(face_box(nudged[:106], nudged[106:]) - box).max() < 2.0


# the matte as a raster


@settings(deadline=None, max_examples=30)
@given(
    hnp.arrays(np.uint8, st.tuples(st.integers(2, 9), st.integers(2, 9))),
    st.floats(1, 7),
    st.floats(-40, 40),
    st.floats(-40, 40),
)
def test_a_matte_sampled_at_its_cell_centres_is_its_raster(
    alpha: np.ndarray, step: float, x0: float, y0: float
) -> None:
    h, w = alpha.shape
    matte = Matte(np.array([x0, y0, x0 + w * step, y0 + h * step], np.float32), alpha, alpha > 127)
    assert matte.step == pytest.approx(step, rel=1e-4)
    xs = x0 + (np.arange(w) + 0.5) * step - 0.5
    ys = y0 + (np.arange(h) + 0.5) * step - 0.5
    np.testing.assert_allclose(matte.alpha_at(xs, ys), alpha / 255, atol=2e-3)
    np.testing.assert_array_equal(matte.mask_at(xs, ys), alpha > 127)
    corner = matte.to_raster(np.array([[xs[-1], ys[-1]]], np.float32))
    np.testing.assert_allclose(corner, [[w - 1, h - 1]], atol=1e-3)


def test_a_matte_is_bilinear_inside_and_nothing_outside_its_box() -> None:
    ramp = np.tile(np.arange(0, 250, 10, dtype=np.uint8), (9, 1))
    matte = Matte(np.array([10, 20, 10 + 25 * 2, 20 + 9 * 2], np.float32), ramp, ramp > 120)
    xs = np.linspace(12, 57, 200).astype(np.float32)
    expected = ((xs - 10 + 0.5) / 2 - 0.5) * 10 / 255
    np.testing.assert_allclose(matte.alpha_at(xs, np.array([27.0], np.float32))[0], expected, atol=1e-4)
    far = np.array([-100.0, 5.0, 70.0, 900.0], np.float32)
    assert not matte.alpha_at(far, np.array([27.0], np.float32)).any()
    assert not matte.mask_at(xs, np.array([0.0, 60.0], np.float32)).any()


# one picture


@pytest.mark.parametrize("tone", TONES)
def test_the_skin_of_a_drawn_face_is_found(tone: str) -> None:
    scene = _scene(tone=tone)
    mask = skin_mask(scene.rgb, scene.points, scene.skin_points)
    assert _iou(mask, scene.truth) > 0.96
    col, row = np.rint(scene.points[33:]).astype(int).T
    assert mask[row, col].all()  # eyes, brows, nose and mouth are inside, filled


def _with_hair(scene: Scene, hair: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The drawn face with hair about the head and a half-see-through fringe; and where the fringe is on the face."""
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    oval = scene.skin_points[:36]
    top, middle = oval[:, 1].min(), oval[:, 0].mean()
    brow = scene.points[33:43, 1].min()
    head = np.hypot((xs - middle) / 100, (ys - oval[:, 1].mean()) / 120) < 1
    around = head & (scene.truth == 0) & (ys < brow + 15)
    fringe = scene.truth & (ys < top + 0.6 * (brow - top)) & (xs < middle + 15)
    cover = np.where(around, 1.0, np.where(fringe, 0.6 + 0.15 * np.sin(xs), 0.0))
    cover = cv2.GaussianBlur(cover, (0, 0), 0.7)[..., None]
    strands = np.array(hair) * (1 + 0.08 * np.sin(xs * 1.7))[..., None]
    return np.clip(scene.rgb * (1 - cover) + strands * cover, 0, 255).astype(np.uint8), fringe


@pytest.mark.parametrize("hair", [(45, 33, 26), (190, 162, 105)], ids=["dark", "fair"])
def test_a_fringe_is_left_out_of_the_still_and_of_the_matte(hair: tuple[float, float, float]) -> None:
    scene = _scene(width=120, tone="pale" if hair[0] < 100 else "tan")
    rgb, fringe = _with_hair(scene, hair)
    bare = scene.truth & ~fringe
    still = skin_mask(rgb, scene.points, scene.skin_points)
    model = fit_skin_model(rgb, scene.points, scene.skin_points)
    matte = SkinTracker(model).step(rgb, scene.points, scene.skin_points)
    for mask in (still, _mask_of(matte, rgb.shape)):
        assert mask[fringe].mean() < 0.1
        assert _iou(mask, bare) > 0.95
    assert fringe.sum() > 400


def test_the_deep_shade_of_a_brim_is_skin() -> None:
    scene = _scene(width=150)
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    oval, brow = scene.skin_points[:36], scene.points[33:43, 1].min()
    hat = np.hypot((xs - oval[:, 0].mean()) / 135, (ys - oval[:, 1].mean()) / 170) < 1
    shade = scene.truth & (ys < brow - 4)
    rgb = np.where(shade[..., None], scene.rgb * 0.1, scene.rgb).astype(np.uint8)
    rgb[hat & ~scene.truth & (ys < brow - 4)] = (45, 60, 150)
    mask = skin_mask(rgb, scene.points, scene.skin_points)
    assert shade.sum() > 500
    assert mask[shade].mean() > 0.9
    assert _iou(mask, scene.truth) > 0.95


def test_a_tie_of_the_skins_colour_is_left_out() -> None:
    scene = _scene()
    chin = scene.points[16]
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]]
    shirt = ys > chin[1] + 25
    tie = shirt & (np.abs(xs - chin[0]) < np.where(ys < chin[1] + 40, 4, 12))
    rgb = scene.rgb.copy()
    rgb[shirt & ~tie] = (235, 236, 240)
    rgb[tie] = TONES["tan"][0]
    mask = skin_mask(rgb, scene.points, scene.skin_points)
    assert mask[tie].mean() < 0.15
    assert _iou(mask, scene.truth & ~shirt) > 0.95


def test_a_face_cut_by_the_pictures_edge_is_found_as_far_as_it_is_seen() -> None:
    for center in ((20, 130), (300, 130), (160, 20), (160, 290)):
        scene = _scene(center=center)
        assert _iou(skin_mask(scene.rgb, scene.points, scene.skin_points), scene.truth) > 0.94, center


def test_a_face_outside_the_picture_has_no_skin() -> None:
    scene = _scene()
    far = scene.points + 5000, scene.skin_points + 5000
    assert not skin_mask(scene.rgb, *far).any()
    model = fit_skin_model(scene.rgb, *far)
    assert not SkinTracker(model).step(scene.rgb, *far).alpha.any()


def test_a_face_of_sixty_four_pixels_is_found() -> None:
    scene = _scene(width=64)
    assert _iou(skin_mask(scene.rgb, scene.points, scene.skin_points), scene.truth) > 0.93


def test_the_papers_rule_is_red_chroma_between_140_and_160() -> None:
    scene = _scene()
    mask = skin_mask(scene.rgb, scene.points, scene.skin_points, method="ycbcr")
    red, luma = scene.rgb[..., 0].astype(float), scene.rgb @ np.array([0.299, 0.587, 0.114])
    chroma = np.rint(0.713 * (red - luma) + 128)
    skin = ((chroma >= 140) & (chroma <= 160)).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(skin, connectivity=4)
    largest = labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
    assert (mask | ~largest).mean() > 0.998  # all of it, but for rounding
    assert _iou(mask, scene.truth) > 0.9
    background = 1 - mask.astype(np.uint8)
    assert cv2.connectedComponents(np.pad(background, 1, constant_values=1), connectivity=4)[0] == 2  # no holes


@pytest.mark.parametrize("name", ["portrait", "dark_portrait", "pale_portrait"])
def test_a_portraits_mask_holds_its_features_and_leaves_the_corners(samples: Any, name: str) -> None:
    rgb = _read(getattr(samples, name))
    points, skin_points = _points(rgb)
    model = fit_skin_model(rgb, points, skin_points)
    matte = SkinTracker(model).step(rgb, points, skin_points)
    oval = cv2.contourArea(cv2.convexHull(skin_points[:36]))
    still = skin_mask(rgb, points, skin_points)
    for mask in (still, _mask_of(matte, rgb.shape)):
        col, row = np.rint(points[ON_SKIN]).astype(int).T
        assert mask[row, col].all()
        assert not mask[[0, 0, -1, -1], [0, -1, 0, -1]].any()
        assert 0.9 * oval < mask.sum() < 2.2 * oval
    assert _iou(_mask_of(matte, rgb.shape), still) > 0.95


# a clip


def test_the_trackers_first_mask_is_the_key_frames() -> None:
    scene = _scene(width=150, center=(160, 120))
    matte = _first_matte(scene)
    assert _iou(_mask_of(matte, scene.rgb.shape), scene.truth) > 0.95
    alpha = _alpha_of(matte, scene.rgb.shape)
    inner = cv2.distanceTransform(scene.truth.astype(np.uint8), cv2.DIST_L2, 5)
    head = np.arange(scene.rgb.shape[0])[:, None] < scene.points[16, 1]
    assert alpha[(inner > 10) & head].min() > 0.99
    assert alpha[cv2.distanceTransform((~scene.truth).astype(np.uint8), cv2.DIST_L2, 5) > 10].max() == 0


def test_the_mask_follows_a_moving_face_without_jitter_or_ghost() -> None:
    first = _scene(center=(120, 130))
    tracker = SkinTracker(fit_skin_model(first.rgb, first.points, first.skin_points))
    areas, shapes = [], set()
    for k in range(15):
        scene = _scene(center=(120 + 3 * k, 130 + k % 3), seed=k)
        matte = tracker.step(scene.rgb, scene.points, scene.skin_points)
        mask = _mask_of(matte, scene.rgb.shape)
        assert _iou(mask, scene.truth) > 0.95
        outer = cv2.distanceTransform((~scene.truth).astype(np.uint8), cv2.DIST_L2, 5)
        assert _alpha_of(matte, scene.rgb.shape)[outer > 10].max() == 0
        areas.append(mask.sum())
        shapes.add(matte.alpha.shape)
    assert np.std(areas) / np.mean(areas) < 0.01
    assert len(shapes) == 1


def test_the_matte_does_not_fade_along_the_pictures_edge() -> None:
    scene = _scene(center=(160, 230))  # the picture ends half-way down the neck
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.points, scene.skin_points))
    for _ in range(3):
        matte = tracker.step(scene.rgb, scene.points, scene.skin_points)
    last = _alpha_of(matte, scene.rgb.shape)[-1]
    column = round(float(scene.points[16, 0]))
    assert last[column - 20 : column + 20].min() > 0.95
    rows = matte.box[1] + (np.arange(matte.mask.shape[0]) + 0.5) * matte.step - 0.5
    assert not matte.mask[rows > scene.rgb.shape[0] - 0.5].any()


@pytest.mark.parametrize("tone", ["pale", "tan", "dark"])
def test_a_coloured_bar_before_the_face_leaves_the_matte_and_the_skin_comes_back(tone: str) -> None:
    scene = _scene(width=150, tone=tone)
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.points, scene.skin_points))
    columns = np.arange(scene.rgb.shape[1])
    center = int(scene.points[16, 0])
    for left in (None, center - 70, center - 40, center - 10, center + 25, None):
        bar = np.zeros(scene.truth.shape, np.bool_)
        if left is not None:
            bar[:, (columns >= left) & (columns < left + 26)] = True
        rgb = scene.rgb.copy()
        rgb[bar] = (40, 110, 170)
        alpha = _alpha_of(tracker.step(rgb, scene.points, scene.skin_points), rgb.shape)
        core = cv2.erode((bar & scene.truth).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        beside = cv2.erode((scene.truth & ~bar).astype(np.uint8), np.ones((13, 13), np.uint8)) > 0
        assert alpha[beside].mean() > 0.93
        assert alpha[core].mean() < 0.12 if core.any() else left is None


def test_a_jump_leaves_no_ghost() -> None:
    first, second = _scene(center=(100, 130)), _scene(center=(190, 130), seed=1)
    tracker = SkinTracker(fit_skin_model(first.rgb, first.points, first.skin_points))
    tracker.step(first.rgb, first.points, first.skin_points)
    matte = tracker.step(second.rgb, second.points, second.skin_points)
    assert _iou(_mask_of(matte, second.rgb.shape), second.truth) > 0.95


@pytest.mark.parametrize("gain", [0.5, 0.7, 1.5])
def test_a_sudden_light_does_not_move_the_mask(gain: float) -> None:
    before, after = _scene(tone="dark"), _scene(tone="dark", gain=gain, seed=1)
    tracker = SkinTracker(fit_skin_model(before.rgb, before.points, before.skin_points))
    quiet = tracker.step(before.rgb, before.points, before.skin_points)
    flash = tracker.step(after.rgb, after.points, after.skin_points)
    assert _iou(quiet.mask, flash.mask) > 0.97


def test_the_matte_of_a_still_scene_with_noise_hardly_flickers() -> None:
    scenes = [_scene(seed=seed) for seed in range(8)]
    tracker = SkinTracker(fit_skin_model(scenes[0].rgb, scenes[0].points, scenes[0].skin_points))
    mattes = [tracker.step(scene.rgb, scene.points, scene.skin_points).alpha / 255 for scene in scenes]
    assert np.mean(np.abs(np.diff(mattes, axis=0))) < 5e-4


def test_frames_may_come_before_the_key_frame() -> None:
    early, key = _scene(center=(130, 130), gain=0.8), _scene(center=(190, 130), width=130)
    tracker = SkinTracker(fit_skin_model(key.rgb, key.points, key.skin_points))
    matte = tracker.step(early.rgb, early.points, early.skin_points)
    assert _iou(_mask_of(matte, early.rgb.shape), early.truth) > 0.95


def test_the_raster_has_square_cells_of_a_pixel_or_more_and_a_bounded_size() -> None:
    for width in (30, 120, 500, 1500):
        face = (_template() * width + 900).astype(np.float32)
        rgb = np.full((1800, 1800, 3), 127, np.uint8)
        matte = SkinTracker(fit_skin_model(rgb, face[:106], face[106:], method="ycbcr")).step(
            rgb, face[:106], face[106:]
        )
        x0, y0, x1, y1 = matte.box
        assert (y1 - y0) / matte.alpha.shape[0] == pytest.approx((x1 - x0) / matte.alpha.shape[1], rel=1e-3)
        assert matte.step >= 1 - 1e-6
        assert max(matte.alpha.shape) <= 256
        assert matte.alpha.dtype == np.uint8


def test_the_papers_rule_gives_hard_mattes() -> None:
    scene = _scene()
    matte = _first_matte(scene, method="ycbcr")
    np.testing.assert_array_equal(matte.alpha, matte.mask * np.uint8(255))
    still = skin_mask(scene.rgb, scene.points, scene.skin_points, method="ycbcr")
    assert _iou(_mask_of(matte, scene.rgb.shape), still) > 0.9


def _clip(path: Path, frames: range) -> Iterator[np.ndarray]:
    with av.open(str(path)) as container:
        for index, frame in enumerate(container.decode(video=0)):
            if index >= frames.stop:
                return
            if index in frames:
                yield frame.to_ndarray(format="rgb24")


def test_a_real_clips_mask_keeps_to_the_face_and_its_size(samples: Any) -> None:
    tracker, areas = None, []
    for rgb in _clip(samples.woman_clip, range(0, 24, 2)):
        points, skin_points = _points(rgb)
        tracker = tracker or SkinTracker(fit_skin_model(rgb, points, skin_points))
        matte = tracker.step(rgb, points, skin_points)
        mask = _mask_of(matte, rgb.shape)
        col, row = np.rint(points[ON_SKIN]).astype(int).T
        assert mask[row, col].all()
        areas.append(mask.sum() / cv2.contourArea(cv2.convexHull(skin_points[:36])))
    assert len(areas) == 12
    assert min(areas) > 0.85
    assert max(areas) < 2.2
    assert np.std(areas) / np.mean(areas) < 0.06


# labelled portraits


def test_labelled_portraits_agree(media_dir: Path) -> None:
    stills, tracked, rule = [], [], []
    for name in MASKS:
        rgb = _read(media_dir / "masks" / f"{name}.jpg")
        labels = cv2.imread(str(media_dir / "masks" / f"{name}_labels.png"), cv2.IMREAD_UNCHANGED)
        truth = np.isin(labels, INSIDE)
        points, skin_points = _points(rgb)
        stills.append(_iou(skin_mask(rgb, points, skin_points), truth))
        rule.append(_iou(skin_mask(rgb, points, skin_points, method="ycbcr"), truth))
        matte = SkinTracker(fit_skin_model(rgb, points, skin_points)).step(rgb, points, skin_points)
        tracked.append(_iou(_mask_of(matte, rgb.shape), truth))
    assert np.mean(stills) > 0.958
    assert min(stills) > 0.938
    assert np.mean(tracked) > 0.956
    assert min(tracked) > 0.939
    assert np.mean(rule) < 0.75
