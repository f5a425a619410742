"""Other pictures made of a labelled one: turned, lit otherwise, with other hair, cloth and walls, and other guesses.

Few people were labelled, so the labels themselves widen what they show: hair, cloth and what is behind are given other
colours, above all the skin's own, which is the hard case. The guess of the models is spoiled now and then, or the
network would learn to repeat it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.skin.parameters import SKIN_PRIOR
from training.examples import KINDS, Example

_DARK = SKIN_PRIOR.network.dark / 255
_COLORS, _PRIOR, _GUESS = slice(0, 3), 6, 11  # of the fields
_SKINS = slice(0, 5)  # of the labels
_EAR, _HAND, _HAIR, _CLOTH, _OTHER = (KINDS.index(kind) for kind in ("ear", "hand", "hair", "cloth", "other"))
_ANYBODY = -1
_SEPIA = 0.08  # how often a picture has one hue


@dataclass(frozen=True, eq=False)
class Sample:
    """One of a batch: fields (FIELDS, h, w), skin (h, w) shares and weight (h, w), how much each cell counts."""

    fields: Floats
    skin: Floats
    weight: Floats


def as_it_is(example: Example) -> Sample:
    """The example itself."""
    labels = example.labels
    weight = example.visible if example.at == "body" else example.visible * (1 - labels[..., _HAND])
    return Sample(np.ascontiguousarray(example.fields.transpose(2, 0, 1)), _skin(labels, example.at), weight)


def _skin(labels: Floats, at: str) -> Floats:
    """(h, w) shares of what is to be found: a person's own skin in the box of a face, anybody's in a scene."""
    return labels[..., _ANYBODY] if at == "body" else np.clip(labels[..., _SKINS].sum(axis=2), 0, 1)


def _weight(visible: Floats, labels: Floats, at: str) -> Floats:
    """How much each cell counts: ears, which are small, for three, and hands for three too.

    In the box of a face they count for none: they are skin, and none of the face's.
    """
    hands = 1 + 2 * labels[..., _HAND] if at == "body" else 1 - labels[..., _HAND]
    return np.asarray(visible * (1 + 2 * labels[..., _EAR]) * hands, np.float32)


def augmented(example: Example, others: list[Example], rng: np.random.Generator) -> Sample:
    """A picture that could have been; others: whose colours may lie behind it."""
    moved = _moved(example, rng)
    rgb, labels, guess = np.clip(moved.fields[..., _COLORS] + 0.5, 0, 1), moved.labels, moved.fields[..., _GUESS] + 0.5
    chance = rng.random()
    if chance < 0.25:
        rgb, labels, guess = _with_fringe(rgb, labels, guess, rng)
    elif chance < 0.42:
        rgb, labels, guess = _with_cap(rgb, labels, guess, rng)
    skin = _skin(labels, example.at)
    if rng.random() < 0.2:
        rgb = _other_skin(rgb, skin, rng)
    rgb = _recolored(rgb, labels, skin, others, rng)
    rgb = _lit(rgb, rng)
    own = rgb[moved.sample > 0.5]
    own = np.median(own if len(own) > 8 else rgb.reshape(-1, 3), axis=0)
    fields = moved.fields.copy()
    fields[..., _COLORS] = rgb - 0.5
    fields[..., 3:6] = np.log(rgb + _DARK) - np.log(own + _DARK)
    fields[..., _GUESS] = _spoiled(guess, fields[..., _PRIOR], rng) - 0.5
    return Sample(
        np.ascontiguousarray(fields.transpose(2, 0, 1), np.float32), skin, _weight(moved.visible, labels, example.at)
    )


def other_picture(rgb: Floats, labels: Floats, rng: np.random.Generator) -> Floats:
    """A whole picture (H, W, 3) in [0, 1] that could have been: other hair, cloth and walls, other light.

    labels: (H, W, …) shares, as an example's.
    """
    rgb = _recolored(rgb, labels, labels[..., _ANYBODY], [], rng)
    if rng.random() < 0.3:  # harsh, as apps have it
        rgb = np.asarray(rgb + rng.uniform(0.2, 0.8) * (3 * rgb**2 - 2 * rgb**3 - rgb), np.float32)
    return np.asarray(np.clip(_lit(rgb, rng), 0, 1), np.float32)


def _recolored(rgb: Floats, labels: Floats, skin: Floats, others: list[Example], rng: np.random.Generator) -> Floats:
    """The picture with hair, cloth and what is behind of other colours now and then, above all the skin's own."""
    for region, often, alike in ((_HAIR, 0.45, 0.7), (_CLOTH, 0.5, 0.6)):
        chance = rng.random()
        if chance < often:
            rgb = _other_color(rgb, labels[..., region], 1.2 if region == _HAIR else 1.5, rng)
        elif chance < alike:
            rgb = _color_of_skin(rgb, labels[..., region], skin, rng)
    if rng.random() < 0.35:
        behind = np.clip(1 - labels[..., [_ANYBODY, _HAIR, _CLOTH, _OTHER]].sum(axis=2), 0, 1)
        chance = rng.random()
        if chance < 0.4:
            rgb = _other_color(rgb, behind, 1.5, rng)
        elif chance < 0.6:
            rgb = _color_of_skin(rgb, behind, skin, rng)
        elif others:
            wall = others[rng.integers(len(others))].fields[..., _COLORS] + 0.5
            wall = np.asarray(cv2.GaussianBlur(wall, (0, 0), rng.uniform(2, 12)), np.float32)
            rgb = rgb + behind[..., None] * (wall - rgb)
    return rgb


def _moved(example: Example, rng: np.random.Generator) -> Example:
    """Turned by some 8°, 8 % larger or smaller, 6 % wider or narrower, four cells off, and mirrored or not."""
    h, w = example.visible.shape
    size = float(np.exp(rng.normal() * 0.08))
    turn = np.asarray(cv2.getRotationMatrix2D((w / 2, h / 2), rng.normal() * 8, size), np.float64)
    turn[:, 2] += rng.normal(size=2) * 4
    wider = float(np.exp(rng.normal() * 0.06))
    matrix = turn @ np.array([[wider, 0, (1 - wider) * w / 2], [0, 1, 0], [0, 0, 1]])
    if rng.random() < 0.5:
        matrix = matrix @ np.array([[-1, 0, w - 1], [0, 1, 0], [0, 0, 1.0]])

    def warped(values: Floats, border: int) -> Floats:
        layers = values.reshape(h, w, -1)
        parts = [
            cv2.warpAffine(
                np.ascontiguousarray(layers[..., i : i + 4]), matrix, (w, h), flags=cv2.INTER_LINEAR, borderMode=border
            ).reshape(h, w, -1)
            for i in range(0, layers.shape[2], 4)
        ]
        return np.asarray(np.concatenate(parts, axis=2).reshape(values.shape), np.float32)

    return Example(
        example.person,
        example.at,
        warped(example.fields, cv2.BORDER_REPLICATE),
        example.features[..., :0],
        warped(example.labels, cv2.BORDER_REPLICATE),
        warped(example.visible, cv2.BORDER_CONSTANT),
        warped(example.sample, cv2.BORDER_CONSTANT),
    )


def _cover(labels: Floats, low: float, high: float, rng: np.random.Generator) -> tuple[Floats, Floats] | None:
    """Where something lies over the head: (h, w) shares, and how far below its edge a cell is, in heights of the face.

    It ends at a share between low and high of the face's height, unevenly; None without a face.
    """
    rows, columns = np.nonzero(labels[..., KINDS.index("face")] > 0.5)
    if len(rows) < 200:
        return None
    h, w = labels.shape[:2]
    top, height = float(rows.min()), float(np.ptp(rows))
    x = np.arange(w, dtype=np.float32)
    bend = rng.normal() * 0.15 * ((x - columns.mean()) / max(float(np.ptp(columns)), 1)) ** 2 * 4
    slope = rng.normal() * 0.12 * (x - columns.mean()) / max(float(np.ptp(columns)), 1) * 2
    edge = top + height * (rng.uniform(low, high) + bend + slope)
    below = (np.arange(h, dtype=np.float32)[:, None] - edge) / height
    return np.asarray(np.clip(0.5 - below * height, 0, 1), np.float32), np.asarray(below, np.float32)


def _with_fringe(rgb: Floats, labels: Floats, guess: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Hair over the forehead, in strands, of the colour of this head's hair; seen by the models or not."""
    covered = _cover(labels, 0.02, 0.32, rng)
    if covered is None:
        return rgb, labels, guess
    h, w = guess.shape
    hair = rgb[labels[..., _HAIR] > 0.7]
    color = np.median(hair, axis=0) if len(hair) > 30 else rng.random(3) * 0.6
    # strands end at many heights, and no two are alike
    ends = rng.normal(size=(1, max(4, w // int(rng.integers(2, 9)))))
    lengths = cv2.resize(ends, (w, 1), interpolation=cv2.INTER_CUBIC)
    height = float(np.ptp(np.nonzero(labels[..., 0] > 0.5)[0]))
    there = np.clip(0.5 - (covered[1] + lengths * rng.uniform(0.01, 0.1)) * height, 0, 1)
    if rng.random() < 0.4:  # parted: some of the forehead stays bare
        bare = cv2.resize(rng.normal(size=(1, 5)), (w, 1), interpolation=cv2.INTER_CUBIC)
        there = there * np.clip(3 * (bare + rng.uniform(0, 1)), 0, 1)
    soft = np.asarray(cv2.GaussianBlur(there, (0, 0), rng.uniform(0.4, 0.9)), np.float32)
    grain = cv2.resize(rng.normal(size=(max(2, h // 24), w)), (w, h), interpolation=cv2.INTER_LINEAR)
    strands = np.clip(color * np.exp(grain * rng.uniform(0.1, 0.35))[..., None], 0, 1).astype(np.float32)
    rgb = rgb * (1 - 0.3 * rng.random() * np.clip(1 - covered[1] * 12, 0, 1) * (covered[1] > 0))[..., None]
    return _laid_over(rgb, strands, labels, guess, soft, _HAIR, rng)


def _with_cap(rgb: Floats, labels: Floats, guess: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """A cap or a scarf down to the forehead, and the deep shade under a brim, which is skin."""
    covered = _cover(labels, 0.0, 0.25, rng)
    if covered is None:
        return rgb, labels, guess
    there, below = covered
    soft = rng.uniform(0.02, 0.2)
    shade = np.clip((rng.uniform(0.04, 0.35) - below) / soft, 0, 1) * (below > -0.02)
    rgb = rgb * (1 - rng.uniform(0.2, 0.92) * shade)[..., None]
    guess = guess * (1 - rng.random() * shade)
    cloth = np.clip(rng.random(3) * np.exp(rng.normal(size=guess.shape) * 0.05)[..., None], 0, 1).astype(np.float32)
    return _laid_over(rgb, cloth, labels, guess, there, _CLOTH, rng)


def _laid_over(
    rgb: Floats, cover: Floats, labels: Floats, guess: Floats, there: Floats, kind: int, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Picture, labels and guess with something over them; the guess knows of it to any degree."""
    labels = labels * (1 - there[..., None])
    labels[..., kind] += there
    seen = there * (1 if rng.random() < 0.4 else rng.random())
    mixed = rgb + there[..., None] * (cover - rgb)
    return np.asarray(mixed, np.float32), labels, np.asarray(guess * (1 - seen), np.float32)


def _other_color(rgb: Floats, where: Floats, amount: float, rng: np.random.Generator) -> Floats:
    """The picture with what is `where` (h, w) brighter or darker, and now and then of any hue."""
    gain = np.exp(rng.normal(size=3) * 0.25 * amount + rng.normal() * 0.5 * amount)
    new = np.clip(np.clip(rgb, 1e-3, 1) ** np.exp(rng.normal() * 0.3 * amount) * gain, 0, 1)
    if rng.random() < 0.3:
        hue = rng.random(3)
        new = np.clip(new.mean(axis=2, keepdims=True) * hue / max(float(hue.mean()), 0.2), 0, 1)
    return np.asarray(rgb + where[..., None] * (new - rgb), np.float32)


def _other_skin(rgb: Floats, skin: Floats, rng: np.random.Generator) -> Floats:
    """The picture with skin of more or less pigment, above all of more: deep brown skin is rare among the labelled."""
    gain = np.exp((rng.normal() * 0.4 - 0.4) * np.array([0.8, 1.0, 1.1]) + rng.normal(size=3) * 0.05)
    return np.asarray(rgb + skin[..., None] * (np.clip(rgb * gain, 0, 1) - rgb), np.float32)


def _color_of_skin(rgb: Floats, where: Floats, skin: Floats, rng: np.random.Generator) -> Floats:
    """The picture with what is `where` (h, w) brought to the skin's colour, half of the way or all."""
    own, there = skin > 0.9, where > 0.5
    if min(int(own.sum()), int(there.sum())) < 20:
        return rgb
    gain = (np.median(rgb[own], axis=0) + 0.02) / (np.median(rgb[there], axis=0) + 0.02)
    new = np.clip(rgb * gain ** rng.uniform(0.5, 1) * np.exp(rng.normal() * 0.15), 0, 1)
    return np.asarray(rgb + where[..., None] * (new - rgb), np.float32)


def _lit(rgb: Floats, rng: np.random.Generator) -> Floats:
    """The picture in another light, with other exposure, grey or vivid, unsharp, noisy."""
    h, w = rgb.shape[:2]
    if rng.random() < 0.8:
        gain = np.exp(rng.normal(size=3) * 0.12 + rng.normal() * 0.2)
        rgb = np.clip(np.clip(rgb, 0, 1) ** np.exp(rng.normal() * 0.25) * gain, 0, 1)
    if rng.random() < 0.3:
        grey = rgb.mean(axis=2, keepdims=True)
        rgb = np.clip(grey + (rgb - grey) * rng.uniform(0.1, 1.4), 0, 1)
    if rng.random() < _SEPIA:
        hue = np.array([1.0, rng.uniform(0.75, 1.0), rng.uniform(0.45, 1.0)])
        rgb = np.clip(rgb.mean(axis=2, keepdims=True) * hue / hue.mean(), 0, 1)
    if rng.random() < 0.4:
        y, x = np.mgrid[:h, :w] / w - 0.5
        turn = rng.uniform(0, 2 * np.pi)
        slope = np.exp((x * np.cos(turn) + y * np.sin(turn)) * rng.normal() * 0.8)[..., None]
        rgb = np.clip(rgb * (slope ** (1 + rng.normal(size=3) * 0.5) if rng.random() < 0.4 else slope), 0, 1)
    if rng.random() < 0.5:
        rgb = np.asarray(cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.3, 1.2)), np.float32)
    if rng.random() < 0.5:
        rgb = np.clip(rgb + rng.normal(size=rgb.shape) * rng.uniform(0, 0.03), 0, 1)
    return cast(Floats, np.asarray(rgb, np.float32))


def _spoiled(guess: Floats, prior: Floats, rng: np.random.Generator) -> Floats:
    """The guess (h, w), or the prior's alone, or one with wrong patches; blurred or moved now and then."""
    h, w = guess.shape
    chance = rng.random()
    if chance < 0.1:
        return np.asarray(1 / (1 + np.exp(-4 * prior)), np.float32)
    if chance < 0.4:
        for _ in range(rng.integers(1, 4)):
            patch: NDArray[np.float32] = np.zeros((h, w), np.float32)
            center, axes = (int(rng.integers(w)), int(rng.integers(h))), tuple(int(v) for v in rng.integers(3, 17, 2))
            cv2.ellipse(patch, center, axes, rng.uniform(0, 180), 0, 360, 1, -1)
            patch = np.asarray(cv2.GaussianBlur(patch, (0, 0), rng.uniform(0.6, 2)), np.float32)
            guess = np.asarray(guess + patch * (rng.choice([0, 1, rng.random()]) - guess), np.float32)
    if rng.random() < 0.3:
        guess = np.asarray(cv2.GaussianBlur(guess, (0, 0), rng.uniform(0.5, 2.5)), np.float32)
    if rng.random() < 0.3:
        guess = np.roll(guess, tuple(int(v) for v in rng.integers(-3, 4, 2)), (0, 1))
    return guess
