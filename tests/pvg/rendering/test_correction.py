from __future__ import annotations

import numpy as np
import pytest

from pvg.curves import table_labels
from pvg.looks import LookMap, SkinMap
from pvg.membrane import Membrane
from pvg.rendering.correction import at_curves, extend
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import PlacedFace
from tests.gallery.pictures import YUV444

TO_PLANES = YUV444.matrix.astype(np.float32).T


def colors(seed: int) -> np.ndarray:
    rgb = np.random.default_rng(seed).uniform(40, 220, (len(table_labels()), 3)).astype(np.float32)
    return rgb @ TO_PLANES


def a_map() -> MapTables:
    """Skin that becomes darker and less red."""
    rng = np.random.default_rng(9)
    skin = (np.array((190, 140, 110)) * rng.uniform(0.7, 1.3, (400, 1))).astype(np.float32)
    darker = SkinMap.between(skin, skin * np.array((0.5, 0.55, 0.6)))
    return MapTables.of(LookMap(darker, 1.0, np.ones((1, 5), np.float32)), YUV444)


@pytest.mark.parametrize("contrast", [1.0, 1.4, 0.7])
def test_the_shift_at_the_curves_is_what_the_contrast_leaves_to_the_new_colours(contrast: float) -> None:
    g, new = colors(0), colors(1)
    wanted = at_curves(g, new, contrast)
    np.testing.assert_allclose(wanted.shift + contrast * g, new, atol=1e-3)


def test_fewer_nodes_tell_a_maps_correction_as_well(placed: PlacedFace) -> None:
    """What is left beside F is smooth along the curves, so 128 nodes tell it to a part of a level."""
    x, y = ((placed.positions - placed.positions.mean(axis=0)) / placed.data.landmarks.axes.width).T
    light = np.random.default_rng(0).uniform(0.5, 1.1, (len(table_labels()), 1))
    g = (np.array((190, 140, 110)) * light).astype(np.float32) @ TO_PLANES
    left = np.stack([30 * x, 8 * y, -8 * x], axis=1).astype(np.float32)  # as large as looks leave
    wanted = at_curves(g, g + a_map().gained(g) + left, a_map())
    (ours,) = extend(placed, g, [wanted], level=1.0)
    fine = placed.membrane(wanted.shift, tolerance=0.05)
    assert ours.lattice == fine.lattice == placed.lattice()
    columns, rows = np.arange(placed.x, placed.window[2]), np.arange(placed.y, placed.window[3])
    off = np.abs(Membrane(ours.lattice, ours.shift).read(columns, rows) - fine.read(columns, rows))
    on_skin = placed.alpha > 0.5
    assert off[:, on_skin].mean(axis=1).max() < 0.15
    assert np.abs(wanted.shift).max() > 10


def test_corrections_solved_together_are_those_solved_alone(placed: PlacedFace) -> None:
    g = colors(0)
    wanted = [at_curves(g, colors(k + 1), contrast) for k, contrast in enumerate((1.0, 1.3, a_map()))]
    together = extend(placed, g, wanted, level=1.0)
    for one, ours in zip(wanted, together, strict=True):
        (alone,) = extend(placed, g, [one], level=1.0)
        np.testing.assert_array_equal(ours.shift, alone.shift)  # whatever others of either kind are there
        assert ours.contrast is alone.contrast is one.contrast
        assert ours.mapped == isinstance(one.contrast, MapTables)


def test_low_frequencies_are_solved_for_a_number_other_than_one_and_of_luma_alone_for_a_map(placed: PlacedFace) -> None:
    g = colors(0)
    plain, harder, mapped = (
        extend(placed, g, [at_curves(g, colors(1), contrast)], level=1.0)[0] for contrast in (1.0, 1.3, a_map())
    )
    assert plain.low is None
    assert mapped.low is None
    assert plain.around is None
    assert harder.around is None
    assert mapped.around is not None
    assert mapped.around.shape == mapped.shift.shape[1:]
    assert harder.low is not None
    assert harder.low.shape == harder.shift.shape == plain.shift.shape
