"""Files of examples: one .npz of arrays of one size, half precision."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from pvg._arrays import Floats
from training.examples import BODY_SIZE, Example

_ARRAYS = "fields", "features", "labels", "visible", "sample"
_SIZE = 144, 96  # cells: most faces' boxes, in multiples of 16


def save(examples: list[Example], path: Path) -> None:
    """Write examples, all of one size: narrower ones with edges repeated, where nothing counts, wider ones cut."""
    how: dict[str, Literal["edge", "constant"]] = {"fields": "edge", "features": "edge", "labels": "edge"}
    size = BODY_SIZE if examples[0].at == "body" else _SIZE
    arrays: dict[str, Any] = {
        name: np.stack([_of_one_size(getattr(one, name), size, how.get(name, "constant")) for one in examples])
        for name in _ARRAYS
    }
    arrays = {name: values.astype(np.float16) for name, values in arrays.items()}
    np.savez_compressed(path, person=[one.person for one in examples], at=[one.at for one in examples], **arrays)


def _of_one_size(values: Floats, size: tuple[int, int], how: Literal["edge", "constant"]) -> Floats:
    """The middle of (h, w, …), padded or cut to `size`."""
    for axis, side in enumerate(size):
        missing = side - values.shape[axis]
        if missing > 0:
            edges = [(0, 0)] * values.ndim
            edges[axis] = (missing // 2, missing - missing // 2)
            values = np.pad(values, edges, mode=how)
        elif missing < 0:
            values = np.take(values, range(-missing // 2, -missing // 2 + side), axis=axis)
    return values


def load(paths: list[Path]) -> list[Example]:
    """Examples of files that `save` wrote."""
    out = []
    for path in paths:
        with np.load(path) as file:
            raw = {name: file[name] for name in file.files}
        floats = {name: raw[name].astype(np.float32) for name in _ARRAYS}
        for i, (person, at) in enumerate(zip(raw["person"], raw["at"], strict=True)):
            out.append(Example(str(person), str(at), **{name: values[i] for name, values in floats.items()}))
    return out
