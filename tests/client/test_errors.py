"""Errors that go to another process."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from pvg_client import ApiError, JobFailed
from pvg_client.models import Job, Problem
from tests.client.test_retries import JOB

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
