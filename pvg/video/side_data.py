"""What a decoded picture has beside it (display matrix, HDR metadata, captions, …), by its kind."""

from __future__ import annotations

from typing import Any

import av.video.frame
from av.sidedata.sidedata import Type


def _unnamed(kinds: type[Type], value: object) -> Type | None:
    if not isinstance(value, int):
        return None
    kind: Any = object.__new__(kinds)
    kind._name_, kind._value_ = f"KIND_{value}", value
    return kind  # type: ignore[no-any-return]


# libav tells of more kinds than PyAV has names for (EXIF, a view of a spatial clip), and for the sake of one of these
# PyAV gives nothing of a picture at all, but a ValueError
Type._missing_ = classmethod(_unnamed)  # type: ignore[assignment, method-assign]


def side_data(picture: av.video.frame.VideoFrame) -> dict[str, bytes]:
    """libav's structs or payloads by the names of their kinds, of `av.sidedata.sidedata.Type`: those that have one."""
    held: Any = picture.side_data
    # what is iterated over are entries in some versions of PyAV, and kinds in others
    return {kind.name: bytes(one) for kind in Type if (one := held.get(kind)) is not None}
