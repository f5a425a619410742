"""Messages about a clip's faces: the error when none can be used, the warning when there are too many."""

from __future__ import annotations

from pvg.errors import FaceTooSmallError, NoFaceError
from pvg.landmarks import MAX_FACES


def no_usable_face(
    name: str, frame_count: int, *, widest: float, too_brief: bool, image: bool, min_px: float, advised_px: float
) -> NoFaceError | FaceTooSmallError:
    """The error for a clip or image without a usable face, not raised yet.

    widest: of the faces found, px, 0 without any;  frame_count: of the clip;
    too_brief: whether without any there was one for too short a time.
    """
    if widest:
        return FaceTooSmallError(
            f"the largest face in {name} is {widest:.0f} px wide; it must be at least {min_px:g} px, and "
            f"{advised_px:g} px is advised"
        )
    if too_brief and not image:
        return NoFaceError(
            f"no face is seen for long enough in the {frame_count} frames of {name}; five frames that show it clearly "
            "are needed, or all of a shorter shot of two"
        )
    what = "in the picture" if image else f"in any of {frame_count} frames"
    return NoFaceError(f"no face found {what} of {name}; a face at least {min_px:g} px wide is needed")


def over_limit_warning(count: int) -> tuple[str, ...]:
    """The warning of faces that are wide enough and are not followed, none without any."""
    if not count:
        return ()
    faces = "1 more face is" if count == 1 else f"{count} more faces are"
    return (f"{faces} left out: at most {MAX_FACES} are followed at a time",)
