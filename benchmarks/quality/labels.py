"""Hand-drawn labels of skin, hair and cloth, and the two pictures they were drawn with.

A label is a JSON file under benchmarks/labels:

    {"media": "clips/NAME.mp4", "frame": 40, "size": [512, 512],
     "regions": [{"kind": "face", "person": 0, "polygon": [[x, y], ...]}, ...]}

Coordinates are pixels of the upright frame, later regions cover earlier ones. All skin of everybody in the picture is
labelled, so that what lies in no region is no skin. A region's kind is one of `SKIN` or of `NOT_SKIN`; those of the
second say where skin ends: the hair line, a collar, glasses, whatever stands in front of a face.

`python -m benchmarks.quality.labels grid MEDIA OUT.png` enlarges a picture or a part of it under a grid of coordinates,
to read points off; `... draw LABEL.json OUT.png` draws a label back.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.quality.media import MEDIA
from pvg.video import read_frames, read_image
from scripts.samples import REPOSITORY

LABELS = REPOSITORY / "benchmarks" / "labels"
SKIN = ("face", "ear", "neck", "body", "hand")
NOT_SKIN = ("hair", "cloth", "other")
_CLIPS = (".mp4", ".mov", ".webm", ".mkv")
_SHIFT = 4  # polygons are drawn to a sixteenth of a pixel
_LONGEST_PX = 1400  # of an enlarged part
_COLORS = {
    "face": (60, 255, 60),
    "ear": (255, 160, 0),
    "neck": (0, 200, 255),
    "body": (255, 255, 0),
    "hand": (255, 0, 255),
    "hair": (255, 60, 60),
    "cloth": (60, 60, 255),
    "other": (255, 255, 255),
}

Image = NDArray[np.uint8]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Region:
    """A labelled polygon: points (n, 2) float32 of the upright frame."""

    kind: str
    person: int
    polygon: NDArray[np.float32]


@dataclass(frozen=True)
class Label:
    """The labelled regions of one frame (0 for a still) of a file below the media folder; size: (width, height)."""

    name: str
    media: Path
    frame: int
    size: tuple[int, int]
    regions: tuple[Region, ...]

    def mask(self, kinds: Iterable[str], person: int | None = None) -> Bools:
        """(H, W) bool, the regions of these kinds (of one person when given) less what covers them."""
        wanted = set(kinds)
        out = np.zeros((self.size[1], self.size[0]), np.uint8)
        for region in self.regions:
            inside = region.kind in wanted and (person is None or region.person == person)
            corners = np.rint(region.polygon * 2**_SHIFT).astype(np.int32)
            cv2.fillPoly(out, [corners], (int(inside),), shift=_SHIFT)
        return out.astype(np.bool_)

    @property
    def persons(self) -> list[int]:
        """The people of whom skin is labelled."""
        return sorted({region.person for region in self.regions if region.kind in SKIN})

    def picture(self, media: Path = MEDIA) -> Image:
        """(H, W, 3) uint8 RGB, the labelled frame."""
        return read_picture(media / self.media, self.frame)


def read_picture(path: Path, frame: int) -> Image:
    """(H, W, 3) uint8 RGB, one frame of a clip, or a still."""
    if path.suffix not in _CLIPS:
        return read_image(path).rgb()
    return next(iter(read_frames(path, start=frame, stop=frame + 1))).rgb()


def read_label(path: Path) -> Label:
    """A label file. Raises `ValueError` on a kind that is not known or a polygon of fewer than three points."""
    raw: dict[str, Any] = json.loads(path.read_text())
    regions = []
    for one in raw["regions"]:
        polygon = np.array(one["polygon"], np.float32).reshape(-1, 2)
        if one["kind"] not in SKIN + NOT_SKIN or len(polygon) < 3:
            raise ValueError(f"{path.name}: {one['kind']!r} with {len(polygon)} points")
        regions.append(Region(one["kind"], int(one.get("person", 0)), polygon))
    width, height = raw["size"]
    return Label(path.stem, Path(raw["media"]), int(raw["frame"]), (int(width), int(height)), tuple(regions))


def read_labels(folder: Path = LABELS) -> list[Label]:
    """All labels, by name."""
    return [read_label(path) for path in sorted(folder.glob("*.json"))]


def _enlarged(picture: Image, part: tuple[int, int, int, int]) -> tuple[Image, float]:
    x0, y0, x1, y1 = part
    scale = _LONGEST_PX / max(x1 - x0, y1 - y0)
    cut = picture[y0:y1, x0:x1]
    how = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    return np.asarray(cv2.resize(cut, None, fx=scale, fy=scale, interpolation=how), np.uint8), scale


def draw_grid(picture: Image, part: tuple[int, int, int, int]) -> Image:
    """The part (x0, y0, x1, y1) of a picture, enlarged, with lines and numbers of its coordinates."""
    out, scale = _enlarged(picture, part)
    x0, y0, x1, y1 = part
    step = next(s for s in (5, 10, 20, 25, 50, 100, 200) if s * scale >= 45)
    for axis, (low, high) in enumerate(((x0, x1), (y0, y1))):
        for value in range(-(-low // step) * step, high, step):
            at = round((value + 0.5 - low) * scale)
            ends = ((at, 0), (at, out.shape[0])) if axis == 0 else ((0, at), (out.shape[1], at))
            shade = 255 if value % (2 * step) == 0 else 0
            layer = out.copy()
            cv2.line(layer, ends[0], ends[1], (shade,) * 3, 1)
            out = np.asarray(cv2.addWeighted(layer, 0.55, out, 0.45, 0), np.uint8)
            if value % (2 * step) == 0:
                for place in ((at + 2, 12), (at + 2, out.shape[0] // 2)) if axis == 0 else ((2, at - 2),):
                    cv2.putText(out, str(value), place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 3, cv2.LINE_AA)
                    cv2.putText(out, str(value), place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 0), 1, cv2.LINE_AA)
    return out


def draw_label(label: Label, picture: Image, part: tuple[int, int, int, int]) -> Image:
    """The part of a picture, enlarged, with the outlines of the label's regions."""
    out, scale = _enlarged(picture, part)
    corner = np.array(part[:2], np.float32)
    for region in label.regions:
        corners = np.rint((region.polygon + 0.5 - corner) * scale * 2**_SHIFT).astype(np.int32)
        cv2.polylines(out, [corners], True, _COLORS[region.kind], 2, cv2.LINE_AA, _SHIFT)
    return out


def main() -> None:
    """Draw one picture; see the module."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality.labels", description=__doc__)
    parser.add_argument("what", choices=("grid", "draw"))
    parser.add_argument("path", type=Path, help="a file below the media folder, or a label")
    parser.add_argument("out", type=Path)
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--part", help="x0,y0,x1,y1; the whole picture when left out")
    options = parser.parse_args()
    label = read_label(options.path) if options.what == "draw" else None
    picture = read_picture(MEDIA / options.path, options.frame) if label is None else label.picture()
    height, width = picture.shape[:2]
    x0, y0, x1, y1 = (int(v) for v in options.part.split(",")) if options.part else (0, 0, width, height)
    part = max(0, x0), max(0, y0), min(x1, width), min(y1, height)
    drawn = draw_grid(picture, part) if label is None else draw_label(label, picture, part)
    cv2.imwrite(str(options.out), cv2.cvtColor(drawn, cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    main()
