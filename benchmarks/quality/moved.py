"""`python -m benchmarks.quality.moved`: how still a look lies on stills that move along a known path.

Optical flow tells only nearly how a clip's pictures moved, and the clips at hand are few. A still that is turned,
scaled and shifted by known amounts, with noise of its own in every frame, moves as it is known to: what a look changes
is brought back to the still, where it should lie still. Counted are pixels that blink, which are changed by `BLINK`
levels more, or less, than in the frames on both sides, for one frame or for two, and steps of more than `STEP` levels
from one frame to the next.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import pvg
from benchmarks.quality.faces import Bools, Floats, Image
from benchmarks.quality.lossless import at_most, write_lossless
from benchmarks.quality.media import choose, find_material
from pvg.video import read_frames, read_image

FRAMES = 48
BLINK, STEP = 8.0, 12.0  # levels of the channel that changes most
_LONGEST_PX = 960
_NOISE = 2.0  # levels, standard deviation
_SMOOTH = 2.0  # pixels, sigma: noise that a look enlarges is no blink
_EDGE = 8  # pixels along the picture's edge, where what is beyond is made up


def path_at(frame: int, width: int, height: int) -> Floats:
    """(2, 3) float64, from the still's pixels to those of a frame: a turn, a scale and a shift that come back."""
    turn = frame / FRAMES * 2 * np.pi
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), 4 * np.sin(2 * turn), 1.08 + 0.06 * np.sin(turn))
    matrix[:, 2] += 0.03 * width * np.sin(turn), 0.02 * height * np.sin(2 * turn + 1)
    return np.asarray(matrix, np.float64)


def moved_frames(still: Image) -> Iterator[Image]:
    """A still (h, w, 3), moved and with noise, in each frame."""
    height, width = still.shape[:2]
    noise = np.random.default_rng(1)
    for frame in range(FRAMES):
        matrix = path_at(frame, width, height)
        shown = cv2.warpAffine(still, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        yield np.clip(shown + noise.normal(0, _NOISE, (height, width, 1)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Stillness:
    """Pixels of the still a frame, in the mean: that blink for one frame, for two, and that take a step."""

    one: float
    two: float
    steps: float

    @classmethod
    def of(cls, changes: Floats, seen: Bools) -> Stillness:
        """changes: (n, h, w, 3) levels, in the still's pixels;  seen: (n, h, w) where they are known."""
        known = [seen[:-2] & seen[1:-1] & seen[2:], seen[:-3] & seen[1:-2] & seen[2:-1] & seen[3:]]
        one = _less_than_both(changes[1:-1] - changes[:-2], changes[1:-1] - changes[2:])
        two = _less_than_both(changes[1:-2] - changes[:-3], changes[2:-1] - changes[3:])
        steps = np.abs(np.diff(changes, axis=0)).max(axis=-1)
        blinks = [
            float(np.count_nonzero((each > BLINK) & where) / len(each))
            for each, where in zip((one, two), known, strict=True)
        ]
        blinks.append(float(np.count_nonzero((steps > STEP) & seen[1:] & seen[:-1]) / len(steps)))
        return cls(*blinks)


def _less_than_both(before: Floats, after: Floats) -> Floats:
    """(n, h, w) how far both differences (n, h, w, 3) go in the same direction, of the channel in which most."""
    less = np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), np.float32(0))
    return np.asarray(less.max(axis=-1), np.float32)


def changes_of(clip: Path, look: Path) -> tuple[Floats, Bools]:
    """What a look changes of a clip of `moved_frames`, in the still's pixels: see `Stillness.of`."""
    changes, seen = [], []
    for before, after in zip(read_frames(clip), read_frames(look), strict=True):
        rgb = before.rgb()
        height, width = rgb.shape[:2]
        back = path_at(before.index, width, height)
        changed = cv2.GaussianBlur(after.rgb().astype(np.float32) - rgb, (0, 0), _SMOOTH)
        within = np.zeros((height, width), np.float32)
        within[_EDGE:-_EDGE, _EDGE:-_EDGE] = 1
        within *= cv2.erode(cv2.warpAffine(np.ones_like(within), back, (width, height)), np.ones((9, 9)))
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        changes.append(np.asarray(cv2.warpAffine(changed, back, (width, height), flags=flags), np.float32))
        seen.append(cv2.warpAffine(within, back, (width, height), flags=flags) > 0.99)
    return np.stack(changes), np.stack(seen)


def measure(still: Path, reference: pvg.VectorVideo, folder: Path) -> Stillness:
    """How still a look of a reference lies on a still.  Raises `pvg.PvgError` where it shows no face."""
    clip, look = folder / f"{still.stem}.mp4", folder / f"{still.stem}.look.mkv"
    write_lossless(clip, moved_frames(at_most(read_image(still).rgb(), _LONGEST_PX)))
    with pvg.vectorize(clip, asset=folder / f"{still.stem}.pvg") as video:
        pvg.render(video, [pvg.transfer(video, reference)], [look])
    return Stillness.of(*changes_of(clip, look))


def main(argv: Sequence[str] | None = None) -> None:
    """Print a row for every still."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality.moved", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("--stills", type=Path, help="a folder of pictures; without it, the portraits")
    parser.add_argument("--names", help="comma-separated parts of their names")
    parser.add_argument("--reference", default="woman_pale_soft_light", help="part of a portrait's name")
    parser.add_argument("--keep", type=Path, help="folder for the clips and looks; without it, they go")
    args = parser.parse_args(argv)
    portraits = find_material().portraits
    (portrait,) = choose(portraits, args.reference)
    stills = tuple(sorted(args.stills.iterdir())) if args.stills else portraits
    print(f"{'still':40} {'blink':>7} {'for two':>7} {'steps':>7}   pixels a frame, {portrait.stem}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rows = []
        with pvg.vectorize(portrait, asset=folder / f"reference-{portrait.stem}.pvg", reference=True) as reference:
            for still in choose(stills, args.names):
                try:
                    rows.append(measure(still, reference, folder))
                except pvg.PvgError as error:
                    print(f"{still.stem:40} {error}", file=sys.stderr)
                    continue
                print(f"{still.stem:40} {rows[-1].one:7.1f} {rows[-1].two:7.1f} {rows[-1].steps:7.1f}", flush=True)
        if rows:
            means = np.mean([(row.one, row.two, row.steps) for row in rows], axis=0)
            print(f"{f'mean of {len(rows)}':40} {means[0]:7.1f} {means[1]:7.1f} {means[2]:7.1f}")


if __name__ == "__main__":
    main()
