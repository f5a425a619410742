"""How well a network's masks fit the labels: `python -m training.measuring NET.onnx EXAMPLES.npz …`.

Without PyTorch, on any network that `training.network.export` wrote, so on the product's own too.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from benchmarks.quality.labels import NOT_SKIN, SKIN
from pvg._arrays import Floats
from pvg.skin.network import fused
from training.augmentation import as_it_is
from training.example_files import load
from training.examples import KINDS, Example

Predictor = Callable[[Floats], Floats]
"""Fields (FIELDS, h, w) float32, sides in multiples of 16, to the probability of skin (h, w) float32."""

_LEAST_CELLS = 20  # of a region, for its share to say something


def measured(predict: Predictor, tests: list[Example]) -> str:
    """Per cent of each kind of label with a probability of at least ½, IoU and its worst: guess, network and both.

    A line for key frames, for those that follow and for all of them, or for scenes of bodies.
    """
    found: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for example in tests:
        sample = as_it_is(example)
        predicted = predict(sample.fields)
        counts, skin = sample.weight > 0.9, sample.skin > 0.5
        face = example.labels[..., 0] > 0.5
        rim = face & (cv2.distanceTransform(face.astype(np.uint8), cv2.DIST_L2, 5) <= 2)
        regions = {kind: example.labels[..., i] > 0.5 for i, kind in enumerate(KINDS)}
        named = example.labels[..., [-1, *range(len(SKIN), len(KINDS))]].sum(axis=2)
        regions |= {"rim": rim, "wall": named < 0.5}
        guess = sample.fields[11] + np.float32(0.5)
        for who, p in (("guess", guess), ("network", predicted), ("both", fused(guess, predicted))):
            mask = p > 0.5
            rows = [found[at, who] for at in dict.fromkeys((example.at, "all"))]
            for kind, region in regions.items():
                inside = region & counts & (skin | (kind in (*NOT_SKIN, "wall")))
                if int(inside.sum()) > _LEAST_CELLS:
                    for row in rows:
                        row[kind].append(float(mask[inside].mean()))
            iou = float((mask & skin & counts).sum() / ((mask | skin) & counts).sum())
            for row in rows:
                row["IoU"].append(iou)
    return "\n".join(
        f"{at} {who}: "
        + ", ".join(f"{kind} {100 * np.mean(values):.1f}" for kind, values in row.items())
        + f", worst IoU {100 * min(row['IoU']):.1f} ({len(row['IoU'])} examples)"
        for (at, who), row in sorted(found.items())
    )


def predictor_of(path: Path) -> Predictor:
    """What a network in a file says."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name

    def predict(fields: Floats) -> Floats:
        (out,) = session.run(None, {name: fields[None]})
        return np.asarray(out[0, 0], np.float32)

    return predict


def main() -> None:
    """Print the lines; see `measured`."""
    parser = argparse.ArgumentParser(prog="python -m training.measuring", description=__doc__)
    parser.add_argument("network", type=Path)
    parser.add_argument("examples", type=Path, nargs="+")
    options = parser.parse_args()
    print(measured(predictor_of(options.network), load(options.examples)))


if __name__ == "__main__":
    main()
