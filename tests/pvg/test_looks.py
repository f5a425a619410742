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


def test_semantic_matching_takes_lips_towards_the_references_lips(
    video: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    """Most of the way, so they end nearer to those than to its skin, and keep their own shading."""
    look = pvg.transfer(video, pale_reference, match="semantic")
    lip = table_labels().group == GROUPS.index("lips")
    key, target = video.records[0].key_frames[0], pale_reference.records[0].key_frames[0]
    lips, skin = np.median(target.colors[target.visible & lip], axis=0), np.median(target.skin, axis=0)
    ours = np.median(look.colors[0][0][lip], axis=0)
    assert np.linalg.norm(ours - lips) < 0.5 * np.linalg.norm(ours - skin)
    before, after = key.colors[lip] - key.colors[lip].mean(axis=0), look.colors[0][0][lip]
    correlation = np.corrcoef(before.ravel(), (after - after.mean(axis=0)).ravel())[0, 1]
    assert correlation > 0.98


def test_a_flat_face_is_not_blotched_by_a_shaded_reference(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    """Skin-coloured curve samples keep their differences within the map's bounds: gain per channel times 1.25."""
    key = video.records[0].key_frames[0]
    new = pvg.transfer(video, dark_reference, match="semantic").colors[0][0]
    skin = (table_labels().group == GROUPS.index("skin")) & key.visible
    ratio = (np.median(new[skin], axis=0) + 8) / (np.median(key.colors[skin], axis=0) + 8)
    before, after = np.ptp(key.colors[skin], axis=0), np.ptp(new[skin], axis=0)
    assert (after <= 1.3 * ratio.max() * before + 1.0).all()


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
