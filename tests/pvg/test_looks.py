from __future__ import annotations

import numpy as np
import pytest

import pvg
from pvg.curves import GROUPS, table_labels


def test_the_same_seed_gives_the_same_look(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    one, two, other = (pvg.transfer(video, dark_reference, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.colors[0], two.colors[0])
    assert (one.colors[0] != other.colors[0]).any()


def test_strength_is_the_way_to_the_reference(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    g = video.records[0].key_frames[0].colors
    full, half = (pvg.transfer(video, dark_reference, strength=s).colors[0][0] for s in (1.0, 0.5))
    np.testing.assert_allclose(half, (g + full) / 2, atol=1e-3)


def test_semantic_matching_keeps_lips_redder_than_skin(video: pvg.VectorVideo, pale_reference: pvg.VectorVideo) -> None:
    """Lips go to the reference's lips: their colour ends nearer to those than to its skin."""
    look = pvg.transfer(video, pale_reference, match="semantic")
    group = table_labels().group
    target = pale_reference.records[0].key_frames[0]
    lips, skin = (target.colors[target.visible & (group == GROUPS.index(name))] for name in ("lips", "skin"))
    ours = look.colors[0][0][group == GROUPS.index("lips")].mean(axis=0)
    assert np.linalg.norm(ours - lips.mean(axis=0)) < 2.0
    assert np.linalg.norm(ours - lips.mean(axis=0)) < np.linalg.norm(ours - skin.mean(axis=0))


def test_new_colours_stay_colours(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    colors = pvg.transfer(video, dark_reference).colors[0]
    assert colors.min() >= 0
    assert colors.max() <= 255


def test_a_face_left_out_of_the_look_is_not_in_it(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    assert pvg.transfer(video, dark_reference, faces=[]).colors == {}
    assert set(pvg.transfer(video, dark_reference, faces=[0]).colors) == {0}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strength": 1.2}, "strength"),
        ({"strength": float("nan")}, "strength"),
        ({"contrast": 0.5}, "contrast"),
        ({"contrast": "much"}, "contrast"),
        ({"match": "hue"}, "match"),
        ({"protect": ["hair"]}, "protect"),
        ({"faces": [4]}, "no face 4"),
        ({"beta": 1.5}, "beta"),
        ({"iterations": -1}, "iterations"),
    ],
)
def test_parameters_out_of_range_are_named(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        pvg.transfer(video, dark_reference, **options)  # type: ignore[arg-type]
