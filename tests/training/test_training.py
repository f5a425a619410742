"""What the skin network is trained on: the list, the labels, the examples and the pictures made of them."""

from __future__ import annotations

import re
from dataclasses import fields
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from benchmarks.quality.labels import SKIN, Label, Region, read_labels
from benchmarks.quality.regions import labels_of_half
from pvg.models.networks import OWN
from pvg.picture import as_picture
from pvg.skin.features import FEATURES
from pvg.skin.network import FIELDS
from tests.gallery.scenes import drawn_face
from training.augmentation import as_it_is, augmented
from training.example_files import load, save
from training.examples import BODY_SIZE, KINDS, Example, Labelled, body_examples_of, examples_of
from training.masks import shares, with_cloth_like_skin
from training.measuring import measured, predictor_of
from training.pictures import HERE, training_pictures
from training.variants import with_variants


def test_every_picture_of_the_list_has_its_label_and_no_label_is_without() -> None:
    pictures = training_pictures()
    assert {one.name for one in pictures} == {path.stem for path in (HERE / "labels").glob("*.json")}
    assert len({(one.sha256, one.frame, one.crop) for one in pictures}) == len(pictures)
    for one in pictures:
        label, (x0, y0, x1, y1) = one.label, one.crop
        assert label.size == (x1 - x0, y1 - y0), one.name
        assert label.mask(("face",), 0).any(), one.name
        assert "==" in one.package or "@" in one.package or one.package in {"samples", "media"}


@pytest.mark.usefixtures("media_dir")
def test_nothing_that_figures_are_reported_on_is_trained_on() -> None:
    unseen = {label.media.name for label in labels_of_half(read_labels(), "report")}
    assert unseen
    assert not unseen & {one.member.rsplit("/", 1)[-1] for one in training_pictures()}


@pytest.fixture(scope="module")
def example() -> Example:
    """The key frame of a drawn face, whose skin is known."""
    scene = drawn_face(width=120, center=(160, 150))
    face = scene.skin
    masks = [face, *[np.zeros_like(face) for _ in KINDS[1:]], face]
    key, track = examples_of(Labelled("drawn", as_picture(scene.rgb), scene.landmarks, masks, []))
    assert (key.at, track.at) == ("key", "track")
    return key


def test_labels_lie_over_the_cells_that_the_network_sees(example: Example) -> None:
    assert example.fields.shape == (*example.visible.shape, FIELDS)
    assert example.labels.shape == (*example.visible.shape, len(KINDS) + 1)
    sample = as_it_is(example)
    guess = sample.fields[-1] > 0
    both, either = guess & (sample.skin > 0.5), guess | (sample.skin > 0.5)
    assert both.sum() > 0.85 * either.sum()


def test_the_products_network_is_measured_on_examples_of_a_file(example: Example, tmp_path: Path) -> None:
    """Of a drawn face of one colour before one wall the guess is nearly right, and the network agrees."""
    save([example], tmp_path / "examples.npz")
    network = resources.files("pvg.models") / OWN["face_skin"].file
    said = measured(predictor_of(Path(str(network))), load([tmp_path / "examples.npz"]))
    assert [line.partition(":")[0] for line in said.splitlines()] == [
        f"{at} {who}" for at in ("all", "key") for who in ("both", "guess", "network")
    ]
    for line in said.splitlines():
        found = re.search(r"IoU ([\d.]+), worst IoU ([\d.]+) \(1 examples\)$", line)
        assert found, line
        assert found[1] == found[2], line
        assert float(found[1]) > 85, line


def test_augmented_pictures_differ_are_repeatable_and_keep_their_labels(example: Example) -> None:
    made = [augmented(example, [example], np.random.default_rng(seed)) for seed in range(24)]
    again = augmented(example, [example], np.random.default_rng(3))
    for field in fields(again):
        assert np.array_equal(getattr(again, field.name), getattr(made[3], field.name))
    assert len({one.fields[0].tobytes() for one in made}) == len(made)
    for one in made:
        assert np.isfinite(one.fields).all()
        assert one.fields.dtype == np.float32
        assert 0 <= one.skin.min() <= one.skin.max() <= 1
        assert 0.2 < one.skin.sum() / as_it_is(example).skin.sum() < 2
    # the guess is spoiled in some: it alone would not do
    off = [float(np.abs(one.fields[-1] + 0.5 - one.skin).mean()) for one in made]
    assert max(off) > 3 * min(off)


def test_a_hand_is_neither_skin_of_the_face_nor_none() -> None:
    labels = np.zeros((4, 4, len(KINDS) + 1), np.float32)
    labels[1, 1, SKIN.index("hand")] = 1
    blank = np.ones((4, 4), np.float32)
    hand = Example(
        "", "key", np.zeros((4, 4, FIELDS), np.float32), np.zeros((4, 4, 0), np.float32), labels, blank, blank
    )
    assert as_it_is(hand).weight[1, 1] == 0
    assert as_it_is(hand).weight[0, 0] == 1


def test_a_scene_is_kept_around_the_head_and_hands_count_there() -> None:
    scene = drawn_face(width=120, center=(160, 150))
    hand = np.zeros_like(scene.skin)
    hand[230:240, 20:40] = True
    masks = [np.zeros_like(hand) for _ in KINDS]
    masks[SKIN.index("face")], masks[SKIN.index("hand")] = scene.skin, hand
    (body,) = body_examples_of(
        Labelled("drawn", as_picture(scene.rgb), scene.landmarks, [*masks, scene.skin | hand], [])
    )
    assert body.at == "body"
    assert (body.fields.shape, body.features.shape) == ((*BODY_SIZE, FIELDS), (*BODY_SIZE, FEATURES))
    sample = as_it_is(body)
    face, there = body.labels[..., SKIN.index("face")] > 0.5, body.labels[..., SKIN.index("hand")] > 0.5
    assert there.any()
    assert sample.skin[there].min() > 0.5
    assert sample.weight[there].min() > 0.5
    # the head's middle is where it always is, beyond the picture nothing counts, the sample is of the face
    rows, columns = np.nonzero(face)
    assert abs(columns.mean() - BODY_SIZE[1] / 2) < 4
    assert 30 < rows.min() < 40  # half a face above row 48
    assert body.visible[-1].max() == 0
    assert face[body.sample > 0.5].mean() > 0.95


def test_variants_are_pictures_with_the_same_labels_and_repeatable() -> None:
    """What another network sees of them is told anew: it is no field of the picture as it was."""
    scene = drawn_face(width=120, center=(160, 150))
    picture, masks = as_picture(scene.rgb), [scene.skin, *[np.zeros_like(scene.skin)] * len(KINDS[1:]), scene.skin]
    make = with_variants(body_examples_of, 2)
    drawn = Labelled("drawn", picture, scene.landmarks, masks, [])
    first, *others = make(drawn)
    again = make(drawn)
    for one, same in zip([first, *others], again, strict=True):
        assert np.array_equal(one.fields, same.fields)
        assert np.array_equal(one.features, same.features)
    assert len(others) == 2
    for other in others:
        assert np.array_equal(other.labels, first.labels)
        assert np.abs(other.fields[..., :3] - first.fields[..., :3]).mean() > 0.005
        assert np.abs(other.features - first.features).mean() > 0.05


def test_shares_of_regions_are_of_what_later_ones_leave() -> None:
    square = np.array([[0, 0], [99, 0], [99, 99], [0, 99]], np.float32)
    regions = (Region("face", 0, square), Region("hair", 0, square * np.float32([1, 0.5])))
    label = Label("drawn", HERE, 0, (200, 100), regions)
    alpha = np.zeros((100, 200), np.float32)
    alpha[:, :50], alpha[:, 150:] = 1, 0.3
    found = shares(label, alpha)
    assert found["face"] == pytest.approx(0.5, abs=0.02)
    assert found["hair"] == pytest.approx(0.5, abs=0.02)
    assert found["background"] == pytest.approx(50 / 96, abs=0.02)
    assert "hand" not in found


def test_cloth_is_given_the_skins_colour_and_keeps_its_folds() -> None:
    square = np.array([[0, 0], [99, 0], [99, 99], [0, 99]], np.float32)
    beside = square + np.array((100, 0), np.float32)
    regions = (Region("face", 0, square * np.float32([1, 0.5])), Region("cloth", 0, beside))
    label = Label("drawn", HERE, 0, (200, 100), regions)
    rgb = np.full((100, 200, 3), 40, np.uint8)
    rgb[:50, :100] = 200, 150, 120
    rgb[:, 150:] = 60  # a fold
    made = with_cloth_like_skin(rgb, label, 0.5)
    np.testing.assert_allclose(made[50, 125], [84, 63, 50], atol=4)  # its middle shade lies between both
    assert made[50, 175, 0] > made[50, 125, 0] + 15
    np.testing.assert_array_equal(made[:, :90], rgb[:, :90])
    bare = Label("drawn", HERE, 0, (200, 100), regions[:1])
    np.testing.assert_array_equal(with_cloth_like_skin(rgb, bare, 0.5), rgb)
