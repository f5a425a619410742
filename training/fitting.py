"""Fitting: batches of augmented examples, the loss, and the steps."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn import functional
from torch.utils.data import DataLoader, IterableDataset

from pvg._arrays import Floats
from training.augmentation import augmented
from training.examples import Example
from training.measuring import Predictor, measured
from training.network import SkinNet
from training.network import load as load_network

_BATCH, _RATE, _DECAY = 8, 3e-3, 2e-3


class _Augmented(IterableDataset):  # type: ignore[misc]
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
    torch.set_num_threads(1)
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
            print(measured(_predictor(net), tests), flush=True)
    return net


def _loss(net: SkinNet, batch: tuple[torch.Tensor, torch.Tensor, torch.Tensor]) -> torch.Tensor:
    """Cross entropy and half of Dice's loss, over what counts."""
    x, y, w = batch
    odds = net(x)
    entropy = (functional.binary_cross_entropy_with_logits(odds, y, reduction="none") * w).sum() / w.sum()
    p = torch.sigmoid(odds)
    both, sides = (p * y * w).sum((1, 2)), ((p + y) * w).sum((1, 2))
    return entropy + 0.5 * (1 - (2 * both + 1) / (sides + 1)).mean()


def _predictor(net: SkinNet) -> Predictor:
    """What the network says as it stands, without what it only does while it is fitted."""

    def predict(fields: Floats) -> Floats:
        net.eval()
        with torch.no_grad():
            said = torch.sigmoid(net(torch.from_numpy(fields[None])))[0].numpy()
        net.train()
        return np.asarray(said, np.float32)

    return predict
