"""What the mattes of the product hold of each labelled region, on pictures that no network was fitted to.

With `--cloth 1` their cloth has the skin's colour, with other numbers that much brighter or darker.

`python -m training.masks` vectorises the pictures of `training.pictures` that are for tests and prints, face's and
body's matte together, the share of each kind of skin with an alpha of at least ½, and of what is none of at least a
fifth.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np

import pvg
from benchmarks.quality.clips import kept_asset
from benchmarks.quality.labels import NOT_SKIN, SKIN, Label, read_picture
from pvg._arrays import Bytes, Floats
from training.pictures import FOLDER, training_pictures, write_crop

_SKIN_SHARE, _OTHER_SHARE = 0.5, 0.2
_LEAST_PIXELS = 30
_DARK, _SHADES = np.float32(20.0), (0.6, 1.4)  # what is left of the cloth's own light and shade
_AWAY = 0.02  # of the picture's longer side, between labelled people and background


def alpha_of(video: pvg.VectorVideo, size: tuple[int, int]) -> Floats:
    """(H, W) in [0, 1], all skin of everybody in the first frame; size: (width, height)."""
    xs, ys = (np.arange(length, dtype=np.float32) for length in size)
    alpha = np.zeros(size[::-1], np.float32)
    for face in range(len(video.faces)):
        found = video.face_at(face, 0)
        if found is not None:
            for matte in (found.matte, found.body):
                alpha = np.maximum(alpha, matte.alpha_at(xs, ys))
    return np.asarray(alpha, np.float32)


def shares(label: Label, alpha: Floats) -> dict[str, float]:
    """Of each kind of region that is seen, how much of it counts as skin."""
    regions = {kind: label.mask((kind,)) for kind in (*SKIN, *NOT_SKIN)}
    people = np.any(list(regions.values()), axis=0)
    away = cv2.distanceTransform((~people).astype(np.uint8), cv2.DIST_L2, 5) > _AWAY * max(label.size)
    regions["background"] = away
    least = {kind: _SKIN_SHARE if kind in SKIN else _OTHER_SHARE for kind in regions}
    return {
        kind: float((alpha[mask] >= least[kind]).mean())
        for kind, mask in regions.items()
        if int(mask.sum()) >= _LEAST_PIXELS
    }


def with_cloth_like_skin(rgb: Bytes, label: Label, brightness: float) -> Bytes:
    """The picture (H, W, 3) with all cloth of the skin's colour, so many times as bright; itself without cloth."""
    cloth, skin = label.mask(("cloth",)), label.mask(SKIN)
    if not cloth.any() or not skin.any():
        return rgb
    luma = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    shade = (luma + _DARK) / (np.median(luma[cloth]) + _DARK)
    own = np.median(rgb[skin], axis=0) * brightness
    new = own * np.clip(shade, *_SHADES)[..., None]
    there = cv2.GaussianBlur(cloth.astype(np.float32), (0, 0), 1.0)[..., None]
    return np.asarray(np.clip(rgb + there * (new - rgb), 0, 255).astype(np.uint8))


def main() -> None:
    """Print a line a picture, and the mean; see the module."""
    parser = argparse.ArgumentParser(prog="python -m training.masks", description=__doc__)
    parser.add_argument("--use", choices=("fit", "test"), default="test")
    parser.add_argument("--assets", type=Path, default=FOLDER / "assets")
    parser.add_argument("--cloth", type=float, help="how bright cloth of the skin's colour is, beside the skin")
    options = parser.parse_args()
    options.assets.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[float]] = defaultdict(list)
    for one in training_pictures(options.use):
        path = FOLDER / f"{one.name}.png"
        write_crop(one, path)
        if options.cloth is not None:
            rgb = with_cloth_like_skin(read_picture(path, 0), one.label, options.cloth)
            path = FOLDER / f"{one.name}-cloth-{options.cloth:g}.png"
            cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
        with pvg.open_asset(kept_asset(path, options.assets), path) as video:
            found = shares(one.label, alpha_of(video, one.label.size))
        for kind, share in found.items():
            rows[kind].append(share)
        print(f"{one.name}: " + ", ".join(f"{kind} {100 * share:.1f}" for kind, share in found.items()), flush=True)
    print("mean: " + ", ".join(f"{kind} {100 * np.mean(values):.1f}" for kind, values in rows.items()))


if __name__ == "__main__":
    main()
