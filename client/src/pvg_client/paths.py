"""Paths of the interface, of names that are written here and ids that come from elsewhere."""

from __future__ import annotations

import re
from typing import Final

#: what one id may be: nothing that a path, a query or a header gives a meaning to
_SEGMENT: Final = re.compile(r"[A-Za-z0-9_-]+")


def path_to(*segments: str) -> str:
    """The path to a thing: each name, id and number is one segment of it.

    Raises `ValueError` for what is none: an id that is empty, or with a slash in it, would lead to something else.
    """
    for segment in segments:
        if not _SEGMENT.fullmatch(segment):
            # of an address the query is not told: it may have a signature
            raise ValueError(f"{segment.partition('?')[0]!r} is no id: it looks like vid_0192f0c1a2b3")
    return "/" + "/".join(segments)
