"""What may go wrong."""

from __future__ import annotations

from typing import Any

from pvg_client.models import FieldError, Job, Problem


class PvgClientError(Exception):
    """Every error of this client's own."""


class UnreachableError(PvgClientError):
    """The service did not answer, also when it was asked again; `worth_another` is False when asking cannot help."""

    def __init__(self, message: str, *, worth_another: bool = True) -> None:
        super().__init__(message)
        self.worth_another = worth_another


class ApiError(PvgClientError):
    """An answer that is an error. ``retry_after_s`` is when the service says that asking again may help."""

    def __init__(self, status: int, problem: Problem, retry_after_s: float | None = None) -> None:
        where = f" ({problem.request_id})" if problem.request_id else ""
        super().__init__(f"{status} {problem.title}: {problem.detail}{where}")
        self.status = status
        self.problem = problem
        self.retry_after_s = retry_after_s

    def __reduce__(self) -> tuple[Any, ...]:
        # without this a copy, and one for another process, would be made of the words alone
        return type(self), (self.status, self.problem, self.retry_after_s), self.__dict__

    @property
    def code(self) -> str:
        """What kind of problem it is, for programs: `no-face`, `quota-exceeded`, …"""
        return self.problem.code

    @property
    def type(self) -> str:
        """Where the service tells of this kind of problem."""
        return self.problem.type

    @property
    def title(self) -> str:
        """What kind of problem it is, in words."""
        return self.problem.title

    @property
    def detail(self) -> str:
        """What is wrong here."""
        return self.problem.detail

    @property
    def errors(self) -> tuple[FieldError, ...]:
        """The values that are not allowed."""
        return self.problem.errors

    @property
    def request_id(self) -> str | None:
        """What the service's log calls the request."""
        return self.problem.request_id


class JobFailed(PvgClientError):  # noqa: N818 - it is told of a job, as `state` has it
    """A job has ended without its results: it has failed, was canceled, or has expired."""

    def __init__(self, job: Job) -> None:
        problem = job.error or Problem(job.state, f"The job is {job.state}")
        told = f"{job.kind} {job.id} {job.state}: {problem.title}. {problem.detail}".rstrip(". ")
        # of many media the one that is at fault
        places = ", ".join(one.pointer for one in problem.errors if one.pointer)
        super().__init__(f"{told} ({places})" if places else told)
        self.job = job
        self.problem = problem

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.job,), self.__dict__


class DamagedError(PvgClientError):
    """The bytes that arrived are not those that were sent, also when they were fetched again, or the file changed."""


class WebhookError(PvgClientError):
    """A webhook is not what the service sent, or not for now."""
