from __future__ import annotations

import json
from pathlib import Path

from service.api.views import job_body
from service.catalog import Database, Job, JobState
from service.errors import stored_problem
from service.settings import Settings
from service.webhooks import payload
from tests.service.fixtures import add_media, add_transfer


def test_a_failure_and_an_address_are_told_as_the_job_itself_shows_them(database: Database, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, root_path="/pvg")
    medium = add_media(database)
    job_id = add_transfer(database, medium, medium)
    with database.write() as session:
        job = session.get(Job, job_id)
        assert job is not None
        job.state, job.finished_at = JobState.FAILED, database.now()
        job.error = stored_problem("no-face", "no face was found in the clip")
        said = json.loads(payload(job, [], settings=settings))
        shown = job_body(job, [], {}, {}, settings).model_dump(mode="json")
    assert (said["type"], said["data"]["url"]) == ("job.failed", f"/pvg/v1/jobs/{job_id}")
    assert (
        said["data"]["error"]
        == shown["error"]
        == {
            "type": "/pvg/docs/problems#no-face",
            "code": "no-face",
            "title": "No face was found",
            "detail": "no face was found in the clip",
        }
    )
