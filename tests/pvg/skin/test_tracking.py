"""The matte of a face through a clip."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.quality.measures import iou
from pvg.face import layout
from pvg.raster import Raster
from pvg.skin import Matte, SceneReader, SkinTracker, fit_skin_model, network, scene_raster, skin_mask
from pvg.skin import Scene as WholePicture
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior, face_area
from tests.gallery.scenes import Scene, alpha_of, drawn_face, grown, mask_of, with_forehead


def first_matte(scene: Scene, **options: Any) -> Matte:
    return SkinTracker(fit_skin_model(scene.rgb, scene.landmarks, **options)).step(scene.rgb, scene.landmarks)


def test_the_trackers_first_mask_is_the_key_frames() -> None:
    scene = drawn_face(width=150, center=(160, 120))
    matte = first_matte(scene)
    assert iou(mask_of(matte, scene.rgb.shape), scene.skin) > 0.95
    alpha = alpha_of(matte, scene.rgb.shape)
    inner = cv2.distanceTransform(scene.skin.astype(np.uint8), cv2.DIST_L2, 5)
    head = np.arange(scene.rgb.shape[0])[:, None] < scene.landmarks.points[layout.CHIN, 1]
    assert alpha[(inner > 10) & head].min() > 0.99
    assert alpha[cv2.distanceTransform((~scene.skin).astype(np.uint8), cv2.DIST_L2, 5) > 10].max() == 0


def test_the_mask_follows_a_moving_face_without_jitter_or_ghost() -> None:
    first = drawn_face(center=(120, 130))
    tracker = SkinTracker(fit_skin_model(first.rgb, first.landmarks))
    areas, shapes = [], set()
    for k in range(15):
        scene = drawn_face(center=(120 + 3 * k, 130 + k % 3), seed=k)
        matte = tracker.step(scene.rgb, scene.landmarks)
        mask = mask_of(matte, scene.rgb.shape)
        assert iou(mask, scene.skin) > 0.95
        outer = cv2.distanceTransform((~scene.skin).astype(np.uint8), cv2.DIST_L2, 5)
        assert alpha_of(matte, scene.rgb.shape)[outer > 10].max() == 0
        areas.append(mask.sum())
        shapes.add(matte.alpha.shape)
    assert np.std(areas) / np.mean(areas) < 0.01
    assert len(shapes) == 1


def _bowed(scene: Scene, taller: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture and skin with the forehead so many times as high and shining, the landmarks where they were."""
    rgb, skin = with_forehead(scene, taller)
    band = cv2.GaussianBlur((skin & ~scene.skin).astype(np.float32), (0, 0), 2)
    shine = band[..., None] * np.array([0.3, 0.25, 0.2])  # yellower than what the key frame saw
    return np.clip(rgb * (1 + shine), 0, 255).astype(np.uint8), skin


@pytest.mark.parametrize(("taller", "least"), [(1.3, 0.85), (1.5, 0.55)])  # 0.65 and 0.31 by the key frame's shape
def test_a_bowed_forehead_is_skin_up_to_dark_hair(taller: float, least: float) -> None:
    """Landmarks end at the brows, so the key frame's shape stops short of a forehead that is seen from above."""
    scene = drawn_face(width=150, center=(160, 140), tone=((190, 140, 110), (45, 35, 30)))
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
    rgb, skin = _bowed(scene, taller)
    for _ in range(3):
        matte = tracker.step(rgb, scene.landmarks)
    alpha = alpha_of(matte, rgb.shape)
    added = skin & ~scene.skin
    assert added.sum() > 500
    assert alpha[added].mean() > least
    above = np.arange(len(alpha))[:, None] < 100
    assert alpha[grown(skin, 13) & ~grown(skin, 9) & above].max() < 0.02


def test_the_matte_does_not_fade_along_the_pictures_edge() -> None:
    scene = drawn_face(center=(160, 230))  # the picture ends half-way down the neck
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
    for _ in range(3):
        matte = tracker.step(scene.rgb, scene.landmarks)
    last = alpha_of(matte, scene.rgb.shape)[-1]
    column = round(float(scene.landmarks.points[layout.CHIN, 0]))
    assert last[column - 20 : column + 20].min() > 0.95
    rows = matte.raster.centers()[1]
    assert not matte.mask[rows > scene.rgb.shape[0] - 0.5].any()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The mean levels of the pictures that the network was asked about."""
    means: list[int] = []
    says = network.predict_skin

    def predict(rgb: np.ndarray, *of: Any) -> np.ndarray:
        means.append(round(float(rgb.mean())))
        return says(rgb, *of)

    monkeypatch.setattr(network, "predict_skin", predict)
    return means


@pytest.mark.parametrize("denied", [True, False])
def test_hair_over_a_cheek_is_no_skin_where_the_network_is_sure(monkeypatch: pytest.MonkeyPatch, denied: bool) -> None:
    """The foreground is skin whatever the rules say, and long hair hangs into it."""
    scene = drawn_face(width=130, center=(160, 150))
    left = scene.landmarks.points[:, 0].min()
    hair = scene.skin & (np.arange(scene.rgb.shape[1]) < left + 24)
    says = network.predict_skin
    sure = 0.01 if denied else 0.2

    def predict(rgb: np.ndarray, prior: SpatialPrior, by_rules: np.ndarray) -> np.ndarray:
        end = np.flatnonzero(prior.face.any(axis=0))[0] + 24 * prior.size / 130
        over = np.arange(rgb.shape[1]) < end
        return np.asarray(np.where(over, sure, says(rgb, prior, by_rules)), np.float32)

    monkeypatch.setattr(network, "predict_skin", predict)
    rgb = scene.rgb.copy()
    rgb[hair] = (70, 50, 40)
    model = fit_skin_model(rgb, scene.landmarks)
    mask = mask_of(SkinTracker(model).step(rgb, scene.landmarks), rgb.shape)
    within = hair & face_area(rgb.shape[:2], scene.landmarks)
    within[:, int(left) + 18 :] = False
    assert (mask[within].mean() < 0.1) == denied
    assert mask[scene.skin & ~hair].mean() > 0.9


@pytest.mark.parametrize("along", ["over the eyes", "down the face", "all of it"])
def test_what_the_network_denies_takes_no_half_of_a_face_along(monkeypatch: pytest.MonkeyPatch, along: str) -> None:
    """A strand or goggles cut the foreground in two; a network that sees no face at all is not asked."""
    scene = drawn_face(width=130, center=(160, 150))
    says = network.predict_skin

    def predict(rgb: np.ndarray, prior: SpatialPrior, by_rules: np.ndarray) -> np.ndarray:
        rows, columns = np.nonzero(prior.face)
        y, x = np.ogrid[: rgb.shape[0], : rgb.shape[1]]
        band = {
            "over the eyes": abs((y - rows.min()) / np.ptp(rows) - 0.42) < 0.08,
            "down the face": abs(x - np.median(columns)) < 0.03 * prior.size,
            "all of it": np.ones((1, 1), np.bool_),
        }[along]
        return np.asarray(np.where(band, 0.001, says(rgb, prior, by_rules)), np.float32)

    monkeypatch.setattr(network, "predict_skin", predict)
    face = face_area(scene.rgb.shape[:2], scene.landmarks)
    for mask in (
        skin_mask(scene.rgb, scene.landmarks),
        mask_of(SkinTracker(fit_skin_model(scene.rgb, scene.landmarks)).step(scene.rgb, scene.landmarks), face.shape),
    ):
        assert mask[face].mean() > (0.6 if along == "all of it" else 0.78)
        assert not mask[~scene.skin].mean() > 0.02


def test_what_leaves_the_face_is_not_denied_until_the_network_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = drawn_face(width=130, center=(160, 150))
    x, y = (int(at) for at in scene.landmarks.points[[layout.NOSE_TIP]].mean(axis=0))
    over = slice(y - 25, y + 15), slice(x - 80, x - 34)  # a hand over a cheek
    covered = scene.rgb.copy()
    covered[over] = (60, 44, 36)
    says = network.predict_skin

    def predict(rgb: np.ndarray, prior: SpatialPrior, by_rules: np.ndarray) -> np.ndarray:
        dark = cv2.dilate((rgb.max(axis=2) < 110).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        beside = np.arange(rgb.shape[1]) < np.median(np.nonzero(prior.face)[1]) - 0.2 * prior.size
        return np.asarray(np.where(dark & beside, 0.001, says(rgb, prior, by_rules)), np.float32)

    monkeypatch.setattr(network, "predict_skin", predict)
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
    cheek = scene.skin[over]
    masks = [mask_of(tracker.step(rgb, scene.landmarks), scene.skin.shape)[over] for rgb in (covered, *[scene.rgb] * 3)]
    assert masks[0][cheek].mean() < 0.3
    assert min(mask[cheek].mean() for mask in masks[1:]) > 0.95


def test_the_network_is_asked_in_every_fourth_frame_and_its_answer_moves_along(asked: list[int]) -> None:
    first = drawn_face(center=(120, 130))
    tracker = SkinTracker(fit_skin_model(first.rgb, first.landmarks))
    asked.clear()  # the key frame's own question
    every = SKIN_PRIOR.network.every
    for k in range(2 * every + 1):
        scene = drawn_face(center=(120 + 2 * k, 130))
        tracker.step(scene.rgb, scene.landmarks)
        assert len(asked) == 1 + k // every
        output = tracker.network_output
        assert output is not None
        there = output.raster.to_cells(scene.landmarks.points[[layout.NOSE_TIP]])[0].astype(int)
        assert output.probability[there[1], there[0]] > 0.9


def test_the_network_is_asked_at_once_when_the_picture_changes(asked: list[int]) -> None:
    scene = drawn_face(center=(160, 120))
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
    for _ in range(2):
        tracker.step(scene.rgb, scene.landmarks)
    before = len(asked)
    tracker.step((scene.rgb * 0.6).astype(np.uint8), scene.landmarks)
    assert len(asked) == before + 1


def _seen(scene: Scene, people: np.ndarray) -> WholePicture:
    """The whole picture with people (H, W) bool where they are said to be."""
    seen = SceneReader().step(scene.rgb, (scene.landmarks,))
    h, w = seen.raster.shape
    person = cv2.resize(people.astype(np.uint8) * 255, (w, h), interpolation=cv2.INTER_AREA)
    return replace(seen, person=np.asarray(person, np.uint8))


def test_a_wall_of_the_skins_colour_beside_the_neck_is_no_skin() -> None:
    scene = drawn_face(width=150, center=(160, 120))
    chin, side = scene.landmarks.points[layout.CHIN], scene.landmarks.axes.width * 0.5
    shelf = np.zeros_like(scene.skin)
    rows = slice(round(float(chin[1] + 12)), round(float(chin[1] + 40)))
    shelf[rows, : round(float(chin[0] + side))] = True
    shelf &= ~cv2.dilate(scene.skin.astype(np.uint8), np.ones((5, 5))).astype(bool)
    scene.rgb[shelf] = np.median(scene.rgb[scene.skin], axis=0)
    taken = {}
    for name, people in (("nobody asked", None), ("people", ~shelf), ("nobody seen", np.zeros_like(shelf))):
        tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
        matte = tracker.step(scene.rgb, scene.landmarks, None if people is None else _seen(scene, people))
        alpha = alpha_of(matte, scene.rgb.shape)
        taken[name] = float(alpha[shelf].sum())
        assert alpha[scene.skin].mean() > 0.9
    assert taken["nobody asked"] > 200  # pixels
    assert taken["people"] < 0.3 * taken["nobody asked"]
    assert taken["nobody seen"] == taken["nobody asked"]  # a network that misses the face is not believed


def test_beyond_the_picture_people_go_on() -> None:
    """A neck that the picture cuts keeps its whole matte in the last row of pixels."""
    scene = drawn_face(width=150, center=(160, 120))
    raster = scene_raster(scene.rgb.shape[:2])
    everywhere = _seen(scene, np.ones_like(scene.skin))
    beyond = Raster(raster.origin - np.float32(9), raster.step, (raster.shape[0] + 8, raster.shape[1] + 8))
    assert everywhere.people(beyond).min() == 1.0


def test_a_jump_leaves_no_ghost() -> None:
    first, second = drawn_face(center=(100, 130)), drawn_face(center=(190, 130), seed=1)
    tracker = SkinTracker(fit_skin_model(first.rgb, first.landmarks))
    tracker.step(first.rgb, first.landmarks)
    matte = tracker.step(second.rgb, second.landmarks)
    assert iou(mask_of(matte, second.rgb.shape), second.skin) > 0.95


@pytest.mark.parametrize("gain", [0.5, 0.7, 1.5])
def test_a_sudden_light_does_not_move_the_mask(gain: float) -> None:
    before, after = drawn_face(tone="dark"), drawn_face(tone="dark", gain=gain, seed=1)
    tracker = SkinTracker(fit_skin_model(before.rgb, before.landmarks))
    quiet = tracker.step(before.rgb, before.landmarks)
    flash = tracker.step(after.rgb, after.landmarks)
    assert iou(quiet.mask, flash.mask) > 0.97


def test_the_matte_of_a_still_scene_with_noise_hardly_flickers() -> None:
    scenes = [drawn_face(seed=seed) for seed in range(8)]
    tracker = SkinTracker(fit_skin_model(scenes[0].rgb, scenes[0].landmarks))
    mattes = [tracker.step(scene.rgb, scene.landmarks).alpha / 255 for scene in scenes]
    assert np.mean(np.abs(np.diff(mattes, axis=0))) < 5e-4


def test_frames_may_come_before_the_key_frame() -> None:
    early, key = drawn_face(center=(130, 130), gain=0.8), drawn_face(center=(190, 130), width=130)
    tracker = SkinTracker(fit_skin_model(key.rgb, key.landmarks))
    matte = tracker.step(early.rgb, early.landmarks)
    assert iou(mask_of(matte, early.rgb.shape), early.skin) > 0.95


def test_the_papers_rule_gives_hard_mattes() -> None:
    scene = drawn_face()
    matte = first_matte(scene, mask="ycbcr")
    np.testing.assert_array_equal(matte.alpha, matte.mask * np.uint8(255))
    still = skin_mask(scene.rgb, scene.landmarks, mask="ycbcr")
    assert iou(mask_of(matte, scene.rgb.shape), still) > 0.9


def test_the_matte_fades_along_every_side_of_its_raster() -> None:
    """A picture of nothing but skin: whatever side the matte meets, it has no straight edge there."""
    scene = drawn_face(width=120, center=(200, 200), size=(480, 400), tone=((190, 140, 105), (190, 140, 105)))
    alpha = first_matte(scene).alpha
    for side in (alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]):
        assert side.max() == 0
    steps = max(
        np.abs(np.diff(alpha[:8].astype(int), axis=0)).max(), np.abs(np.diff(alpha[-8:].astype(int), axis=0)).max()
    )
    assert steps < 130
