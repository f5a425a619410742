from __future__ import annotations

import pytest
from celery.exceptions import SoftTimeLimitExceeded

from pvg.errors import AssetError, FaceTooSmallError, MediaError, ModelError, NoFaceError, SolverError
from worker.failures import OptionError, is_expected, problem_of


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (NoFaceError("no face found in a.mp4"), "no-face"),
        (FaceTooSmallError("the largest face is 40 px wide"), "face-too-small"),
        (MediaError("a.mp4 is not a video"), "media-invalid"),
        (AssetError("a.pvg is truncated"), "asset-invalid"),
        (OptionError("there is no face 3"), "validation-failed"),
    ],
)
def test_errors_of_the_input_are_shown_with_their_message(error: Exception, kind: str) -> None:
    problem = problem_of(error)
    assert (problem["type"], problem["detail"]) == (kind, str(error))
    assert problem["title"]
    assert is_expected(error)


@pytest.mark.parametrize("error", [RuntimeError("/srv/secret"), ModelError("/srv/secret"), SolverError("/srv/secret")])
def test_internals_are_not_shown(error: Exception) -> None:
    problem = problem_of(error)
    assert problem["type"] == "internal-error"
    assert "secret" not in str(problem)


def test_the_time_limit_is_its_own_problem() -> None:
    assert problem_of(SoftTimeLimitExceeded())["type"] == "time-limit"
