"""The network that looks at one cell of a scene at a time: what it is, and how it is fitted.

It is shown what `pvg.skin.features` knows of the things there, which is much for so few people: so the features are
brought to their principal components, of which the first count, and some of them are dropped while it is fitted.
Fitted whole, in a U-Net, they did worse (docs/quality/networks.md).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from pvg._arrays import Bools, Floats
from pvg.skin.features import CHANNELS, FEATURES, SIDES
from pvg.skin.network import FIELDS
from pvg.skin.parameters import SKIN_PRIOR
from training.examples import KINDS, Example

_BATCH, _RATE, _DECAY = 4096, 3e-3, 1e-2
_WIDTH, _COMPONENTS = 32, 24  # of the hidden layer; of each of the layers that features are of
CELL_FIELDS = FIELDS + len(CHANNELS) * _COMPONENTS
_MOST = 2500  # cells of an example
_HEAVIEST = 20.0  # how much a cell counts at most, of the mean: people with small faces have many
_RARE, _RARE_KINDS = 2.0, [KINDS.index("ear"), KINDS.index("hand")]  # what is rare counts for so much more
_LEAST_CELLS, _LEAST_FACE = 50, 30  # of an example that counts
_PEOPLE = 0.2  # of the person mask: elsewhere nothing is skin anyway
_SURE = SKIN_PRIOR.network.sure
_PERSON, _FACE_MASK, _ACROSS, _DOWN, _GUESS = 6, 7, 8, 9, 11  # of the fields
# face sizes from the head's middle, across and down: farther out the network counts
_OVAL = SKIN_PRIOR.body_network.rise[0] * np.array([0.55, 0.7])


class Components(nn.Module):
    """Features (n, c, h, w) of each layer to their components (n, _COMPONENTS, h, w)."""

    def __init__(self) -> None:
        super().__init__()
        self.of_layers = nn.ModuleList(nn.Conv2d(count, _COMPONENTS, 1) for count in CHANNELS)

    def forward(self, *features: torch.Tensor) -> list[torch.Tensor]:
        """See the class."""
        return [layer(values) for layer, values in zip(self.of_layers, features, strict=True)]


class CellNet(nn.Module):
    """Fields and components (n, CELL_FIELDS, h, w) to log-odds of skin (n, h, w), each cell by itself."""

    def __init__(self) -> None:
        super().__init__()
        inputs = CELL_FIELDS - 1
        self.layers = nn.Sequential(
            nn.Dropout(0.2), nn.Conv2d(inputs, _WIDTH, 1), nn.ReLU(), nn.Dropout(0.3), nn.Conv2d(_WIDTH, 1, 1)
        )

    def shown(self, x: torch.Tensor) -> torch.Tensor:
        """(n, c, h, w): what the layers are shown, the rules' log-odds first."""
        fields, components = torch.split(x, [FIELDS, CELL_FIELDS - FIELDS], dim=1)
        guess = torch.clamp(fields[:, _GUESS:] + 0.5, _SURE, 1 - _SURE)
        odds = torch.log(guess) - torch.log(1 - guess)
        plain = torch.cat([odds, fields[:, :_FACE_MASK], fields[:, _FACE_MASK + 1 : _GUESS]], 1)
        return torch.cat([plain, components], 1)

    def of_shown(self, shown: torch.Tensor) -> torch.Tensor:
        """Log-odds (n, h, w) of what `shown` gives: the rules' and what is learned to be added."""
        scaled = torch.cat([shown[:, :1] / 3, shown[:, 1:]], 1)
        return shown[:, 0] + self.layers(scaled)[:, 0]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """See the class."""
        return self.of_shown(self.shown(x))


def fit_cells(examples: list[Example], steps: int, seed: int) -> tuple[Components, CellNet]:
    """What brings features to components and the network that is shown those, fitted to examples of scenes."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    found = [_cells(example, rng) for example in examples]
    cells, skin, weight = (np.concatenate(arrays) for arrays in zip(*(one for one in found if one), strict=True))
    components, net = Components(), CellNet()
    fields, *features = np.split(cells, np.cumsum([FIELDS, *CHANNELS])[:-1], axis=1)
    for layer, values in zip(components.of_layers, features, strict=True):
        _set_components(layer, values)
    with torch.no_grad():
        few = components(*(torch.from_numpy(values[..., None, None]) for values in features))
        shown = net.shown(torch.cat([torch.from_numpy(fields[..., None, None]), *few], 1))
    y, w = torch.from_numpy(skin), torch.from_numpy(np.minimum(weight / weight.mean(), _HEAVIEST))
    optimizer = torch.optim.AdamW(net.layers.parameters(), _RATE, weight_decay=_DECAY)
    for step in range(1, steps + 1):
        some = torch.randint(len(shown), (_BATCH,))
        odds = net.of_shown(shown[some])[:, 0, 0]
        loss = (functional.binary_cross_entropy_with_logits(odds, y[some], reduction="none") * w[some]).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 100 == 0:
            print(f"step {step}: loss {loss.item():.4f}", flush=True)
    return components, net.eval()


def export_components(components: Components, path: Path) -> None:
    """Write them as `pvg.skin.features` runs them: a map (1, c, n, n) of each layer to its components."""
    torch.onnx.export(
        components,
        tuple(torch.zeros(1, count, side, side) for count, side in zip(CHANNELS, SIDES, strict=True)),
        str(path),
        input_names=["fine", "coarse"],
        output_names=["fine_components", "coarse_components"],
        opset_version=17,
        dynamo=False,
    )


def _cells(example: Example, rng: np.random.Generator) -> tuple[Floats, Floats, Floats] | None:
    """Some cells of people off the face: fields and features (n, …), skin (n,) and how much each counts (n,).

    A cell counts by its share of the face's area; None where there are next to none.
    """
    skin, face = example.labels[..., -1], float(example.labels[..., 0].sum())
    places = np.flatnonzero(_asked(example))
    if len(places) < _LEAST_CELLS or face < _LEAST_FACE:
        return None
    kept = rng.choice(places, min(len(places), _MOST), replace=False)
    both = np.concatenate([example.fields, example.features], axis=2).reshape(-1, FIELDS + FEATURES)[kept]
    weight = len(places) / len(kept) / face * (1 + _RARE * example.labels[..., _RARE_KINDS].sum(axis=2).ravel()[kept])
    return np.asarray(both, np.float32), np.asarray(skin.ravel()[kept], np.float32), np.asarray(weight, np.float32)


def _asked(example: Example) -> Bools:
    """(h, w) bool, cells of people off the face's oval: where the network counts."""
    far = SKIN_PRIOR.body_network.far
    across, down = (
        np.arctanh(np.clip(example.fields[..., at], -0.999, 0.999)) * far / axis
        for at, axis in zip((_ACROSS, _DOWN), _OVAL, strict=True)
    )
    people = example.fields[..., _PERSON] + 0.5 > _PEOPLE
    asked: Bools = (example.visible > 0.9) & (np.hypot(across, down) > 1) & people
    return asked


def _set_components(layer: nn.Conv2d, features: Floats) -> None:
    """Have a layer bring features (n, c), of one scale each, to their first principal components, of deviation 1."""
    mean, deviation = features.mean(axis=0), features.std(axis=0) + 1e-3
    scaled = (features - mean) / deviation
    _, vectors = np.linalg.eigh(scaled.T @ scaled)
    directions: NDArray[np.float32] = vectors[:, ::-1][:, :_COMPONENTS]
    weights = directions / (scaled @ directions).std(axis=0) / deviation[:, None]
    with torch.no_grad():
        layer.weight.copy_(torch.from_numpy(np.ascontiguousarray(weights.T))[..., None, None])
        layer.bias.copy_(torch.from_numpy(-mean @ weights))
