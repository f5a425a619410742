from __future__ import annotations

import numpy as np
import pytest

import pvg
from pvg.rendering import LAYERS, placed_faces


@pytest.fixture(scope="module")
def layers(video: pvg.VectorVideo) -> dict[str, np.ndarray]:
    return {name: pvg.layer(video, 20, name) for name in LAYERS}


@pytest.fixture(scope="module")
def window(video: pvg.VectorVideo) -> tuple[slice, slice]:
    ((_, placed),) = placed_faces(video, 20)
    x0, y0, x1, y1 = placed.window
    return slice(y0, y1), slice(x0, x1)


def test_the_image_is_the_source(video: pvg.VectorVideo, layers: dict[str, np.ndarray]) -> None:
    np.testing.assert_array_equal(layers["image"], pvg.render_frame(video, None, 20))


def test_the_mask_is_white_on_the_faces_skin_and_black_outside_its_window(
    layers: dict[str, np.ndarray], window: tuple[slice, slice]
) -> None:
    outside = np.ones(layers["mask"].shape[:2], np.bool_)
    outside[window] = False
    assert set(np.unique(layers["mask"])) == {0, 255}
    assert not layers["mask"][outside].any()
    assert ((layers["mask"] > 0) == (layers["matte"] >= 128)).mean() > 0.99  # the matte's edge follows the picture's


def test_the_matte_has_all_skin_that_a_look_changes(
    dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    image, mask, matte = (pvg.layer(dark_reference, 0, name) for name in ("image", "mask", "matte"))
    drawn = pvg.render_frame(dark_reference, pvg.transfer(dark_reference, pale_reference), 0)
    changed, matte = (drawn != image).any(axis=2), matte[..., 0]
    assert matte[changed].all()
    assert changed[matte == 255].mean() > 0.99
    assert ((matte == 255) & (mask[..., 0] == 0)).sum() > 10_000  # neck and chest


def test_low_and_high_frequencies_add_up_to_the_image_on_skin(
    video: pvg.VectorVideo, layers: dict[str, np.ndarray]
) -> None:
    ((_, placed),) = placed_faces(video, 20)
    x0, y0, x1, y1 = placed.window
    skin = np.zeros(layers["image"].shape[:2], np.bool_)
    skin[y0:y1, x0:x1] = placed.alpha == 1  # of faces alone: at their edges a body's matte makes up for what they leave
    assert skin.sum() > 50_000
    added = layers["low"][skin].astype(int) + layers["high"][skin] - 128
    unclipped = (layers["high"][skin] > 0) & (layers["high"][skin] < 255) & (layers["low"][skin] < 255)
    assert unclipped.mean() > 0.9
    assert np.abs(added - layers["image"][skin])[unclipped].max() <= 1


def test_landmarks_and_curves_are_drawn_within_the_faces_window(
    layers: dict[str, np.ndarray], window: tuple[slice, slice]
) -> None:
    for name, ground in (("landmarks", layers["image"]), ("curves", layers["image"] // 3)):
        changed = (layers[name] != ground).any(axis=2)
        assert changed[window].mean() > 0.01
        changed[window] = False
        assert not changed.any()


def test_curves_have_their_boundary_colours(video: pvg.VectorVideo, layers: dict[str, np.ndarray]) -> None:
    ((_, placed),) = placed_faces(video, 20)
    record = video.records[0]
    wanted = record.blended([key.colors for key in record.key_frames], 20)[placed.labels.on_open_skin]
    x, y = np.rint(placed.positions[placed.labels.on_open_skin]).astype(int).T
    around = np.stack([layers["curves"][y + j, x + i] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    seen = np.take_along_axis(around, around.sum(axis=2, keepdims=True).argmax(axis=0)[None], axis=0)[0]
    assert np.median(np.abs(seen - wanted)) < 10  # lines of one pixel are soft


def test_an_unknown_layer_or_frame_is_named(video: pvg.VectorVideo) -> None:
    with pytest.raises(ValueError, match="no layer 'edges'"):
        pvg.layer(video, 0, "edges")
    with pytest.raises(ValueError, match="no frame 99"):
        pvg.layer(video, 99, "image")
