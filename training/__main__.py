"""`python -m training examples --half tune OUT.npz`, then `python -m training fit OUT.npz --onnx NET.onnx`.

With `--net body` examples are of the network of the body.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from torch.nn import functional
from torch.utils.data import DataLoader, IterableDataset

from benchmarks.quality.labels import NOT_SKIN, SKIN
from benchmarks.quality.media import HALVES
from pvg._arrays import Floats
from pvg.skin.network import agreed
from training.augmentation import as_it_is, augmented
from training.examples import BODY_SIZE, KINDS, Example, Maker, body_examples_of, examples_of, of_benchmark, of_packages
from training.network import SkinNet, export
from training.network import load as load_network
from training.pictures import FOLDER

_BATCH, _RATE, _DECAY = 8, 3e-3, 2e-3
_SIZE = 144, 96  # cells: most faces' boxes, in multiples of 16
_MAKERS: dict[str, Maker] = {"face": examples_of, "body": body_examples_of}


def save(examples: list[Example], path: Path) -> None:
    """Write examples, all of one size: narrower ones with edges repeated, where nothing counts, wider ones cut."""
    how: dict[str, Literal["edge", "constant"]] = {"fields": "edge", "labels": "edge"}
    size = BODY_SIZE if examples[0].at == "body" else _SIZE
    arrays: dict[str, Any] = {
        name: np.stack([_of_one_size(getattr(one, name), size, how.get(name, "constant")) for one in examples])
        for name in ("fields", "labels", "visible", "sample")
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
        floats = {name: raw[name].astype(np.float32) for name in ("fields", "labels", "visible", "sample")}
        for i, (person, at) in enumerate(zip(raw["person"], raw["at"], strict=True)):
            out.append(Example(str(person), str(at), **{name: values[i] for name, values in floats.items()}))
    return out


class _Augmented(IterableDataset):  # type: ignore[misc, type-arg]
    """Batches without end, made in a process of its own: each person as often as any other."""

    def __init__(self, examples: list[Example], seed: int) -> None:
        self.examples, self.seed = examples, seed

    def __iter__(self) -> Iterator[tuple[torch.Tensor, ...]]:
        cv2.setNumThreads(1)
        rng = np.random.default_rng(self.seed)
        people = defaultdict(list)
        for example in self.examples:
            people[example.person].append(example)
        everybody = list(people.values())
        while True:
            samples = []
            for _ in range(_BATCH):
                own = everybody[rng.integers(len(everybody))]
                samples.append(augmented(own[rng.integers(len(own))], self.examples, rng))
            yield tuple(
                torch.from_numpy(np.stack([getattr(one, name) for one in samples]).astype(np.float32))
                for name in ("fields", "skin", "weight")
            )


def fit(examples: list[Example], tests: list[Example], steps: int, seed: int, start: Path | None = None) -> SkinNet:
    """A network fitted to examples: each person as often as any other; measured on `tests` every 500 steps.

    start: a network to go on with, gently; a new one without.
    """
    torch.manual_seed(seed)
    net, rate = (load_network(start), _RATE / 5) if start else (SkinNet(), _RATE)
    optimizer = torch.optim.AdamW(net.parameters(), rate, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=steps)
    started = time.monotonic()
    batches = DataLoader(_Augmented(examples, seed), batch_size=None, num_workers=1, prefetch_factor=4)
    for step, batch in zip(range(1, steps + 1), batches, strict=False):
        loss = _loss(net, batch)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if step % 100 == 0:
            print(f"step {step}: loss {loss.item():.4f}, {time.monotonic() - started:.0f} s", flush=True)
        if tests and (step % 500 == 0 or step == steps):
            print(measured(net, tests), flush=True)
    return net


def _loss(net: SkinNet, batch: tuple[torch.Tensor, torch.Tensor, torch.Tensor]) -> torch.Tensor:
    """Cross entropy and half of Dice's loss, over what counts."""
    x, y, w = batch
    odds = net(x)
    entropy = (functional.binary_cross_entropy_with_logits(odds, y, reduction="none") * w).sum() / w.sum()
    p = torch.sigmoid(odds)
    both, sides = (p * y * w).sum((1, 2)), ((p + y) * w).sum((1, 2))
    return entropy + 0.5 * (1 - (2 * both + 1) / (sides + 1)).mean()


def measured(net: SkinNet, tests: list[Example]) -> str:
    """Shares of each kind of label with a probability of at least ½, and IoU: guess, net and both."""
    net.eval()
    found: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for example in tests:
        sample = as_it_is(example)
        with torch.no_grad():
            said = torch.sigmoid(net(torch.from_numpy(sample.fields[None])))[0].numpy()
        counts, skin = sample.weight > 0.9, sample.skin > 0.5
        face = example.labels[..., 0] > 0.5
        rim = face & (cv2.distanceTransform(face.astype(np.uint8), cv2.DIST_L2, 5) <= 2)
        regions = {kind: example.labels[..., i] > 0.5 for i, kind in enumerate(KINDS)}
        named = example.labels[..., [-1, *range(len(SKIN), len(KINDS))]].sum(axis=2)
        regions |= {"rim": rim, "wall": named < 0.5}
        guess = sample.fields[11] + np.float32(0.5)
        for who, p in (("guess", guess), ("network", said), ("both", agreed(guess, said))):
            mask = p > 0.5
            row = found[example.at, who]
            for kind, region in regions.items():
                inside = region & counts & (skin | (kind in (*NOT_SKIN, "wall")))
                if int(inside.sum()) > 20:
                    row[kind].append(float(mask[inside].mean()))
            row["IoU"].append(float((mask & skin & counts).sum() / ((mask | skin) & counts).sum()))
    net.train()
    return "\n".join(
        f"{at} {who}: " + ", ".join(f"{kind} {100 * np.mean(values):.1f}" for kind, values in row.items())
        for (at, who), row in sorted(found.items())
    )


def main() -> None:
    """Make examples or fit the network; see the module and the README."""
    parser = argparse.ArgumentParser(prog="python -m training", description=__doc__)
    what = parser.add_subparsers(dest="what", required=True)
    make = what.add_parser("examples")
    make.add_argument("out", type=Path)
    make.add_argument("--half", choices=(*HALVES, "none"), default="none", help="of the benchmark's labels")
    make.add_argument("--packages", choices=("fit", "test"), help="the pictures in packages, by what they are for")
    make.add_argument("--net", choices=tuple(_MAKERS), default="face", help="of whose box or scene")
    make.add_argument("--assets", type=Path, default=FOLDER / "assets")
    train = what.add_parser("fit")
    train.add_argument("examples", type=Path, nargs="+")
    train.add_argument("--test", type=Path, nargs="*", default=[])
    train.add_argument("--steps", type=int, default=3000)
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--start", type=Path, help="a network that was fitted before, to go on with")
    train.add_argument("--onnx", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.what == "examples":
        options.assets.mkdir(parents=True, exist_ok=True)
        maker = _MAKERS[options.net]
        made = [] if options.half == "none" else of_benchmark(options.half, options.assets, maker)
        if options.packages:
            made += of_packages(options.assets, options.packages, maker)
        save(made, options.out)
        return
    torch.set_num_threads(1)
    net = fit(load(options.examples), load(options.test), options.steps, options.seed, options.start)
    if options.onnx:
        export(net, options.onnx)


if __name__ == "__main__":
    main()
