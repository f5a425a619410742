from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.curves import BOUNDARY, BOUNDARY_SAMPLES, CURVES, boundary_points, labels_by_length, place, table_labels
from pvg.face import Landmarks
from tests.gallery.faces import made_up_landmarks, rolled


def circle(face: Landmarks, radius: float) -> np.ndarray:
    return boundary_points(np.full(BOUNDARY_SAMPLES, radius, np.float32), face.axes)


def test_landmark_curves_pass_through_their_landmarks_at_fixed_parameters() -> None:
    face = made_up_landmarks()
    labels = table_labels()
    positions = place(labels, face, circle(face, 120))
    for c, curve in enumerate(CURVES):
        if not curve.knots:
            continue
        start, stop, closed = labels.spans[c]
        assert closed == curve.closed
        assert stop - start == len(positions[start:stop])
        pairs = [knot if isinstance(knot, tuple) else (knot, knot, 0.0) for knot in curve.knots]
        points = face.stacked
        knots = np.array([(1 - t) * points[i] + t * points[j] for i, j, t in pairs])
        np.testing.assert_allclose(positions[start : stop : curve.per_segment][: len(knots)], knots, atol=1e-3)


def test_the_same_label_is_the_same_place_of_the_face_in_every_pose() -> None:
    """Positions are linear in the landmarks: a similarity of the face is the same similarity of its curves."""
    one, two = made_up_landmarks(), made_up_landmarks(width=140.0, center=(90.0, 200.0), angle=0.4)
    positions = place(table_labels(), one, circle(one, 100))
    moved = place(table_labels(), two, circle(two, 70))
    expected = rolled((positions - (150, 160)) * 0.7, 0.4) + np.array([90, 200])
    np.testing.assert_allclose(moved, expected, atol=0.02)


def test_chain_labels_keep_the_curves_and_follow_their_length() -> None:
    small, large = made_up_landmarks(width=100.0), made_up_landmarks(width=300.0)
    few = labels_by_length(small, circle(small, 60), spacing_px=2.0)
    many = labels_by_length(large, circle(large, 180), spacing_px=2.0)
    assert len(few.spans) == len(many.spans) == len(CURVES)
    assert len(many) == pytest.approx(3 * len(few), rel=0.05)
    start, stop, _ = many.spans[BOUNDARY]
    length = cv2.arcLength(place(many, large, circle(large, 180))[start:stop], True)
    assert (stop - start) * 2.0 == pytest.approx(length, rel=0.02)


def test_open_skin_has_every_sample_of_the_skins_curves_but_the_mask_boundary() -> None:
    labels = table_labels()
    for c, (start, stop, _) in enumerate(labels.spans):
        assert (labels.on_open_skin[start:stop] == (CURVES[c].group == "skin" and c != BOUNDARY)).all()
    assert len(labels.on_open_skin) == len(labels)


def test_samples_are_found_by_the_name_of_their_curve_or_group() -> None:
    labels = table_labels()
    chin, lips = labels.on_curves("chin"), labels.on_curves("lips_outer", "lips_inner")
    assert {CURVES[c].name for c in labels.curve[chin]} == {"chin"}
    assert {CURVES[c].name for c in labels.curve[lips]} == {"lips_outer", "lips_inner"}
    np.testing.assert_array_equal(labels.on_group("lips"), lips)


def test_a_curve_or_group_of_no_such_name_is_refused() -> None:
    with pytest.raises(ValueError, match="beard"):
        table_labels().on_curves("chin", "beard")
    with pytest.raises(ValueError, match="not in"):
        table_labels().on_group("chin")
