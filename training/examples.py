"""Examples for the networks: what they would be shown on a labelled picture, and the labels over the same cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray

import pvg
from benchmarks.quality.clips import kept_asset
from benchmarks.quality.labels import NOT_SKIN, SKIN, Label, read_labels, read_picture
from benchmarks.quality.media import MEDIA, Half
from benchmarks.quality.regions import labels_of_half, tracked_face
from pvg._arrays import Bools, Floats
from pvg.face import Landmarks
from pvg.picture import Picture, as_picture
from pvg.raster import Raster
from pvg.rendering import source_frame
from pvg.skin import body_network, network
from pvg.skin.body import BodyTracker
from pvg.skin.features import features_around
from pvg.skin.learning import SkinModel, fit_skin_model
from pvg.skin.rasters import learning_raster
from pvg.skin.scene import SceneReader
from pvg.skin.tracking import SkinTracker
from training.pictures import FOLDER, Use, training_pictures, write_crop

KINDS = (*SKIN, *NOT_SKIN)
_KEYS = (-30, -90, 40)  # frames from a labelled one to others that a track may have learned on
_MOST_KEYS = 2
BODY_SIZE = 144, 112  # cells, what is kept of a scene around a head
_HEAD_ROW = 48  # of them, where its middle is
_NO_FEATURES = np.zeros((0, 1, 1), np.float32)
_CORE = 0.8  # of the face's oval, where its own colour is taken


@dataclass(frozen=True, eq=False)
class Labelled:
    """A labelled face: what examples are made of.

    person: as an example's;  masks: (H, W) bool each, of its labels;  keys: other frames that a track may have learned
    on.
    """

    person: str
    picture: Picture
    landmarks: Landmarks
    masks: list[Bools]
    keys: list[tuple[Picture, Landmarks]]


@dataclass(frozen=True, eq=False)
class Example:
    """What the network is shown of one face, and what is there.

    person: who, for those who are many do not count more;  at: "key" for a still or key frame, "track" for a frame
    that follows one, "body" for the scene around one;  fields: (h, w, network.FIELDS) float32;
    features: (h, w, FEATURES) float32 of a scene, see `pvg.skin.features`, without channels of a face's box;
    labels: (h, w, 1 + len(KINDS)) float32 shares: of `KINDS`, of skin this person's, then of anybody's skin;
    visible: (h, w) float32, what of a cell lies in the picture;  sample: (h, w) float32, where the skin's own colour
    is taken.
    """

    person: str
    at: str
    fields: Floats
    features: Floats
    labels: Floats
    visible: Floats
    sample: Floats


@dataclass
class _Recorder:
    """Stands for `network.predict_skin` or `body_network.predict_body_skin` and returns what the rules said.

    asked: the arguments of the last call, of which the last is the probability by the rules.
    """

    asked: tuple[Any, ...] | None = None

    def __call__(self, *asked: Any) -> Floats:
        self.asked = asked
        return np.asarray(asked[-1], np.float32)


def examples_of(face: Labelled) -> list[Example]:
    """The examples of one labelled face: as a key frame, and following itself and other key frames."""
    person, picture, landmarks, masks = face.person, face.picture, face.landmarks, face.masks
    recorder = _Recorder()
    with mock.patch.object(network, "predict_skin", recorder):
        model = fit_skin_model(picture, landmarks)
        if model.learned is None:
            raise ValueError("the paper's rule asks no network")
        raster = learning_raster(landmarks, bald=model.learned.bald)
        out = [_example(person, "key", raster, picture, masks, recorder)]
        for other in [model, *(fit_skin_model(*key) for key in face.keys)]:
            tracker = SkinTracker(other)
            tracker.step(picture, landmarks)
            if tracker.in_time is not None:
                out.append(_example(person, "track", tracker.in_time.raster, picture, masks, recorder))
    return out


def _example(
    person: str, at: str, raster: Raster, picture: Picture, masks: list[Bools], recorder: _Recorder
) -> Example:
    if recorder.asked is None:
        raise ValueError("the network was not asked")
    sample = recorder.asked[1].sample
    fields = network.network_fields(*recorder.asked)
    return _over_cells(person, at, (fields, _NO_FEATURES), raster, picture, masks, sample)


def _over_cells(
    person: str,
    at: str,
    shown: tuple[Floats, Floats],
    raster: Raster,
    picture: Picture,
    masks: list[Bools],
    sample: Bools,
) -> Example:
    """One example.

    shown: fields (FIELDS, h, w) and features (FEATURES or 0, h, w);  masks: (H, W) each, of the picture;
    sample: (h', w') of the raster.
    """
    size = shown[0].shape[:0:-1]

    def shares(values: NDArray[np.uint8]) -> Floats:
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA) / np.float32(255), np.float32)

    # three masks at a time, averaged over the cells as a picture is
    threes = [np.stack(masks[i : i + 3], axis=-1).astype(np.uint8) * np.uint8(255) for i in range(0, len(masks), 3)]
    labels = np.concatenate([shares(as_picture(three).cells(raster)) for three in threes], axis=2)
    visible = shares(raster.inside(picture.size).astype(np.uint8) * np.uint8(255))
    sampled = shares(sample.astype(np.uint8) * np.uint8(255))
    fields, features = (
        np.ascontiguousarray(np.broadcast_to(one, (len(one), *size[::-1])).transpose(1, 2, 0)) for one in shown
    )
    return Example(person, at, fields, features, labels, visible, sampled)


def body_examples_of(face: Labelled) -> list[Example]:
    """The scene around a labelled face, once by what was learned on itself and once by each other key frame."""
    models = [fit_skin_model(*key) for key in [(face.picture, face.landmarks), *face.keys]]
    return [_body_example(face, model) for model in models]


def _body_example(labelled: Labelled, model: SkinModel) -> Example:
    if model.learned is None:
        raise ValueError("the paper's rule asks no network")
    picture, landmarks = labelled.picture, labelled.landmarks
    scene = SceneReader().step(picture, (landmarks,))
    skin = SkinTracker(model)
    face = skin.step(picture, landmarks, scene)
    recorder = _Recorder()
    with mock.patch.object(body_network, "predict_body_skin", recorder):
        BodyTracker(model.learned).step(scene, landmarks, face, skin.light, skin.network_output)
    if recorder.asked is None:
        raise ValueError("the network was not asked")
    seen = recorder.asked[0]
    fields = body_network.body_fields(*recorder.asked)
    face_mask, head = seen.face_mask, seen.head
    core = head.of_oval(face_mask.shape) < _CORE
    features = features_around(seen.rgb, seen.head)
    shown = fields, body_network.over_fields(features, seen.face_mask.shape, fields)
    whole = _over_cells(labelled.person, "body", shown, scene.raster, picture, labelled.masks, core & (face_mask > 0.5))
    ratio = fields.shape[2] / face_mask.shape[1]
    return _around(whole, (float(head.middle[0]) * ratio, float(head.middle[1]) * ratio))


def _around(whole: Example, middle: tuple[float, float]) -> Example:
    """The part of `BODY_SIZE` around a head's middle (x, y), cells; beyond the scene nothing counts."""
    (height, width), (x, y) = BODY_SIZE, middle
    top, left = round(y) - _HEAD_ROW, round(x) - width // 2
    rows, columns = (np.arange(start, start + n) for start, n in ((top, height), (left, width)))
    h, w = whole.visible.shape
    inside = ((rows >= 0) & (rows < h))[:, None] & (columns >= 0) & (columns < w)
    near = np.ix_(np.clip(rows, 0, h - 1), np.clip(columns, 0, w - 1))
    return Example(
        whole.person,
        whole.at,
        whole.fields[near],
        whole.features[near],
        whole.labels[near] * inside[..., None],
        whole.visible[near] * inside,
        whole.sample[near] * inside,
    )


Maker = Callable[[Labelled], list[Example]]


def _masks(label: Label, person: int) -> list[Bools]:
    own = [label.mask((kind,), person if kind in SKIN else None) for kind in KINDS]
    return [*own, label.mask(SKIN)]


def of_benchmark(half: Half, assets: Path, make: Maker = examples_of) -> list[Example]:
    """The examples of the labels that the benchmark of quality has for one half of the clips and portraits."""
    out = []
    for label in labels_of_half(read_labels(), half):
        path = MEDIA / label.media
        with pvg.open_asset(kept_asset(path, assets), path) as video:
            for person in label.persons:
                found = tracked_face(video, label, person)
                if found is None:
                    continue
                face, data = found
                keys: list[tuple[Picture, Landmarks]] = []
                for frame in (label.frame + step for step in _KEYS):
                    other = video.face_at(face, frame) if 0 <= frame < video.frame_count else None
                    if other is not None and other.score > 0 and len(keys) < _MOST_KEYS:
                        keys.append((as_picture(source_frame(video, frame).rgb()), other.landmarks))
                picture = as_picture(source_frame(video, label.frame).rgb())
                name = f"{label.media.stem}, person {person}"
                out += make(Labelled(name, picture, data.landmarks, _masks(label, person), keys))
        print(f"{label.name}: {len(out)} examples", flush=True)
    return out


def of_packages(assets: Path, use: Use = "fit", make: Maker = examples_of) -> list[Example]:
    """The examples of the pictures in packages that networks are fitted to, or tested on."""
    out = []
    for one in training_pictures(use):
        path, label = FOLDER / f"{one.name}.png", one.label
        write_crop(one, path)
        with pvg.open_asset(kept_asset(path, assets), path) as video:
            found = tracked_face(video, label, 0)
            if found is None:
                print(f"{one.name}: no face")
                continue
        picture = as_picture(read_picture(path, 0))
        out += make(Labelled(one.name, picture, found[1].landmarks, _masks(label, 0), []))
        print(f"{one.name}: {len(out)} examples", flush=True)
    return out
