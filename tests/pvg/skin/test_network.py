"""The network that refines masks: what it is shown, and that it mends what is wrong and leaves what is right."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks
from pvg.skin import face_box, network, skin_mask
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior, spatial_prior
from tests.conftest import Samples
from tests.gallery.faces import fit_widest, read_rgb
from tests.gallery.scenes import drawn_face


def test_a_face_is_shown_at_one_size_with_what_was_thought_last() -> None:
    for width in (80, 200):
        scene = drawn_face(width=width, center=(160, 150))
        prior = spatial_prior(scene.rgb.shape[:2], scene.landmarks)
        by_rules = scene.skin.astype(np.float32)
        fields = network.network_fields(scene.rgb, prior, by_rules)
        assert len(fields) == network.FIELDS
        ratio = fields.shape[2] / scene.rgb.shape[1]
        assert ratio * prior.size == pytest.approx(SKIN_PRIOR.network.face_cells, rel=0.02)
        assert (fields[-1] + 0.5).mean() == pytest.approx(by_rules.mean(), rel=0.05)
        # beside the skin's own colour, the skin is near 0
        assert np.abs(np.median(fields[3:6][:, fields[-1] > 0.4], axis=1)).max() < 0.15


@pytest.fixture(scope="module", params=["portrait", "dark_portrait", "pale_portrait"])
def face(request: pytest.FixtureRequest, samples: Samples) -> tuple[np.ndarray, Landmarks]:
    """A portrait in its face's box, and the landmarks."""
    rgb = read_rgb(getattr(samples, request.param))
    landmarks = fit_widest(rgb)
    x0, y0, x1, y1 = (max(0, int(v)) for v in face_box(landmarks))
    return np.ascontiguousarray(rgb[y0:y1, x0:x1]), landmarks.moved(-np.array([x0, y0], np.float32))


def _refined(rgb: np.ndarray, prior: SpatialPrior, probability: np.ndarray) -> np.ndarray:
    return network.fused(probability, network.predict_skin(rgb, prior, probability))


def test_a_hole_in_a_forehead_is_mended_and_a_patch_of_wall_is_no_skin(face: tuple[np.ndarray, Landmarks]) -> None:
    rgb, landmarks = face
    mask = skin_mask(rgb, landmarks)
    prior = spatial_prior(rgb.shape[:2], landmarks)
    by_rules = np.where(mask, 0.95, 0.05).astype(np.float32)
    axes, ys, xs = landmarks.axes, *np.mgrid[: rgb.shape[0], : rgb.shape[1]]

    def around(x: float, y: float) -> np.ndarray:
        return np.hypot(xs - x, ys - y) < 0.06 * prior.size

    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    row, column = np.unravel_index(np.argmax(away), away.shape)
    cheek, wall = around(*(axes.center + (0.25 * axes.across + 0.05 * axes.down) * prior.size)), around(column, row)
    assert mask[cheek].all()
    assert not mask[wall].any()
    spoiled = np.where(cheek, 0.2, np.where(wall, 0.8, by_rules)).astype(np.float32)
    found = _refined(rgb, prior, spoiled)
    assert (found[cheek] > 0.5).mean() > 0.9
    assert (found[wall] > 0.5).mean() < 0.1


def test_a_mask_that_is_right_stays(face: tuple[np.ndarray, Landmarks]) -> None:
    rgb, landmarks = face
    mask = skin_mask(rgb, landmarks)
    prior = spatial_prior(rgb.shape[:2], landmarks)
    found = _refined(rgb, prior, np.where(mask, 0.95, 0.05).astype(np.float32)) > 0.5
    assert (found & mask).sum() / (found | mask).sum() > 0.95
