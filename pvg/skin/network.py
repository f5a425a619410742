"""A network's opinion of a mask: what colours and place alone do not tell, hair of the skin's colour above all.

It is this project's own, small, and trained on its own labels (training/). It looks at the face's box at 48 cells a
face size: the colours, plain and beside the skin's own, what the landmarks say of each place, and the posterior so far;
and says anew how probable skin is.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg import models
from pvg._arrays import Bools, Bytes, Floats
from pvg.raster import Raster
from pvg.skin.light import MID_GREY, median_color
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior, logistic

_NETWORK, _NAME = SKIN_PRIOR.network, "face_skin"
FIELDS = 12


@dataclass(frozen=True, eq=False)
class NetworkOutput:
    """The network's probability of skin (h, w) float32, in [0, 1], over the raster of a frame."""

    raster: Raster
    probability: Floats

    def log_odds_against(self, other: Raster) -> Floats:
        """Log-odds against skin in the cells (h, w) of another raster: nats ≥ 0, 0 outside of its own."""
        xs, ys = (np.asarray(v, np.float32) for v in other.centers())
        return self.raster.read(np.maximum(-log_odds(self.probability), 0), xs, ys)


def network_fields(rgb: Bytes, prior: SpatialPrior, probability: Floats) -> Floats:
    """What the network is shown: (FIELDS, h', w') float32, at 48 cells a face size.

    rgb: (h, w, 3) uint8;  prior: of the same cells;  probability: (h, w) float32, of skin so far.
    """
    h, w = rgb.shape[:2]
    ratio = _NETWORK.face_cells / prior.size
    size = (max(1, round(w * ratio)), max(1, round(h * ratio)))
    how = cv2.INTER_AREA if ratio < 1 else cv2.INTER_LINEAR

    def small(values: Floats) -> Floats:
        return np.asarray(cv2.resize(values, size, interpolation=how), np.float32)

    own = median_color(rgb, prior.sample)
    if own is None:
        own = np.full(3, MID_GREY, np.float32)
    color = small(np.asarray(rgb, np.float32))
    beside = np.log(color + _NETWORK.dark) - np.log(own + _NETWORK.dark)
    fields = [*np.moveaxis(color / 255 - 0.5, 2, 0), *np.moveaxis(beside, 2, 0)]
    fields += [
        small(prior.log_odds) / 4,
        small(np.minimum(prior.outside, 1)),
        small(prior.face.astype(np.float32)),
        small(np.clip(prior.along, -2, 2)),
        small(np.clip(prior.off, 0, 2)),
        small(probability) - 0.5,
    ]
    return np.stack(fields).astype(np.float32)


def certain(prior: SpatialPrior, predicted: Floats, before: Floats | None = None) -> Bools:
    """(h, w) bool: the foreground but for hair that hangs over cheeks, which the network is sure is no skin.

    A network that denies most of it does not see the face at all, and is not asked.
    predicted: (h, w) its probability of skin, see `predict_skin`;  before: (h, w) in [0, 1], the mask of the frame
    before, moved: what was skin stays so a little longer, and what was none as well.
    """
    denied = np.float32(_NETWORK.denied) * (1 if before is None else np.float32(1.5) - before)
    kept: Bools = prior.foreground & (predicted > denied)
    least = _NETWORK.sees * np.count_nonzero(prior.foreground)
    return kept if np.count_nonzero(kept) >= least else prior.foreground


def predict_skin(rgb: Bytes, prior: SpatialPrior, probability: Floats) -> Floats:
    """The network's probability of skin (h, w) float32; the arguments are those of `network_fields`."""
    return run_network(_NAME, network_fields(rgb, prior, probability), probability.shape)


def run_network(
    name: str, fields: Floats, shape: tuple[int, ...], margin: int = 0, multiple: int = _NETWORK.multiple
) -> Floats:
    """The output of one of our own networks for fields (c, h', w'): the probability of skin (h, w), float32.

    name: of the model;  shape: (h, w) of the output;  margin: cells around in which the edge is repeated, for networks
    answer otherwise beside an edge;  multiple: of so many cells its sides are made, 1 where each is by itself.
    """
    h, w = fields.shape[1:]
    edges = [(margin, margin + -(length + 2 * margin) % multiple) for length in (h, w)]
    padded = np.pad(fields, ((0, 0), *edges), mode="edge")
    session = models.load(name)
    (out,) = session.run(None, {session.get_inputs()[0].name: padded[None]})
    own = np.ascontiguousarray(out[0, 0, margin : margin + h, margin : margin + w])
    return np.asarray(cv2.resize(own, shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def fused(one: Floats, other: Floats, share: Floats | float = _NETWORK.believed) -> Floats:
    """The probability whose log-odds are the weighted mean of two, as of the rules' and a network's.

    one, other: probabilities (…);  share: the weight of the other in [0, 1], (…) or one for all.
    """
    weight = np.asarray(share, np.float32)
    return logistic((1 - weight) * log_odds(one) + weight * log_odds(other))


def log_odds(probability: Floats) -> Floats:
    """Of probabilities, float32 nats; none is surer than `NetworkNumbers.sure`."""
    bounded = np.clip(probability, _NETWORK.sure, 1 - _NETWORK.sure)
    return np.asarray(np.log(bounded / (1 - bounded)), np.float32)
