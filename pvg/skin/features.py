"""What a network that knows a thousand kinds of things sees around a head: features of hair, cloth, skin and walls.

EfficientNet-Lite0 (Tan and Le, ICML 2019) was trained to tell what pictures show. What its middle layers answer to,
strands, weave, folds and skin, colour and place alone do not tell, and some sixty labelled people are too few to learn
it from. The network is cut off behind those layers (`pvg.models.networks`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pvg import models
from pvg._arrays import Bytes, Doubles, Floats
from pvg._bilinear import read_grid
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape

_BODY, _NETWORK, _COMPONENTS = SKIN_PRIOR.body_network, "efficientnet_lite0", "body_components"
_SIDE = 224  # pixels a side of what the network sees
_ZERO, _UNIT = np.float32(127), np.float32(1 / 128)  # how its inputs are scaled: by its model card
CHANNELS = 40, 112
"""How many features there are: of its layers at an eighth and at a sixteenth of the resolution."""
SIDES = _SIDE // 8, _SIDE // 16
"""Places a side of the maps of those layers."""
FEATURES = sum(CHANNELS)


@dataclass(frozen=True, eq=False)
class Features:
    """Maps (c, n, n) float32 over a square of the cells of a scene.

    left, top: of the square, cells from the scene's corner;  side: its length, cells.
    """

    left: float
    top: float
    side: float
    maps: tuple[Floats, ...]

    def over(self, columns: Doubles, rows: Doubles) -> Floats:
        """(c, h, w) float32 of all maps at the places of columns (w,) and rows (h,), cells; outside, the edge."""
        out = np.empty((sum(map(len, self.maps)), len(rows), len(columns)), np.float32)
        to = iter(out)
        for maps in self.maps:
            step = self.side / maps.shape[1]
            xs, ys = ((at - start) / step - 0.5 for at, start in ((columns, self.left), (rows, self.top)))
            for plane in maps:
                read_grid(plane, xs, ys, next(to))
        return out

    def components(self) -> Features:
        """The few components of each map that the network of the body is shown, by weights that are fitted with it.

        They are linear, so that they are the same whether they are taken of maps or of what is read from those; and
        maps have a tenth of the places. Raises ModelError when the weights are altered.
        """
        session = models.load(_COMPONENTS)
        shown = {one.name: maps[None] for one, maps in zip(session.get_inputs(), self.maps, strict=True)}
        return replace(self, maps=tuple(found[0] for found in session.run(None, shown)))

    def inside(self, shape: tuple[int, int], ramp: float) -> Floats:
        """(h, w) float32 in [0, 1] over the cells of the scene: how far inside the square each lies.

        0 from its ends on and 1 from `ramp` cells within, where the scene goes on for as much; where it ends with the
        square, nothing is lost.
        """

        def along(start: float, length: int) -> Floats:
            at = np.arange(length, dtype=np.float32) + np.float32(0.5)
            end = start + self.side
            low, high = (
                np.clip((off + max(ramp - beyond, 0.0)) / ramp, 0, 1)
                for off, beyond in ((at - start, start), (end - at, length - end))
            )
            return np.asarray(low * high, np.float32)

        return np.minimum(along(self.top, shape[0])[:, None], along(self.left, shape[1]))


def features_around(rgb: Bytes, head: HeadShape) -> Features:
    """Features around a head in a scene (h, w, 3) uint8 RGB: some face sizes a side, or the scene where it is smaller.

    Raises ModelError when the weights are not installed.
    """
    h, w = rgb.shape[:2]
    side = min(_BODY.seen_sizes * head.size, float(max(h, w)))
    middle = head.middle + np.array([0, _BODY.seen_below * head.size], np.float32)
    left, top = (_start(float(at), side, length) for at, length in zip(middle, (w, h), strict=True))
    step = side / _SIDE
    # shrunk by areas first where a cell of the network's is more than one of the scene's
    ratio = min(1.0, 1 / step)
    small = cv2.resize(rgb, (max(1, round(w * ratio)), max(1, round(h * ratio))), interpolation=cv2.INTER_AREA)
    across, down = small.shape[1] / w, small.shape[0] / h
    to_scene = np.array(
        [[step * across, 0, (left + step / 2) * across - 0.5], [0, step * down, (top + step / 2) * down - 0.5]]
    )
    square = cv2.warpAffine(
        small,
        to_scene,
        (_SIDE, _SIDE),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(127, 127, 127),
    )
    session = models.load(_NETWORK)
    found = session.run(None, {session.get_inputs()[0].name: (square[None] - _ZERO) * _UNIT})
    maps = tuple(np.ascontiguousarray(one[0].transpose(2, 0, 1), np.float32) for one in found)
    return Features(left, top, side, maps)


def _start(middle: float, side: float, length: int) -> float:
    """Where a side around a middle begins: within 0 and `length`, in whose middle it lies if it is longer."""
    if side >= length:
        return (length - side) / 2
    return min(max(middle - side / 2, 0.0), length - side)
