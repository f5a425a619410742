"""Messages about a clip's faces: the errors when none can be used, the warnings when some are left out.

Errors are returned, for the caller to raise.
"""

from __future__ import annotations

from pvg.errors import FaceTooSmallError, NoFaceError
from pvg.landmarks import MAX_FACES
from pvg.skin import MaskMethod


def no_usable_face(
    name: str, frame_count: int, *, widest: float, too_brief: bool, image: bool, min_px: float, advised_px: float
) -> NoFaceError | FaceTooSmallError:
    """The error for a clip or image without a usable face.

    name: of its file;  frame_count: how many were looked at;  widest: of the faces found, px, 0 without any;
    too_brief: whether without any there was one for too short a time;  image: whether it is a single picture;
    min_px, advised_px: widths of a face.
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


def no_skin_anywhere(name: str, faces: int, mask: MaskMethod) -> NoFaceError:
    """The error when the mask finds skin on none of the faces;  name: of the file."""
    count = f"{faces} face" + ("s" if faces > 1 else "")
    return NoFaceError(f"no skin found on any of {count} of {name}{_mask_advice(mask)}")


def no_skin_warning(first_frame: int, mask: MaskMethod) -> str:
    """The warning of a face on which the mask finds no skin."""
    return f"no skin found on a face seen from frame {first_frame} on, which is left out{_mask_advice(mask)}"


def _mask_advice(mask: MaskMethod) -> str:
    return ': mask="ycbcr" tells it by its colour, mask="landmarks" does not' if mask == "ycbcr" else ""
