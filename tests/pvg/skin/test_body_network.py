"""The network that refines the body's mask: what it is shown, that it mends what is wrong and leaves what is right."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks
from pvg.skin import SceneReader, SkinTracker, body_network, fit_skin_model, network
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.features import features_around
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import head_shape
from tests.conftest import Samples
from tests.gallery.faces import fit_widest, read_rgb

_HANDS = 3.0  # of the face's oval, farther off hands may be


@dataclass(frozen=True, eq=False)
class Shown:
    """A portrait's face in its scene, as the network is asked of it;  light: (3,) RGB, the face's colour."""

    seen: FaceInScene
    light: np.ndarray

    @property
    def skin(self) -> np.ndarray:
        """(h, w) bool, the face's own mask."""
        return self.seen.face_mask > 0.5

    def predicted(self, probability: np.ndarray) -> np.ndarray:
        return body_network.predict_body_skin(self.seen, self.light, probability.astype(np.float32))


def _shown(rgb: np.ndarray, landmarks: Landmarks) -> Shown:
    scene = SceneReader().step(rgb, (landmarks,))
    skin = SkinTracker(fit_skin_model(rgb, landmarks))
    matte = skin.step(rgb, landmarks, scene)
    return Shown(FaceInScene.of(scene, matte, head_shape(landmarks.in_cells(scene.raster))), skin.light)


@pytest.fixture(scope="module", params=["portrait", "dark_portrait", "pale_portrait"])
def shown(request: pytest.FixtureRequest, samples: Samples) -> Shown:
    rgb = read_rgb(getattr(samples, request.param))
    return _shown(rgb, fit_widest(rgb))


def test_a_scene_is_shown_no_finer_than_it_is_and_at_one_face_size(shown: Shown) -> None:
    by_rules = shown.skin.astype(np.float32)
    fields = body_network.body_fields(shown.seen, shown.light, by_rules)
    assert len(fields) == network.FIELDS
    assert np.isfinite(fields).all()
    ratio = fields.shape[2] / shown.seen.rgb.shape[1]
    assert ratio <= 1
    assert ratio * shown.seen.head.size == pytest.approx(
        min(shown.seen.head.size, SKIN_PRIOR.body_network.face_cells), rel=0.05
    )
    # beside the face's own colour, the face is near 0
    assert np.abs(np.median(fields[3:6][:, fields[7] > 0.9], axis=1)).max() < 0.2


def test_a_patch_of_wall_that_the_rules_took_is_no_skin_and_a_hole_in_a_neck_is(shown: Shown) -> None:
    size, nobody = shown.seen.head.size, shown.seen.person < 64
    away = cv2.distanceTransform(nobody.astype(np.uint8), cv2.DIST_L2, 5)
    row, column = np.unravel_index(np.argmax(away), away.shape)
    ys, xs = np.mgrid[: away.shape[0], : away.shape[1]]
    wall = np.hypot(xs - column, ys - row) < min(0.2 * size, away.max())
    neck = shown.skin & (shown.seen.head.places(shown.seen.face_mask.shape)[1] > 0.6)
    assert wall.sum() > 20
    assert neck.sum() > 20
    by_rules = np.where(shown.skin, 0.95, 0.02)
    by_rules[wall], by_rules[neck] = 0.9, 0.3
    found = shown.predicted(by_rules)
    assert (found[wall] > 0.5).mean() < 0.1
    assert (found[neck] > 0.5).mean() > 0.6


def test_what_is_right_stays(shown: Shown) -> None:
    """Around the head: hands, which two of the three show, are none of the face's mask, and are found anew."""
    by_rules = np.where(shown.skin, 0.95, 0.05).astype(np.float32)
    # in the face the networks do not count
    oval = shown.seen.head.of_oval(shown.skin.shape)
    there = (oval > SKIN_PRIOR.body_network.rise[0]) & (oval < _HANDS)
    found = shown.predicted(by_rules) > 0.5
    assert (found != shown.skin)[there].mean() < 0.02


def test_what_both_networks_say_counts_off_the_face_where_features_are_told(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = {"body_skin": 0.8, "body_things": 0.2}
    monkeypatch.setattr(
        body_network, "run_network", lambda name, fields, shape, *_, **__: np.full(shape, said[name], np.float32)
    )
    head = shown.seen.head  # as small as that of somebody far away
    beside = replace(shown.seen, head=replace(head, width=head.width / 6, height=head.height / 6))
    found = body_network.predict_body_skin(beside, shown.light, shown.skin.astype(np.float32))
    oval, ramp = beside.head.of_oval(found.shape), SKIN_PRIOR.body_network.seen_edge * beside.head.size
    inside = features_around(beside.rgb, beside.head).inside(shown.skin.shape, ramp)
    regions = {"face": (oval < 0.9, 0.8), "near": ((oval > 1.5) & (inside == 1), 0.5), "far": (inside == 0, 0.8)}
    for where, expected in regions.values():
        assert where.sum() > 10
        np.testing.assert_allclose(found[where], expected, atol=1e-5)
