"""Planes and fields of libav's pictures: samples to be written, one field alone, the mark of an interlaced picture."""

from __future__ import annotations

from typing import Any

import av
import av.filter
import av.video.frame
import numpy as np
from numpy.typing import NDArray

from pvg.video.encoders import FieldOrder


def rows_of(picture: av.video.frame.VideoFrame, index: int, dtype: Any) -> NDArray[Any]:
    """(h, w): the samples of a plane, to be read and written."""
    plane = picture.planes[index]
    samples = np.frombuffer(memoryview(plane), dtype=dtype)
    return samples.reshape(-1, plane.line_size // np.dtype(dtype).itemsize)[: plane.height, : plane.width]


def field_of(picture: av.video.frame.VideoFrame, first: int) -> av.video.frame.VideoFrame:
    """One field as a picture of its own: rows first, first + 2, …"""
    dtype = np.uint8 if picture.format.components[0].bits == 8 else np.uint16
    field = av.video.frame.VideoFrame(picture.width, (picture.height + 1 - first) // 2, picture.format.name)
    for p in range(len(picture.planes)):
        rows = rows_of(field, p, dtype)
        lines = rows_of(picture, p, dtype)[first::2]
        rows[: len(lines)] = lines[: len(rows)]
        rows[len(lines) :] = lines[-1]
    return field


class FieldMarks:
    """Marks pictures as interlaced, which PyAV leaves to libav's filters."""

    def __init__(self, fields: FieldOrder) -> None:
        self._fields = fields
        self._graph: av.filter.Graph | None = None

    def __call__(self, picture: av.video.frame.VideoFrame) -> av.video.frame.VideoFrame:
        """The same picture, marked; all are of one size and format."""
        if self._graph is None:
            graph = av.filter.Graph()
            source = graph.add_buffer(
                width=picture.width, height=picture.height, format=picture.format, time_base=picture.time_base
            )
            marks, sink = graph.add("setfield", self._fields), graph.add("buffersink")
            source.link_to(marks)
            marks.link_to(sink)
            graph.configure()
            self._graph = graph
        self._graph.push(picture)
        marked = self._graph.pull()
        assert isinstance(marked, av.video.frame.VideoFrame)  # noqa: S101 - narrows the binding's union
        marked.pts, marked.time_base, marked.duration = picture.pts, picture.time_base, picture.duration
        return marked
