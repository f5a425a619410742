from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from service import errors
from service.api.schemas import TransferRequest
from service.errors import ALSO_OF_FAILED, PROBLEMS, Limit, MediaFailedError, ServiceError, message_of, stored_problem

API = Path(__file__).parents[2] / "docs" / "api.md"


def test_every_error_is_of_a_listed_kind() -> None:
    kinds = [one.kind for one in vars(errors).values() if isinstance(one, type) and issubclass(one, ServiceError)]
    assert len(kinds) > 10
    assert all(PROBLEMS[kind.type] is kind for kind in kinds)


def test_titles_are_of_one_kind_only() -> None:
    assert len({problem.title for problem in PROBLEMS.values()}) == len(PROBLEMS)


def test_the_documentation_lists_every_kind_with_its_status() -> None:
    section = API.read_text().split("## Errors")[1]
    listed = {
        (kind, int(status))
        for status, text in re.findall(r"^\| (\d{3}) \| (.*) \|$", section, re.MULTILINE)
        for kind in re.findall(r"`([a-z-]+)`", text)
    }
    # stored problems of these kinds are told of with 422, whatever the status of such an answer is
    stored = {(kind, 422) for kind in ALSO_OF_FAILED}
    assert listed == {(problem.type, problem.status) for problem in PROBLEMS.values()} | stored


def test_no_name_of_the_code_is_told() -> None:
    with pytest.raises(ValidationError) as refused:
        TransferRequest.model_validate({"video": [], "looks": ["a"], "output": 1})
    assert "Request" not in str([message_of(one) for one in refused.value.errors()])


def test_the_problem_of_a_failed_medium_keeps_its_own_kind() -> None:
    stored = stored_problem("no-face", "no face found in a.mp4")
    problem = MediaFailedError(stored, {"/video": stored}).problem()
    assert problem == {
        "type": "/docs/problems#no-face",
        "code": "no-face",
        "title": "No face was found",
        "status": 422,
        "detail": "no face found in a.mp4",
        "errors": [{"pointer": "/video", "detail": "no face found in a.mp4"}],
    }


def test_a_limit_is_told_with_the_problem_of_a_failed_medium() -> None:
    stored = stored_problem("too-long", "a.mp4 lasts 9.0 s", limit=Limit(3.0, "seconds"))
    problem = MediaFailedError(stored, {"/video": stored}).problem()
    assert (problem["code"], problem["limit"], problem["unit"]) == ("too-long", 3.0, "seconds")


def test_only_listed_kinds_are_stored() -> None:
    with pytest.raises(KeyError):
        stored_problem("unheard-of", "x")
