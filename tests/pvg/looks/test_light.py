from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.face import layout
from pvg.looks.light import light_ratio, relit
from tests.gallery.assets import key_frame


def _lit(sideways: float, downwards: float) -> KeyFrame:
    """A face of one colour whose skin is brighter the more it looks to the image's right, or down."""
    labels = table_labels()
    on_skin = np.flatnonzero(labels.on_open_skin)
    at = np.random.default_rng(1).choice(on_skin, 400).astype(np.int16)
    azimuth, elevation = (np.radians(labels.basis @ angles) for angles in (layout.AZIMUTH_DEG, layout.ELEVATION_DEG))
    light = np.exp(sideways * np.sin(azimuth) * np.cos(elevation) + downwards * np.sin(elevation))
    skin = (np.float32([150, 115, 100]) * light[at][:, None]).astype(np.float32)
    return replace(key_frame(), skin=skin, skin_at=at)


@pytest.mark.parametrize(("sideways", "downwards"), [(0.4, 0.0), (-0.4, 0.0), (0.2, 0.5)])
def test_a_flatly_lit_face_takes_the_references_light(sideways: float, downwards: float) -> None:
    ours, theirs = _lit(0.0, 0.0), _lit(sideways, downwards)
    new = relit(ours, light_ratio(ours, theirs, 1.0))
    before, after = np.log(new.skin[:, 1]), np.log(_lit(sideways, downwards).skin[:, 1])
    assert np.corrcoef(before, after)[0, 1] > 0.95
    assert np.polyfit(after, before, 1)[0] == pytest.approx(1.0, abs=0.25)


def test_its_strength_is_a_power_and_none_changes_nothing() -> None:
    ours, theirs = _lit(-0.3, 0.1), _lit(0.3, 0.0)
    whole, half = (np.log(light_ratio(ours, theirs, strength)) for strength in (1.0, 0.5))
    np.testing.assert_allclose(half, whole / 2, atol=1e-5)
    assert (light_ratio(ours, theirs, 0.0) == 1.0).all()
    assert relit(ours, light_ratio(ours, theirs, 0.0)) is ours
    np.testing.assert_allclose(light_ratio(theirs, theirs, 1.0), 1.0, atol=1e-5)


def test_without_enough_skin_the_light_stays() -> None:
    ours = _lit(0.0, 0.0)
    bare = replace(ours, skin=ours.skin[:5], skin_at=ours.skin_at[:5])
    assert (light_ratio(bare, ours, 1.0) == 1.0).all()
    assert (light_ratio(ours, bare, 1.0) == 1.0).all()
