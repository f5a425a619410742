"""Whether looks fit their media and their output, as far as these are known yet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

from service.api.absences import no_face, no_medium
from service.api.schemas import Contrast, LookOptions, OutputRequest
from service.catalog import CLIP_CONTAINERS, IMAGE_CONTAINERS, Media, MediaState, Role
from service.errors import MediaFailedError, NotFoundError, ValidationFailedError, of_medium

#: options of an output that still pictures do not have
_OF_CLIPS = frozenset({"codec", "crf", "preset", "audio", "matte"})


@dataclass(frozen=True)
class WantedLook:
    """One look that a request asks for.

    ``place`` is where in the request its options stand, as a JSON pointer. With ``exchange`` two faces of the video
    exchange their colours, with a contrast for each.
    """

    video_id: str
    reference_id: str
    options: LookOptions
    place: str
    exchange: tuple[Contrast, Contrast] | None = None


@dataclass(frozen=True)
class WantedOutput:
    """How a request asks for its results; ``place`` is where its options stand, as a JSON pointer."""

    options: OutputRequest
    place: str


def check(
    known: Mapping[str, Media],
    looks: Sequence[WantedLook],
    output: WantedOutput,
    places: Mapping[str, str],
) -> None:
    """Raise what `request_looks` raises of looks and an output that do not fit their media.

    ``known`` are the media by id; all others are as there.
    """
    check_usable(known, places)
    _check_output({known[look.video_id] for look in looks}, output)
    for look in looks:
        _check_container(known[look.video_id], output)
        video_at = next(where for where, media_id in places.items() if media_id == look.video_id)
        check_look(known[look.video_id], known.get(look.reference_id), look, video_at)


def check_usable(known: Mapping[str, Media], places: Mapping[str, str]) -> None:
    """Name all places of media that are not there or, when all are, of those that have failed."""
    missing = {where: no_medium(media_id) for where, media_id in places.items() if media_id not in known}
    if missing:
        errors = [{"pointer": where, "detail": detail} for where, detail in missing.items()]
        raise NotFoundError(errors[0]["detail"], errors=errors)
    failed = {
        where: of_medium(error, media_id)
        for where, media_id in places.items()
        if known[media_id].state == MediaState.FAILED and (error := known[media_id].error) is not None
    }
    if failed:
        raise MediaFailedError(next(iter(failed.values())), failed)


def check_look(video: Media, reference: Media | None, look: WantedLook, where: str) -> None:
    """Raise `ValidationFailedError` when a look does not fit its media, as far as they are known yet.

    ``where`` the video stands in the request, as a JSON pointer.
    """
    check_role(video, where)
    chosen = () if look.options.faces == "all" else look.options.faces
    missing = [face for face in chosen if face >= len(video.faces)]
    if video.state == MediaState.READY and missing:
        raise ValidationFailedError.at(f"{look.place}/faces", no_face(video, missing[0]))
    _check_reference(reference, look)


def check_role(video: Media, where: str) -> None:
    """Raise `ValidationFailedError` for a reference, whose colours are not changed."""
    if video.role != Role.VIDEO:
        detail = f"{video.id} is a reference; upload the file to /videos to change its colours"
        raise ValidationFailedError.at(where, detail)


def _check_container(video: Media, output: WantedOutput) -> None:
    is_image = video.content_type.startswith("image/")
    allowed = IMAGE_CONTAINERS if is_image else CLIP_CONTAINERS
    if output.options.container is not None and output.options.container not in allowed:
        detail = f"{video.id} is {'an image' if is_image else 'a clip'}: the container must be one of "
        detail += ", ".join(allowed)
        raise ValidationFailedError.at(f"{output.place}/container", detail)


def _check_output(videos: Set[Media], output: WantedOutput) -> None:
    """Still pictures have no codec and no sound: what is asked for in vain is refused, not passed over."""
    if any(not video.content_type.startswith("image/") for video in videos):
        return
    options = output.options
    names = sorted(name for name in _OF_CLIPS & options.model_fields_set if getattr(options, name) is not None)
    if names:
        which = ", ".join(sorted(video.id for video in videos))
        detail = f"of clips only, and {which} is an image"
        errors = [{"pointer": f"{output.place}/{name}", "detail": detail} for name in names]
        raise ValidationFailedError(f"{output.place}/{names[0]}: {detail}", errors=errors)


def _check_reference(reference: Media | None, look: WantedLook) -> None:
    face = look.options.reference_face
    if reference is None or reference.state != MediaState.READY or face is None or face < len(reference.faces):
        return
    raise ValidationFailedError.at(f"{look.place}/reference_face", no_face(reference, face))


def check_apart(known: Mapping[str, Media], look: WantedLook) -> None:
    """Two videos that exchange their colours are not the same bytes, whatever their settings."""
    if look.exchange is None and known[look.video_id].sha256 == known[look.reference_id].sha256:
        detail = f"{look.reference_id} is the same clip; give `a` alone, with the two faces to exchange"
        raise ValidationFailedError.at("/b", detail)
