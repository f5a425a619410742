from __future__ import annotations

import numpy as np
import pytest

import pvg
from pvg.looks import Look
from pvg.looks.look import LookMap


def colors(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (2, 7, 3)).astype(np.float32)


A_MAP = LookMap(None, 1.0, np.ones((2, 2), np.float32))  # type: ignore[arg-type]


def test_looks_of_different_faces_become_one() -> None:
    one, two = Look({0: colors(0)}, 0.8), Look({3: colors(3)}, {3: "map"}, maps={3: A_MAP})
    for both in (one.merged(two), two.merged(one)):
        assert set(both.colors) == {0, 3}
        assert both.contrast_of(0) == 0.8
        assert both.contrast_of(3) == "map"
        np.testing.assert_array_equal(both.colors[0], one.colors[0])
        np.testing.assert_array_equal(both.colors[3], two.colors[3])


def test_a_contrast_may_be_any_number() -> None:
    for number in (1, np.float32(1.0), {0: 1}):
        contrast = Look({0: colors(0)}, number).contrast_of(0)  # type: ignore[arg-type]
        assert (type(contrast), contrast) == (float, 1.0)


@pytest.mark.parametrize(
    ("given", "contrast", "words"),
    [
        ({0: colors(0)}, "auto", "contrast must be a number from 0.7 to 1.5, not 'auto'"),
        ({0: colors(0)}, None, "contrast must be a number"),
        ({0: colors(0)}, float("nan"), "contrast must be a number"),
        ({0: colors(0)}, {0: "auto"}, "contrast must be a number"),
        ({0: colors(0)}, {1: 1.0}, "contrast has nothing for face 0"),
        ({0: colors(0)[0]}, 1.0, r"the colors of face 0 must have the shape \(K, S, 3\), not \(7, 3\)"),
        ({0: None}, 1.0, "the colors of face 0"),
        (colors(0), 1.0, "colors must be by face"),
    ],
)
def test_what_is_no_look_is_refused(given: object, contrast: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Look(given, contrast)  # type: ignore[arg-type]


def test_parts_and_protected_features_that_nobody_knows_are_refused() -> None:
    with pytest.raises(ValueError, match=r"the parts of face 0 must have the shape \(K, 4, 3\), not \(2, 3, 3\)"):
        Look({0: colors(0)}, parts={0: np.zeros((2, 3, 3), np.float32)})
    for given, words in (("eyes", "protect must be a sequence"), (["ears"], "cannot protect 'ears'")):
        with pytest.raises(ValueError, match=words):
            Look({0: colors(0)}, protect=given)  # type: ignore[arg-type]


def test_a_look_may_be_given_as_lists(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    made = pvg.transfer(video, dark_reference, contrast=1.0, extent="face", protect=["eyes"])
    parts = {face: one.tolist() for face, one in made.parts.items()}
    by_hand = Look({0: made.colors[0].tolist()}, protect=["eyes"], parts=parts)  # type: ignore[arg-type]
    np.testing.assert_array_equal(pvg.render_frame(video, by_hand, 3), pvg.render_frame(video, made, 3))


def test_a_look_that_does_not_fit_the_clip_is_refused(video: pvg.VectorVideo) -> None:
    own = np.stack([key.colors for key in video.records[0].key_frames])
    for look in (
        Look({"0": own}),  # type: ignore[dict-item]
        Look({0: own[:, 1:]}),
        Look({0: own}, parts={0: np.zeros((len(own) + 1, 4, 3), np.float32)}),
    ):
        with pytest.raises(ValueError, match="the look does not fit face 0"):
            look.check_fits(video)


def test_a_look_needs_the_maps_that_it_is_drawn_by() -> None:
    both = {0: colors(0), 1: colors(1)}
    with pytest.raises(ValueError, match='maps has nothing for face 1, but contrast is "map"'):
        Look(both, {0: "map", 1: "map"}, maps={0: A_MAP})
    with pytest.raises(ValueError, match="maps has nothing for face 0, but its body goes along"):
        Look(both, body=frozenset({0}))
    assert Look(both, {0: "map", 1: 1.0}, maps={0: A_MAP}, body=frozenset({0})).maps == {0: A_MAP}


def test_what_cannot_be_drawn_together_is_refused() -> None:
    with pytest.raises(ValueError, match="both looks change face 1"):
        Look({0: colors(0), 1: colors(1)}).merged(Look({1: colors(1)}))
    with pytest.raises(ValueError, match="protect"):
        Look({0: colors(0)}).merged(Look({1: colors(1)}, protect=()))
    with pytest.raises(ValueError, match="different clips"):
        Look({0: colors(0)}, source_sha256="a").merged(Look({1: colors(1)}, source_sha256="b"))
