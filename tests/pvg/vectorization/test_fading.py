from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.vectorization.fading import opacity
from tests.gallery.tracks import seen_track


def test_a_face_that_comes_and_goes_within_a_shot_fades_in_and_out() -> None:
    faded = opacity(seen_track([1.0] * 20), shots=(0,), frame_count=100)
    np.testing.assert_allclose(faded[:6], [0.2, 0.4, 0.6, 0.8, 1.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(faded[-6:], [1.0, 1.0, 0.8, 0.6, 0.4, 0.2], atol=1e-6)


def test_a_face_comes_and_goes_whole_at_a_cut_and_at_the_clips_ends() -> None:
    assert (opacity(seen_track([1.0] * 20), shots=(0, 10, 30), frame_count=100) == 1).all()
    assert (opacity(seen_track([1.0] * 20, first=0), shots=(0,), frame_count=20) == 1).all()
    assert (opacity(seen_track([1.0], first=0), shots=(0,), frame_count=1) == 1).all()
    walked_out = opacity(seen_track([1.0] * 20, first=0), shots=(0,), frame_count=100, left_picture=True)
    assert (walked_out == 1).all()


def test_a_lost_face_fades_out_before_the_loss_and_in_after_it() -> None:
    faded = opacity(seen_track([1.0] * 10 + [0.0] * 3 + [1.0] * 10), shots=(0, 10, 33), frame_count=100)
    assert (faded[10:13] == 0).all()
    np.testing.assert_allclose(faded[5:10], [1.0, 0.8, 0.6, 0.4, 0.2], atol=1e-6)
    np.testing.assert_allclose(faded[13:18], [0.2, 0.4, 0.6, 0.8, 1.0], atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(seen=st.lists(st.booleans(), min_size=1, max_size=40), cut=st.booleans())
def test_opacity_never_steps_by_more_than_a_fifth_and_is_zero_only_where_nothing_is_seen(
    seen: list[bool], cut: bool
) -> None:
    faded = opacity(seen_track([float(s) for s in seen]), shots=(0, 10) if cut else (0,), frame_count=100)
    assert len(faded) == len(seen)
    assert (np.abs(np.diff(faded)) <= 0.2 + 1e-6).all()
    np.testing.assert_array_equal(faded == 0, ~np.array(seen))
