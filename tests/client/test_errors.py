"""Errors that go to another process, and what is refused before anything is sent."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from pvg_client import ApiError, AsyncClient, Client, JobFailed
from pvg_client.models import Job, Problem
from tests.client.test_retries import JOB, Script, good

GONE = Problem("gone", "Gone", "its time was over", status=410, request_id="req_1")


def pickled(error: Exception) -> Exception:
    made: Exception = pickle.loads(pickle.dumps(error))
    return made


@pytest.mark.parametrize("way", [copy.copy, pickled])
def test_errors_are_the_same_elsewhere(way: Callable[[Any], Any]) -> None:
    error = ApiError(410, GONE, 2.5)
    error.add_note("of the third clip")
    again = way(error)
    assert (type(again), str(again)) == (ApiError, str(error))
    assert (again.status, again.problem, again.retry_after_s) == (410, GONE, 2.5)
    assert again.__notes__ == ["of the third clip"]
    failed = JobFailed(Job.of(JOB | {"state": "failed", "error": {"code": "no-face", "title": "No face"}}))
    other = way(failed)
    assert (type(other), str(other)) == (JobFailed, str(failed))
    assert (other.job, other.problem) == (failed.job, failed.problem)


def test_a_job_that_failed_says_which_of_its_media_is_at_fault() -> None:
    told = [{"pointer": f"/looks/{number}/reference", "detail": "no face"} for number in (3, 5)]
    error = {"code": "no-face", "title": "No face was found", "detail": "no face", "errors": told}
    words = str(JobFailed(Job.of(JOB | {"state": "failed", "error": error})))
    assert words == "transfer job_1 failed: No face was found. no face (/looks/3/reference, /looks/5/reference)"


@pytest.mark.parametrize("kind", [Client, AsyncClient])
@pytest.mark.parametrize("key", ["pvg_a\npvg_b", "pvg_a b", "pvg_ä", "pvg_\x00a", "", " \n"])
def test_a_key_that_no_header_carries_is_refused_and_not_told(kind: type[Client | AsyncClient], key: str) -> None:
    with pytest.raises(ValueError, match="key") as caught:
        kind(key=key)
    assert "pvg_" not in str(caught.value)


def test_the_line_break_after_a_key_is_left_away() -> None:
    script = Script(good())
    with Client(key="pvg_a\n", transport=script) as client:
        client.job("job_1")
    assert script.requests[0].headers["authorization"] == "Bearer pvg_a"


@pytest.mark.parametrize(
    "url", ["http://me:secret@service.test", "https://secret@service.test/pvg", "ftp://a:secret@b"]
)
def test_an_address_with_a_password_is_refused_and_not_told(url: str) -> None:
    with pytest.raises(ValueError, match="password") as caught:
        Client(url, transport=httpx.MockTransport(lambda _: good()))
    assert "secret" not in str(caught.value)
