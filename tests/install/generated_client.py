"""The main path by the client that openapi-python-client makes of the schema, in an environment that has nothing else.

Arguments: the service's URL, a video, a reference, and where the result goes.
"""

import hashlib
import sys
from pathlib import Path

from pvg_generated import Client
from pvg_generated.api.jobs import get_job
from pvg_generated.api.references import create_reference_from_form
from pvg_generated.api.results import get_result
from pvg_generated.api.service import get_limits
from pvg_generated.api.transfer import create_transfer
from pvg_generated.api.videos import create_video, delete_video, get_video
from pvg_generated.models import (
    CreateReferenceFromFormBody,
    JobBody,
    LookRequest,
    MediaBody,
    Problem,
    TransferRequest,
)
from pvg_generated.types import File


def finished(client: Client, job_id: str) -> JobBody:
    for _ in range(30):
        job = get_job.sync(job_id, client=client, wait=20)
        assert isinstance(job, JobBody), job
        if job.done:
            assert job.state == "succeeded", job
            return job
    raise AssertionError(f"{job_id} is not done")


def main() -> None:
    url, video_path, reference_path, result_path = sys.argv[1:]
    client = Client(base_url=url, timeout=60)
    limits = get_limits.sync(client=client)
    assert limits is not None
    assert "mp4" in limits.upload.formats
    with open(video_path, "rb") as file:
        video = create_video.sync(client=client, body=File(payload=file), idempotency_key="once")
    with open(reference_path, "rb") as file:
        form = CreateReferenceFromFormBody(file=File(payload=file, file_name="reference.jpg"), metadata=["order:42"])
        reference = create_reference_from_form.sync(client=client, body=form)
    assert isinstance(video, MediaBody), video
    assert isinstance(reference, MediaBody), reference
    assert reference.metadata["order"] == "42"
    finished(client, video.job)
    finished(client, reference.job)
    ready = get_video.sync(video.id, client=client)
    assert isinstance(ready, MediaBody)
    assert ready.media is not None
    assert ready.media.width > 0
    assert ready.faces[0].width_px > 0
    asked = create_transfer.sync(
        client=client, body=TransferRequest(video=video.id, looks=[LookRequest(reference=reference.id, strength=0.8)])
    )
    assert isinstance(asked, JobBody), asked
    done = finished(client, asked.id)
    assert done.timings is not None
    (look,) = done.looks
    content = get_result.sync(look.result, client=client)
    assert isinstance(content, File), content
    data = content.payload.read()
    assert hashlib.sha256(data).hexdigest() == look.sha256
    Path(result_path).write_bytes(data)
    nobody = get_video.sync("vid_0", client=client)
    assert isinstance(nobody, Problem)
    assert (nobody.code, nobody.status) == ("not-found", 404)
    assert delete_video.sync_detailed(video.id, client=client).status_code == 204
    print("done")


if __name__ == "__main__":
    main()
