"""The stages' accuracy on a drawn face whose skin and colours are known.

The pinned errors are today's; each may grow by 5 % before its test fails. Pin lower when they fall. Scenes with real
faces that go the whole way: test_known_scenes.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.quality.measures import iou
from pvg.curves import table_labels
from pvg.looks import sliced_transport
from pvg.membrane import Lattice, build_membrane, cut_edges
from pvg.skin import SkinTracker, fit_skin_model
from pvg.vectorization.curve_places import curve_positions
from pvg.vectorization.key_colors import fit_key_frame
from tests.gallery.scenes import Scene, drawn_face, open_skin

WORSE = 1.05  # how much a pinned error may grow
PINNED = {"mask": 0.0104, "colour": 2.045}  # share of the union, levels of 255
FRAMES = 12
GROUND = (40, 60, 90)
OTHER_SKIN = (120, 84, 64)


def scene_at(k: int, skin: tuple[int, ...] = (190, 140, 105)) -> Scene:
    """Frame `k` of a face that moves through the picture."""
    center = (165 + 2.5 * k, 140 + 1.5 * float(np.sin(k)))
    return drawn_face(center, 150.0, (skin, GROUND), (360, 360), seed=k)


@dataclass(frozen=True)
class Result:
    """rgb (H, W, 3) float32, not rounded, and the matte (H, W) and mask of a frame."""

    rgb: np.ndarray
    alpha: np.ndarray
    mask: np.ndarray


class Method:
    """The stages as the drivers chain them, on landmarks that are known; the first scene is the key frame."""

    def __init__(self, key: Scene) -> None:
        self._tracker = SkinTracker(fit_skin_model(key.rgb, key.landmarks))
        self.g, self._visible = self._colors(key)
        self._new = self.g

    def _colors(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        model = fit_skin_model(scene.rgb, scene.landmarks)
        matte = SkinTracker(model).step(scene.rgb, scene.landmarks)
        return fit_key_frame(scene.rgb, matte, curve_positions(scene.landmarks, matte), scene.landmarks.axes.width, 0)

    def aim(self, reference: Scene) -> None:
        """Take the colours of another scene's face."""
        wanted, visible = self._colors(reference)
        self._new = self.g.copy()
        shown = self._visible
        self._new[shown] = sliced_transport(self.g[shown], wanted[visible], rng=np.random.default_rng(0))
        if not shown.all():
            self._new[~shown] += (self._new[shown] - self.g[shown]).mean(axis=0)

    def step(self, scene: Scene) -> Result:
        """The next frame in the new colours, lambda = 1."""
        matte = self._tracker.step(scene.rgb, scene.landmarks)
        h, w = scene.rgb.shape[:2]
        xs, ys = np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32)
        cuts = cut_edges(curve_positions(scene.landmarks, matte), table_labels().spans, Lattice.over((0, 0, w, h)))
        field = build_membrane(cuts).solve(self._new - self.g).crop(0, 0, w, h)
        alpha = matte.alpha_at(xs, ys)
        return Result(scene.rgb + alpha[..., None] * field, alpha, matte.mask_at(xs, ys))


def test_own_colours_return_every_frame_of_a_moving_face() -> None:
    scenes = [scene_at(k) for k in range(3)]
    method = Method(scenes[0])
    for scene in scenes:
        np.testing.assert_allclose(method.step(scene).rgb, scene.rgb, atol=1e-3)


def test_a_moving_shaded_face_gets_the_other_skin_under_its_own_shading() -> None:
    scenes = [scene_at(k) for k in range(FRAMES)]
    method = Method(scenes[0])
    method.aim(scene_at(0, OTHER_SKIN))
    results = [method.step(scene) for scene in scenes]
    overlap = np.mean([1 - iou(result.mask, scene.skin) for result, scene in zip(results, scenes, strict=True)])
    errors = []
    for scene, result in zip(scenes, results, strict=True):
        truth = np.array(OTHER_SKIN) * scene.shade[..., None]
        errors.append(np.abs(cv2.blur(result.rgb - truth, (9, 9)))[open_skin(scene)].mean())  # over the sensor's noise
    assert overlap <= WORSE * PINNED["mask"]
    assert np.mean(errors) <= WORSE * PINNED["colour"]
