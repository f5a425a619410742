"""Temporary files whose writer is gone. They may hold a face, so they must not outlive what they were made from."""

from __future__ import annotations

from datetime import timedelta

from service.catalog import sweep
from service.catalog.database import Database
from service.settings import Settings
from service.storage import Storage


def clear_drafts(settings: Settings, database: Database, storage: Storage) -> int:
    """Remove the drafts of jobs that nobody works on, and any others not touched for long. Returns their number.

    A job is claimed before its first draft is made, and its last one is published or removed before it ends: a draft
    whose job is not held was left by a process that was killed.
    """
    by_job = storage.drafts_of_jobs()
    removed = 0
    if by_job:
        with database.read() as session:
            held = sweep.held(session, by_job)
        removed = sum(storage.remove_drafts(paths) for job_id, paths in by_job.items() if job_id not in held)
    return removed + storage.clear_drafts(before=database.now() - timedelta(seconds=settings.draft_ttl_s))
