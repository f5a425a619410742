"""The network: a U-Net of four halvings, and its export to ONNX."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import onnx
import torch
from torch import nn
from torch.nn import functional

from pvg.skin.network import FIELDS
from pvg.skin.parameters import SKIN_PRIOR

_WIDTHS = (16, 24, 32, 48, 64)


class _Block(nn.Module):
    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.first, self.second = nn.Conv2d(before, after, 3, padding=1), nn.Conv2d(after, after, 3, padding=1)
        self.norms = nn.ModuleList(nn.BatchNorm2d(after) for _ in range(2))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = functional.relu(self.norms[0](self.first(x)))
        return functional.relu(self.norms[1](self.second(x)))


class SkinNet(nn.Module):
    """Fields (n, FIELDS, h, w) to log-odds of skin (n, h, w); sides are multiples of 16."""

    def __init__(self) -> None:
        super().__init__()
        pairs = list(pairwise(_WIDTHS))
        self.stem = nn.Conv2d(FIELDS, _WIDTHS[0], 3, padding=1)
        self.down = nn.ModuleList(_Block(fine, coarse) for fine, coarse in pairs)
        self.up = nn.ModuleList(nn.Conv2d(coarse + fine, fine, 3, padding=1) for fine, coarse in pairs)
        self.out = nn.Conv2d(_WIDTHS[0], 1, 1)
        self.drop = nn.Dropout2d(0.1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Log-odds of fields; see the class."""
        x = functional.relu(self.stem(x))
        levels = [x]
        for block in self.down:
            x = block(functional.max_pool2d(x, 2))
            levels.append(x)
        x = self.drop(x)
        for level in range(len(self.up) - 1, -1, -1):
            x = functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            x = functional.relu(self.up[level](torch.cat([x, levels[level]], 1)))
        return self.out(x)[:, 0]


def load(path: Path) -> SkinNet:
    """The network that `export` wrote, to be fitted further: its normalisation is part of its convolutions since."""
    net = SkinNet()
    for block in net.down:
        block.norms = nn.ModuleList(nn.Identity() for _ in block.norms)
    graph = onnx.load(path).graph
    stored = {one.name: torch.from_numpy(onnx.numpy_helper.to_array(one).copy()) for one in graph.initializer}
    convolutions = [net.stem]
    for block in net.down:
        convolutions += [block.first, block.second]
    convolutions += [*reversed(net.up), net.out]
    with torch.no_grad():
        for layer, node in zip(convolutions, (one for one in graph.node if one.op_type == "Conv"), strict=True):
            layer.weight.copy_(stored[node.input[1]])
            layer.bias.copy_(stored[node.input[2]])
    return net


class _Probability(nn.Module):
    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(self.net(x))[:, None]


def export(net: nn.Module, path: Path, fields: int = FIELDS) -> None:
    """Write a network of log-odds as `pvg.skin.network` runs it: "fields" (1, fields, h, w) to "skin" (1, 1, h, w)."""
    side = SKIN_PRIOR.network.multiple
    example = torch.zeros(1, fields, 8 * side, 5 * side)
    axes = {name: {2: "h", 3: "w"} for name in ("fields", "skin")}
    torch.onnx.export(
        _Probability(net.eval()),
        (example,),
        str(path),
        input_names=["fields"],
        output_names=["skin"],
        dynamic_axes=axes,
        opset_version=17,
        dynamo=False,
    )
