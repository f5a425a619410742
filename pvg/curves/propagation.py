"""Curve matching (eq. 5): carry boundary colours from one frame's curves to another's.

Samples carry a label (curve id, parameter s); the map pi takes a place on a curve to the place of the same label.
The default keeps one colour table per key frame and maps every frame straight to it, so nothing accumulates. The
paper's way, g_i = g_{i-1} o pi^-1 from frame to frame with a reset every 120 frames, is kept for comparison.
"""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np

from pvg._arrays import Floats

Matching = Literal["table", "chain"]
"""How colours are carried through a clip: by `ColorTable`, or by the paper's `Chain`."""

CHAIN_RESET_FRAMES = 120  # the paper's


class Labels(Protocol):
    """Labels of S samples in runs of equal curve id (see `pvg.curves.CurveLabels`)."""

    @property
    def s(self) -> Floats:
        """(S,) parameters, increasing within each run."""

    @property
    def spans(self) -> tuple[tuple[int, int, bool], ...]:
        """(start, stop, closed) of each curve's run."""


def match(colors: Floats, source: Labels, target: Labels) -> Floats:
    """Colours of `target`'s samples read off `source`'s curves at the same labels, eq. (5).

    colors: (S, C) values at the samples of `source`, any number of channels. Returns (T, C) float32, linear in s
    between samples; exact where a target label is also a source label, as it is at landmarks.
    Raises `ValueError` when the two have not the same curves.
    """
    if len(source.spans) != len(target.spans):
        raise ValueError(f"cannot match {len(source.spans)} curves to {len(target.spans)}")
    if source is target:
        return colors
    out = np.empty((len(target.s), colors.shape[1]), np.float32)
    for (a, b, closed), (c, d, _) in zip(source.spans, target.spans, strict=True):
        s, values = source.s[a:b], colors[a:b]
        if closed:  # the first sample again, one turn later
            s, values = np.append(s, s[0] + 1.0), np.concatenate([values, values[:1]])
        for channel in range(colors.shape[1]):
            out[c:d, channel] = np.interp(target.s[c:d], s, values[:, channel])  # eq. (5)
    return out


class ColorTable:
    """The default propagation: the key frame's colours as a table over (curve id, s), read at each frame's labels.

    Every frame is matched straight to the key frame, so nothing accumulates and any frame may be asked for.
    """

    def __init__(self, colors: Floats, labels: Labels) -> None:
        """colors: (S, C) of the key frame, any number of channels;  labels: of its samples."""
        self._colors = colors
        self._labels = labels

    def at(self, labels: Labels) -> Floats:
        """The (T, C) colours of a frame's samples."""
        return match(self._colors, self._labels, labels)


class Chain:
    """The paper's frame-to-frame propagation of colours from a key frame, eq. (5) applied once a frame.

    Each step resamples the colours, so they drift; the caller starts a new chain at every reset.
    """

    def __init__(self, colors: Floats, labels: Labels) -> None:
        self._colors = colors
        self._labels = labels

    def step(self, labels: Labels) -> Floats:
        """Move on to the next frame's samples and return their (S, C) colours."""
        self._colors = match(self._colors, self._labels, labels)
        self._labels = labels
        return self._colors
