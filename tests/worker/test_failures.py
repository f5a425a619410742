from __future__ import annotations

import time
from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from service.errors import ALSO_OF_FAILED, PROBLEMS
from worker.failures import OptionError, is_expected, lacks_room, problem_of, problem_of_picture, without_paths
from worker.sandbox import CrashError, FileLimitError, MemoryLimitError, MethodError, NoRoomError, TimeLimitError


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (MethodError("NoFaceError", "no face found in a.mp4"), "no-face"),
        (MethodError("FaceTooSmallError", "the largest face is 40 px wide"), "face-too-small"),
        (MethodError("MediaError", "a.mp4 is not a video"), "media-invalid"),
        (MethodError("AssetError", "a.pvg is truncated"), "asset-invalid"),
        (MethodError("OptionError", "there is no face 3"), "validation-failed"),
        (MethodError("TooLargeError", "it needs 9.1 GB"), "too-large"),
        (MethodError("TooLongError", "a.mp4 lasts 9.0 s"), "too-long"),
        (OptionError("mp4 does not fit an image"), "validation-failed"),
        (TimeLimitError("it took longer"), "time-limit"),
        (MemoryLimitError("it needs more than 4 GB"), "too-large"),
        (FileLimitError("it is longer than 4 GB"), "too-large"),
    ],
)
def test_errors_of_the_input_are_shown_with_their_message(error: Exception, kind: str) -> None:
    problem = problem_of(error)
    assert (problem["type"], problem["detail"]) == (kind, str(error))
    assert problem["title"]
    assert is_expected(error)


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (RuntimeError("/srv/secret"), "internal-error"),
        (MethodError("RuntimeError", "/srv/secret"), "internal-error"),
        (MethodError("ModelError", "/srv/secret"), "internal-error"),
        (CrashError("/srv/secret"), "worker-crashed"),
    ],
)
def test_internals_are_not_shown(error: Exception, kind: str) -> None:
    problem = problem_of(error)
    assert problem["type"] == kind
    assert "secret" not in str(problem)
    assert not is_expected(error)


@pytest.mark.parametrize(
    "error",
    [
        NoRoomError("x"),
        OSError(28, "x"),
        OperationalError("x", None, OSError("x")),
        RuntimeError("x"),
        MemoryLimitError("x"),
    ],
)
def test_the_kind_of_any_failure_is_one_of_those_that_a_medium_is_told_with(error: Exception) -> None:
    kind = problem_of(error)["type"]
    assert kind in ALSO_OF_FAILED or PROBLEMS[kind].status == 422


def test_a_process_names_no_kind_of_its_own() -> None:
    assert problem_of(MethodError("<b>", "x"))["type"] == "internal-error"
    assert problem_of(MethodError("MediaError", "a\nb\x00" + "c" * 9999))["detail"] == "a b " + "c" * 496


@pytest.mark.parametrize(
    "error",
    [
        MethodError("TooLongError", "a.mp4 lasts 9.0 s", "", (3.0, "seconds")).saying("it lasts 9.0 s"),
        MemoryLimitError("it needs more", (3.0, "seconds")),
    ],
)
def test_a_limit_that_was_gone_over_is_kept_with_the_problem(error: Exception) -> None:
    problem = problem_of(error)
    assert (problem["limit"], problem["unit"]) == (3.0, "seconds")
    assert "limit" not in problem_of(MethodError("TooLongError", "it lasts 9.0 s"))


def test_a_face_that_is_not_in_the_frame_of_a_picture_is_said_where_it_was_asked_for() -> None:
    detail = "face 0 is not in frame 5; it is in frames 7 to 9"
    problem = problem_of_picture(MethodError("AbsentFaceError", detail))
    assert (problem["type"], problem["detail"]) == ("validation-failed", detail)
    assert problem["errors"] == [{"pointer": "/face", "detail": detail}]


def test_a_picture_that_was_not_made_this_time_may_be_asked_for_again() -> None:
    for error in (TimeLimitError("it took longer"), CrashError("/srv/secret")):
        problem = problem_of_picture(error)
        assert problem["type"] == "unavailable"
        assert "secret" not in str(problem)
    assert problem_of_picture(MemoryLimitError("it needs more than 4 GB"))["type"] == "too-large"
    error = MethodError("MediaError", "/srv/secret is damaged (input/output error)", fault="possible")
    assert not is_expected(error)
    assert problem_of_picture(error)["type"] == "unavailable"
    assert "secret" not in str(problem_of_picture(error))


def test_paths_in_a_long_message_are_replaced_in_one_go() -> None:
    names = {Path("/srv/pvg/clip.mp4"): "vid_1"}
    began = time.thread_time()
    assert without_paths("a" * 20_000 + " '/tmp/x/clip.mp4' and clip.mp4", names) == "a" * 20_000 + " 'vid_1' and vid_1"
    assert time.thread_time() - began < 1


def test_errors_that_led_to_each_other_are_looked_through_once() -> None:
    first, second = RuntimeError("one"), RuntimeError("other")
    first.__cause__, second.__cause__ = second, first
    assert not lacks_room(first)
    second.__cause__ = NoRoomError("the disk is full")
    assert lacks_room(first)
