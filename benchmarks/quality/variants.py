"""Labelled pictures as another camera would have taken them, and what the mattes then hold of each region.

Labels stay valid where pixels keep their places, and under mirroring and scaling when a matte is brought back. No look
is drawn: of a look's change a part is the light's. `python -m benchmarks.quality.regions --variants` prints the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import pvg
from pvg.raster import on_copy

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]

PLAIN = "plain"
MUCH = 0.1  # of a region: less skin or more of others is listed
_REC709 = np.array([0.2126, 0.7152, 0.0722], np.float32)
_GAMMA = 2.2
_KNEE = 0.6  # of the light that saturates a sensor, where highlights begin to be compressed


@dataclass(frozen=True)
class Variant:
    """A way to have taken a picture.

    draw: (H, W, 3) RGB to the same taken otherwise;  scale: of its sides;  mirrored: whether left is right.
    """

    draw: Callable[[Image], Image]
    scale: float = 1.0
    mirrored: bool = False


def _levels(values: NDArray[Any]) -> Image:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def lit(*gain: float) -> Variant:
    """In light times a gain, one or one a channel; highlights beyond the knee are compressed, not cut."""

    def draw(picture: Image) -> Image:
        light = (picture / np.float32(255)) ** _GAMMA * np.array(gain, np.float32)
        over = np.maximum(light - _KNEE, 0) / (1 - _KNEE)
        soft = np.minimum(light, _KNEE) + (1 - _KNEE) * (1 - np.exp(-over))
        return _levels(255 * np.where(np.max(gain) > 1, soft, light) ** (1 / _GAMMA))

    return Variant(draw)


def saturated(share: float) -> Variant:
    """With chroma times a share."""

    def draw(picture: Image) -> Image:
        luma = (picture.astype(np.float32) @ _REC709)[..., None]
        return _levels(luma + share * (picture - luma))

    return Variant(draw)


def hazy(contrast: float, veil: float) -> Variant:
    """With less contrast, under a veil in levels."""
    return Variant(lambda picture: _levels(contrast * picture.astype(np.float32) + veil))


def noisy(gain: float, sigma: float) -> Variant:
    """In light times a gain, with noise of sigma levels."""

    def draw(picture: Image) -> Image:
        dim = lit(gain).draw(picture).astype(np.float32)
        return _levels(dim + np.random.default_rng(1).normal(0, sigma, picture.shape))

    return Variant(draw)


def coded(quality: int) -> Variant:
    """As a JPEG of a quality."""

    def draw(picture: Image) -> Image:
        _, data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.ascontiguousarray(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])

    return Variant(draw)


def smaller(scale: float) -> Variant:
    """With sides times a scale below 1."""

    def draw(picture: Image) -> Image:
        return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)

    return Variant(draw, scale=scale)


VARIANTS: Mapping[str, Variant] = {
    PLAIN: Variant(lambda picture: picture),
    "a little warm": lit(1.25, 1, 1 / 1.25),
    "a little cool": lit(1 / 1.25, 1, 1.25),
    "warm": lit(1.56, 1, 1 / 1.56),
    "cool": lit(1 / 1.56, 1, 1.56),
    "a stop under": lit(0.5),
    "a stop over": lit(2.0),
    "pale": saturated(0.6),
    "vivid": saturated(1.3),
    "mirrored": Variant(lambda picture: np.ascontiguousarray(picture[:, ::-1]), mirrored=True),
    "JPEG 15": coded(15),
    "half the size": smaller(0.5),
    "noise in dim": noisy(0.35, 6.0),
    "haze": hazy(0.55, 85.0),
}


def alpha_of(video: pvg.VectorVideo, variant: Variant, size: tuple[int, int]) -> Floats:
    """(H, W) in [0, 1], all skin of everybody in a variant's first frame, over the picture's own pixels.

    size: (width, height) of the picture.
    """
    xs, ys = (np.asarray(on_copy(np.arange(n), variant.scale), np.float32) for n in size)
    alpha = np.zeros(size[::-1], np.float32)
    for face in range(len(video.faces)):
        found = video.face_at(face, 0)
        for matte in () if found is None else (found.matte, found.body):
            alpha = np.maximum(alpha, matte.alpha_at(xs, ys))
    return np.asarray(alpha[:, ::-1] if variant.mirrored else alpha, np.float32)


@dataclass(frozen=True)
class Kept:
    """What a variant's matte holds of a person: picture: the person's;  shares: region -> share of its pixels."""

    picture: str
    variant: str
    shares: Mapping[str, float]


def _difference(one: Kept, plain: Mapping[str, Kept], region: str) -> float | None:
    before = plain.get(one.picture)
    if before is None or region not in one.shares or region not in before.shares:
        return None
    return one.shares[region] - before.shares[region]


def variants_table(found: Iterable[Kept], skin: Sequence[str], other: Sequence[str]) -> str:
    """Mean shares of each variant less those of the plain pictures, and what moved for the worse by much: Markdown.

    skin, other: the regions that are skin, and that are none.
    """
    every = list(found)
    plain = {one.picture: one for one in every if one.variant == PLAIN}
    regions = (*skin, *other)
    lines = ["| % | " + " | ".join(regions) + " | much worse |", "|" + "---|" * (len(regions) + 2)]
    worst: list[tuple[float, str]] = []
    for name in dict.fromkeys(one.variant for one in every):
        own = [one for one in every if one.variant == name]
        cells, count = [], 0
        for region in regions:
            moved = [(one, d) for one in own if (d := _difference(one, plain, region)) is not None]
            if not moved:
                cells.append("–")
                continue
            mean = float(np.mean([d for _, d in moved]))
            share = float(np.mean([one.shares[region] for one, _ in moved]))
            cells.append(f"{100 * share:.1f}" if name == PLAIN else f"{100 * mean:+.1f}")
            for one, d in moved:
                loss = -d if region in skin else d
                if loss >= MUCH:
                    count += 1
                    now, before = (100 * each.shares[region] for each in (one, plain[one.picture]))
                    worst.append((loss, f"- {one.picture}, {name}: {region} {before:.0f} → {now:.0f}"))
        lines.append("| " + " | ".join([name, *cells, "" if name == PLAIN else str(count)]) + " |")
    return "\n".join([*lines, "", *(text for _, text in sorted(worst, key=lambda one: -one[0]))])
