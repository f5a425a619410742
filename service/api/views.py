"""The answers that show records."""

from __future__ import annotations

from collections.abc import Sequence

from service.api.schemas import JobBody, LookBody, MediaBody, ProgressBody, VectorBody
from service.catalog import ENDED, Job, Look, Media


def media_body(media: Media) -> MediaBody:
    """The answer that shows a medium."""
    return MediaBody.model_validate(
        {
            "id": media.id,
            "state": media.state,
            "job": media.job_id,
            "filename": media.filename,
            "content_type": media.content_type,
            "size_bytes": media.size_bytes,
            "sha256": media.sha256,
            "settings": VectorBody(mask=media.mask, matching=media.matching),
            "media": media.info,
            "faces": media.faces,
            "warnings": media.warnings,
            "error": media.error,
            "created_at": media.created_at,
            "expires_at": media.expires_at,
        }
    )


def job_body(job: Job, looks: Sequence[Look], *, root_path: str = "") -> JobBody:
    """The answer that shows a job. A look shares its job's state: all are rendered together."""
    return JobBody.model_validate(
        {
            "id": job.id,
            "kind": job.kind,
            "state": job.state,
            "done": job.state in ENDED,
            "attempt": job.attempt,
            "progress": ProgressBody(
                stage=job.stage,
                fraction=job.fraction,
                frames_done=job.frames_done,
                frames_total=job.frames_total,
            ),
            "media": job.media_id,
            "looks": [_look_body(job, look, root_path) for look in looks],
            "error": job.error,
            "timings": job.timings,
            "created_at": job.created_at,
            "started_at": job.started_at,
            "finished_at": job.finished_at,
        }
    )


def _look_body(job: Job, look: Look, root_path: str) -> LookBody:
    report = look.report
    return LookBody(
        state=job.state,
        video=look.video_id,
        reference=look.reference_id,
        options=look.params,
        settings=None if report is None else VectorBody(mask=report["mask"], matching=report["matching"]),
        warnings=[] if report is None else report["warnings"],
        result=look.result_id,
        url=f"{root_path}/results/{look.result_id}" if look.result_id else None,
    )
