"""`python -m benchmarks.quality.jumps`: where the change that a look makes jumps, though the picture does not.

From frame to frame what a look adds should move with the picture. Where the flow explains the picture, and what is
added is another all the same, a matte has opened or closed: a hand that kept its colour for some frames, a wall that
has a hand's glow after the hand has left. Given are level pixels a frame, by the channel that jumps most.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

import pvg
from benchmarks.quality.clips import kept_asset
from benchmarks.quality.faces import Floats, Image, Reference
from benchmarks.quality.lossless import at_most
from benchmarks.quality.measures import motion
from benchmarks.quality.media import HALVES, choose, find_material, half_of
from benchmarks.quality.regions import strong_references
from pvg.rendering import Renderer
from pvg.video import read_frames

_LONGEST_PX = 640
_SMOOTH = 2.0  # pixels, sigma, of both pictures and changes: noise is no jump
_SAME = 4.0  # levels that the picture may be off what the flow makes of the one before
_JUMP = 7.0  # levels
_LEAST_PX = 40  # of a part that jumps


def jumps(before: tuple[Image, Image], now: tuple[Image, Image]) -> Floats:
    """(h, w) levels by which the change jumps from one frame to the next, 0 where the picture itself does.

    before, now: the clip's picture and the look's, (h, w, 3) uint8.
    """
    moved = motion(before[0], now[0])
    was_shown, was_added = (moved.warp(one) for one in _smooth(before))
    shown, added = _smooth(now)
    off = np.abs(shown - was_shown).max(axis=2)
    jump = np.abs(added - was_added).max(axis=2)
    jump[~moved.certain | (off >= _SAME) | (jump <= _JUMP)] = 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats((jump > 0).view(np.uint8))
    small = np.flatnonzero(stats[:count, cv2.CC_STAT_AREA] < _LEAST_PX)
    jump[np.isin(labels, small)] = 0
    return np.asarray(jump, np.float32)


def _smooth(pictures: tuple[Image, Image]) -> tuple[Floats, Floats]:
    """A picture, and what the look adds to it, (h, w, 3) levels each."""
    shown, look = (one.astype(np.float32) for one in pictures)
    first, second = (cv2.GaussianBlur(one, (0, 0), _SMOOTH) for one in (shown, look - shown))
    return np.asarray(first, np.float32), np.asarray(second, np.float32)


def mean_jump(frames: Iterable[tuple[Image, Image]]) -> tuple[float, int]:
    """Level pixels a frame in the mean, and the frame with most of them; of the clip's pictures and the look's."""
    before, sums = None, [0.0]
    for now in frames:
        if before is not None:
            sums.append(float(jumps(before, now).sum()))
        before = now
    return float(np.mean(sums)), int(np.argmax(sums))


def measure(clip: Path, asset: Path, references: Sequence[Reference]) -> tuple[str, float, int]:
    """Of the reference that changes the clip's middle frame most: its name, and `mean_jump`."""
    with pvg.open_asset(asset, clip) as video:
        looks = [pvg.transfer(video, reference.video) for reference in references]
        middle = video.media.frame_count // 2
        plain = pvg.render_frame(video, None, middle).astype(np.float32)
        k = int(np.argmax([np.abs(pvg.render_frame(video, look, middle) - plain).mean() for look in looks]))
        renderer = Renderer(video, [looks[k]])
        drawn = ((frame, renderer.draw(frame)[0]) for frame in read_frames(clip))
        mean, worst = mean_jump(
            (at_most(frame.rgb(), _LONGEST_PX), at_most(result.rgb(), _LONGEST_PX)) for frame, result in drawn
        )
    return references[k].name, mean, worst


def main(argv: Sequence[str] | None = None) -> None:
    """Print a row for every clip."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality.jumps", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("--half", choices=HALVES, default="all")
    parser.add_argument("--names", help="comma-separated parts of the clips' names")
    parser.add_argument("--assets", type=Path, required=True, help="folder that keeps the assets")
    args = parser.parse_args(argv)
    args.assets.mkdir(parents=True, exist_ok=True)
    print(f"{'clip':52} {'a frame':>8} {'most in':>8}   with")
    with ExitStack() as stack:
        references = strong_references(args.assets, stack)
        for clip in choose(half_of(find_material().clips, args.half), args.names):
            reference, mean, worst = measure(clip, kept_asset(clip, args.assets), references)
            print(f"{clip.stem:52} {mean:8.0f} {worst:8}   {reference}", flush=True)


if __name__ == "__main__":
    main()
