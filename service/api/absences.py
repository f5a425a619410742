"""What is said of a medium, a face or a frame that is not there."""

from __future__ import annotations

from service.catalog import Media, requests


def no_medium(media_id: str) -> str:
    """No medium has this id."""
    return f"there is no {'video' if media_id.startswith('vid') else 'reference'} {media_id}"


def no_face(medium: Media, face: int) -> str:
    """A medium that is ready has no such face."""
    return requests.no_face(face, len(medium.faces), medium.id)


def no_frame(medium: Media, count: int) -> str:
    """A medium has only so many frames."""
    return f"{medium.id} has {count} frame(s), counted from 0"
