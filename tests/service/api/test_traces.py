"""The `traceparent` of a request goes with the jobs it makes, and is named in the log."""

from __future__ import annotations

import structlog

from tests.service.api.test_media import upload
from tests.service.fixtures import MP4, PNG, Api, job_of, make_ready
from tests.waiting import until

TRACE = "0af7651916cd43dd8448eb211c80319c"
HEADER = {"traceparent": f"00-{TRACE}-b7ad6b7169203331-01"}


def test_a_job_has_the_trace_of_its_request(api: Api) -> None:
    sent = api.client.post("/v1/videos", content=MP4, headers=HEADER).json()
    assert api.client.get(f"/v1/jobs/{sent['job']}").json()["traceparent"] == HEADER["traceparent"]
    make_ready(api.services, sent["id"])
    body = {"video": sent["id"], "looks": [{"reference": sent["id"]}]}
    made = api.client.post("/v1/transfer", json=body, headers=HEADER).json()
    job = job_of(api.services.database, made["id"])
    assert job.traceparent == HEADER["traceparent"]


def test_the_log_names_the_trace_of_a_request(api: Api) -> None:
    with structlog.testing.capture_logs(processors=[structlog.contextvars.merge_contextvars]) as lines:
        api.client.get("/v1/videos", headers=HEADER)
        api.client.get("/v1/references")
        # a line is written after the answer
        until(lambda: sum(line["event"] == "request" for line in lines) == 2)
    named = {line["path"]: line.get("trace_id") for line in lines if line["event"] == "request"}
    assert named == {"/v1/videos": TRACE, "/v1/references": None}


def test_the_log_names_what_a_request_has_made_and_nothing_that_opens_it(api: Api) -> None:
    head = {"Tus-Resumable": "1.0.0", "Upload-Length": "100"}
    with structlog.testing.capture_logs(processors=[structlog.contextvars.merge_contextvars]) as lines:
        video = api.client.post("/v1/videos", content=MP4).json()["id"]
        link = api.client.post("/v1/uploads/link", json={}).json()
        begun = api.client.post(link["url"], headers=head)
        api.client.get(f"/v1/videos/{video}")
        until(lambda: sum(line["event"] == "request" for line in lines) == 4)
    assert "signature=" in begun.headers["Location"]
    assert [line.get("location") for line in lines if line["event"] == "request"] == [
        f"/v1/videos/{video}",
        None,
        f"/v1/uploads/{link['id']}",
        None,
    ]
    assert "signature" not in str(lines)


def test_a_request_without_one_gives_none_and_takes_none_over(api: Api) -> None:
    upload(api, "/videos")
    api.client.get("/v1/videos", headers=HEADER)
    for headers in ({}, {"traceparent": "00-garbage"}):
        sent = api.client.post("/v1/references", content=PNG + str(headers).encode(), headers=headers).json()
        assert api.client.get(f"/v1/jobs/{sent['job']}").json()["traceparent"] is None


def test_no_answer_carries_a_trace_on(api: Api) -> None:
    answer = api.client.get("/v1/videos", headers=HEADER)
    assert not [name for name in answer.headers if name.startswith("trace")]
