"""The whole service tells receivers of webhooks that are down, slow, failing or redirecting: R16."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from scripts.samples import Samples
from tests.promises import Drill
from tests.service.receivers import Receiver
from tests.waiting import until
from tests.worker.serving import running_service

#: less than the slow one takes, and more than the others need on a busy machine
TIMEOUT_S = 10


@pytest.mark.slow
def test_receivers_that_fail_are_told_later_and_jobs_do_not_notice(
    tmp_path: Path, samples: Samples, promise: Callable[..., Drill]
) -> None:
    drill = promise("R16", wanted="told later, once each, signatures verify; jobs as without them")
    trap, fine = Receiver(), Receiver()
    down, slow = Receiver(), Receiver(hangs=1)
    failing, redirecting = Receiver(answers=(500, 204)), Receiver(answers=(302, 204), location=trap.url)
    receivers = [down, slow, failing, redirecting]
    settings = {"allow_private_networks": "true", "webhook_timeout_s": str(TIMEOUT_S)}
    with running_service(tmp_path, **settings) as service, ExitStack() as servers:
        for one in (trap, fine, slow, failing, redirecting):
            servers.enter_context(one.listening())
        video = service.ready("/videos", samples.portrait)
        reference = service.ready("/references", samples.dark_portrait)

        def transfer(receiver: Receiver, **look: Any) -> str:
            asked = {"video": video["id"], "looks": [{"reference": reference["id"], **look}]}
            answer = service.client.post("/transfer", json=asked | {"webhook": {"url": receiver.url}})
            job_id: str = answer.raise_for_status().json()["id"]
            return job_id

        def deliveries(of: str) -> dict[str, dict[str, Any]]:
            found = service.client.get(f"/webhooks?job={of}").raise_for_status().json()["data"]
            return {one["url"]: one for one in found}

        # the same transfer, asked for four times, is one job with four receivers
        (job_id,) = {transfer(receiver) for receiver in receivers}
        job = service.finished(job_id)
        began = time.monotonic()
        until(lambda: deliveries(job_id)[down.url]["last_error"] is not None)
        first = deliveries(job_id)
        servers.enter_context(down.listening())
        # meanwhile others are served: another job, and its receiver
        other = service.finished(transfer(fine, strength=0.5))
        fine.wait_for(1)
        # a receiver that fails again on a slow machine is told a minute later
        until(lambda: {one["state"] for one in deliveries(job_id).values()} == {"delivered"}, 180)
        told_s = time.monotonic() - began
        last = deliveries(job_id)
        secret = service.client.get("/webhooks/secret").json()["secret"]
        log = service.log.read_text()
    said = [one.got[-1].verified(secret) for one in (*receivers, fine)]
    numbers = [last[one.url]["attempts"] for one in receivers]
    drill.measured = f"all four after {told_s:.1f} s, on attempts {numbers}; jobs on attempt {job['attempt']}"
    assert {one["type"] for one in said} == {"job.succeeded"}
    assert [one["data"]["id"] for one in said] == [job_id] * 4 + [other["id"]]
    assert said[0]["data"]["looks"][0]["result"] == job["looks"][0]["result"]
    for receiver in receivers:
        assert {arrived.id for arrived in receiver.got} == {first[receiver.url]["id"]} == {last[receiver.url]["id"]}
        assert last[receiver.url]["attempts"] >= 2
    assert trap.got == []
    assert [(one["state"], one["attempt"]) for one in (job, other)] == [("succeeded", 1)] * 2
    assert "not-for-logs" not in log
    assert secret not in log
