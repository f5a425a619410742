"""A vectorize job: source -> asset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pvg
from pvg.errors import PvgError
from pvg.video import MediaLimits
from service.catalog import Asset, Media, Role, media, vectorize_request
from service.settings import Settings
from service.storage import file_sha256
from worker.lease import LeaseLostError
from worker.run import Run

#: part of the job that each stage of the vectoriser takes; storing takes the rest
CLIP_SPANS = {"vectorize": (0.0, 0.9), "second reading": (0.9, 0.97)}  # few clips need a second reading
REFERENCE_SPANS = {"landmarks": (0.0, 0.6), "best frame": (0.6, 0.9)}


def vectorize(run: Run) -> bool:
    """Do the job. False when its lease was lost at the end, and nothing was published."""
    assert run.job.media_id is not None  # noqa: S101 - every job of this kind has one
    with run.database.read() as session:
        medium = media.get(session, run.job.media_id)
    if medium is None:  # deleted, and the lease was revoked with it
        raise LeaseLostError
    draft = run.draft(".pvg")
    with run.storage.local_path(medium.source_key) as source, run.timed("vectorize_s"):
        summary = _vectorize(run, medium, source, draft)
    with run.timed("store_s"):
        # the lease is part of the name: two attempts never write, or clear away, each other's blob
        owner = f"{medium.id}-{run.lease.token[:12]}"
        key = run.storage.key("asset", file_sha256(draft), owner, ".pvg")
        size = draft.stat().st_size
        run.keeper.check()
        run.storage.put(draft, key)
    faces, warnings = _faces(summary["faces"])
    run.keeper.flush()
    asset = Asset(key, size, summary["media"], faces, warnings)
    with run.database.write() as session:
        now = run.database.now()
        unneeded = media.finish(session, run.lease, asset, now=now, timings=run.timings)
    for blob in [key] if unneeded is None else unneeded:
        run.storage.delete(blob)
    return unneeded is not None


def _vectorize(run: Run, medium: Media, source: Path, draft: Path) -> dict[str, Any]:
    request = vectorize_request(run.job)
    is_reference = request.role is Role.REFERENCE
    run.progress.expect(REFERENCE_SPANS if is_reference else CLIP_SPANS)
    try:
        with pvg.vectorize(
            source,
            asset=draft,
            reference=is_reference,
            mask=request.settings.mask,
            matching=request.settings.matching,
            limits=media_limits(run.settings),
            progress=run.progress,
            min_face_px=run.settings.min_face_px,
            advised_face_px=run.settings.warn_face_px,
        ) as video:
            return video.summary()
    except PvgError as error:
        # the blob's name means nothing to the client
        shown = medium.filename or "the file"
        raise type(error)(str(error).replace(source.name, shown)) from error


def media_limits(settings: Settings) -> MediaLimits:
    """The limits of the settings, as the method takes them."""
    return MediaLimits(
        max_pixels=settings.max_pixels,
        max_frames=settings.max_frames,
        max_duration_s=settings.max_duration_s,
        max_frame_rate=settings.max_frame_rate,
        max_streams=settings.max_streams,
    )


_SHOWN = ("index", "first_frame", "last_frame", "width_px", "skin_rgb", "warnings")


def _faces(found: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[str]]:
    """What is shown of each face, and the warnings of all."""
    warnings = [f"face {face['index']}: {warning}" for face in found for warning in face["warnings"]]
    return [{name: face[name] for name in _SHOWN} for face in found], warnings
