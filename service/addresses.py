"""Where things are: everything is under `/v1`, and the same without it is an alias that is in no answer."""

from __future__ import annotations

from typing import Final

from service.settings import Settings

#: the version of the interface, as the path has it
PREFIX: Final = "/v1"


def of_job(settings: Settings, job_id: str) -> str:
    """Where a job is."""
    return f"{_base(settings)}/jobs/{job_id}"


def of_media(settings: Settings, role: str, media_id: str) -> str:
    """Where a medium of this role is."""
    return f"{_base(settings)}/{role}s/{media_id}"


def of_result(settings: Settings, result_id: str) -> str:
    """Where a result's file is."""
    return f"{_base(settings)}/results/{result_id}"


def of_upload(settings: Settings, upload_id: str) -> str:
    """Where an upload in pieces is."""
    return f"{_base(settings)}/uploads/{upload_id}"


def unversioned(path: str) -> str:
    """The path of a request without the version: the same by either address."""
    return path.removeprefix(PREFIX) if path.startswith(f"{PREFIX}/") else path


def _base(settings: Settings) -> str:
    """What the paths of answers begin with: what a proxy in front removes, then the version."""
    return settings.root_path + PREFIX
