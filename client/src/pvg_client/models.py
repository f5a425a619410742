"""What the service speaks of, as frozen values. What a newer service adds is passed over, and is there under `raw`.

A part without a `raw`, such as a result or an estimate, has it in that of the look, job or usage it stands in. Links,
the secret of webhooks and what an `ApiError` tells have none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any, Literal, Self, TypeVar

Role = Literal["video", "reference"]
Body = Mapping[str, Any]
T = TypeVar("T")


def said(given: Mapping[str, T | None]) -> dict[str, T]:
    """What of a request is said: what is None is left to the service."""
    return {name: value for name, value in given.items() if value is not None}


def _known(cls: Any, body: Body) -> dict[str, Any]:
    """The members of an answer that this version of the client has a field for."""
    return {one.name: body[one.name] for one in fields(cls) if one.name in body}


def _time(value: str | None) -> datetime | None:
    return None if value is None else datetime.fromisoformat(value)


@dataclass(frozen=True, slots=True)
class FieldError:
    """One value of a request that is not allowed: where it is (a JSON pointer, RFC 6901) and what is wrong with it."""

    detail: str
    pointer: str | None = None

    @classmethod
    def all_of(cls, said: object) -> tuple[Self, ...]:
        """Read what is one; others who answer in the service's place have errors of their own kinds."""
        ones = [one for one in said if isinstance(one, dict)] if isinstance(said, list) else []
        texts = [{name: value for name, value in one.items() if isinstance(value, str)} for one in ones]
        return tuple(cls(**_known(cls, one)) for one in texts if "detail" in one)


@dataclass(frozen=True, slots=True)
class Problem:
    """Why something did not work (RFC 9457). Those of jobs and media have no status, instance and request."""

    #: the kind, the same everywhere: `no-face`, `quota-exceeded`, …; empty when it is not the service that answers
    code: str
    title: str
    #: where the service tells of the kind
    type: str = "about:blank"
    detail: str = ""
    status: int | None = None
    instance: str | None = None
    request_id: str | None = None
    errors: tuple[FieldError, ...] = ()
    #: the most that is allowed of what was gone over, and of what
    limit: float | None = None
    unit: str | None = None

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one. Members that are of no such type are somebody else's, and passed over."""
        kinds: dict[str, Any] = {"status": int, "limit": int | float}
        own = ((name, value) for name, value in _known(cls, body).items() if name != "errors")
        told = {name: value for name, value in own if isinstance(value, kinds.get(name, str))}
        return cls(**{"code": "", "title": ""} | told, errors=FieldError.all_of(body.get("errors")))


def _problem(body: Body | None) -> Problem | None:
    return None if body is None else Problem.of(body)


@dataclass(frozen=True, slots=True)
class Picture:
    """What a file is: sizes in pixels, as shown; no frame rate for a still picture."""

    kind: str
    width: int
    height: int
    frame_rate: float | None = None
    frame_count: int = 1
    duration_s: float = 0.0
    codec: str = ""
    pixel_format: str = ""
    has_audio: bool = False
    rotation: int = 0
    color: str = ""
    raw: Body = field(default_factory=dict, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Face:
    """One face of a medium: its frames, its width in pixels, and its skin, 0–255 RGB.

    `box` is x, y, width and height in pixels of `frame`, in which it is seen well; None where that is not known.
    """

    index: int
    first_frame: int
    last_frame: int
    width_px: float
    skin_rgb: tuple[int, int, int]
    warnings: tuple[str, ...] = ()
    frame: int | None = None
    box: tuple[int, int, int, int] | None = None
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        r, g, b = body["skin_rgb"]
        box = None if body.get("box") is None else tuple(body["box"])
        warnings = tuple(body.get("warnings", ()))
        return cls(**_known(cls, body) | {"skin_rgb": (r, g, b), "box": box, "warnings": warnings, "raw": body})


@dataclass(frozen=True, slots=True)
class Medium:
    """A video or a reference. `media` and `faces` are there once it is `ready`, `error` once it has `failed`."""

    id: str
    state: str
    job: str
    filename: str | None
    content_type: str
    size_bytes: int
    sha256: str
    created_at: datetime
    expires_at: datetime
    settings: Body = field(default_factory=dict)
    media: Picture | None = None
    faces: tuple[Face, ...] = ()
    warnings: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    error: Problem | None = None
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @property
    def role(self) -> Role:
        """What it was uploaded as, which its id says."""
        return role_of(self.id)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        media = body.get("media")
        return cls(
            **_known(cls, body)
            | {
                "created_at": _time(body["created_at"]),
                "expires_at": _time(body["expires_at"]),
                "media": None if media is None else Picture(**_known(Picture, media) | {"raw": media}),
                "faces": tuple(Face.of(one) for one in body.get("faces", ())),
                "warnings": tuple(body.get("warnings", ())),
                "error": _problem(body.get("error")),
                "raw": body,
            }
        )


@dataclass(frozen=True, slots=True)
class Look:
    """A look to ask for: a reference and its options (docs/api.md). None is what the service takes by default."""

    reference: str | Medium
    strength: float | None = None
    contrast: float | Literal["auto"] | None = None
    match: Literal["semantic", "color"] | None = None
    makeup: float | Mapping[str, float] | None = None
    light: float | None = None
    scene: float | None = None
    extent: Literal["skin", "face"] | None = None
    reference_face: int | None = None
    protect: Sequence[str] | None = None
    faces: Sequence[int] | Literal["all"] | None = None
    beta: float | None = None
    iterations: int | None = None
    seed: int | None = None

    def body(self) -> dict[str, Any]:
        """The look as the service reads it."""
        given: dict[str, Any] = {one.name: getattr(self, one.name) for one in fields(self)}
        return said(given) | {"reference": id_of(self.reference)}


@dataclass(frozen=True, slots=True)
class Extra:
    """A file made beside a result; `person` counts from 1."""

    part: str
    person: int
    url: str
    size_bytes: int
    content_type: str
    sha256: str
    expires_at: datetime
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        return cls(**_known(cls, body) | {"expires_at": _time(body["expires_at"]), "raw": body})


@dataclass(frozen=True, slots=True)
class Result:
    """A finished file. Size, type, hash and expiry are None after its retention."""

    id: str
    url: str
    size_bytes: int | None = None
    content_type: str | None = None
    sha256: str | None = None
    expires_at: datetime | None = None
    extras: tuple[Extra, ...] = ()


@dataclass(frozen=True, slots=True)
class JobLook:
    """One look of a job; its `result` is there once the job has succeeded, until it is gone: `expired` or `deleted`."""

    state: str
    video: str
    reference: str
    options: Body = field(default_factory=dict)
    settings: Body | None = None
    warnings: tuple[str, ...] = ()
    result: Result | None = None
    result_gone: str | None = None
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        result = None
        if body.get("result") is not None:
            extras = tuple(Extra.of(one) for one in body.get("extras", ()))
            read = {"id": body["result"], "expires_at": _time(body.get("expires_at")), "extras": extras}
            result = Result(**_known(Result, body) | read)
        warnings = tuple(body.get("warnings", ()))
        return cls(**_known(cls, body) | {"warnings": warnings, "result": result, "raw": body})


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is: `fraction`, 0–1, of all of it, the frames of its present stage."""

    stage: str | None = None
    fraction: float = 0.0
    frames_done: int = 0
    frames_total: int = 0


@dataclass(frozen=True, slots=True)
class Eta:
    """When a job should be done, in seconds from its last change: four in five end between `low` and `high`."""

    seconds: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Job:
    """A vectorisation, a transfer or a swap.

    `queue_position` is 1 for the job that is next; None unless it waits for a worker alone. `eta` is None as long as
    nothing like the job has been measured. Of `timings`, in seconds, the parts that it did not have are left out.
    `output` is how its results were asked to be written; None of a vectorisation.
    """

    id: str
    kind: str
    state: str
    done: bool
    attempt: int
    created_at: datetime
    waiting_for: str | None = None
    progress: Progress = field(default_factory=Progress)
    queue_position: int | None = None
    eta: Eta | None = None
    media: str | None = None
    looks: tuple[JobLook, ...] = ()
    output: Body | None = None
    error: Problem | None = None
    timings: Mapping[str, float] | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    traceparent: str | None = None
    started_at: datetime | None = None
    finished_at: datetime | None = None
    expires_at: datetime | None = None
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @property
    def results(self) -> tuple[Result, ...]:
        """The results that are there, in the order of the looks."""
        return tuple(look.result for look in self.looks if look.result is not None)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        times = {name: _time(body.get(name)) for name in ("created_at", "started_at", "finished_at", "expires_at")}
        eta, timings = body.get("eta"), body.get("timings")
        return cls(
            **_known(cls, body)
            | times
            | {
                "progress": Progress(**_known(Progress, body.get("progress") or {})),
                "queue_position": (body.get("queue") or {}).get("position"),
                "eta": None if eta is None else Eta(**_known(Eta, eta)),
                "timings": None if timings is None else {k: s for k, s in timings.items() if s is not None},
                "looks": tuple(JobLook.of(one) for one in body.get("looks", ())),
                "error": _problem(body.get("error")),
                "raw": body,
            }
        )


@dataclass(frozen=True, slots=True)
class Link:
    """An address that needs no key until it expires."""

    url: str
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class UploadLink:
    """An address by which one file may be uploaded without a key until it expires; `id` is that of the upload.

    The file has at most `max_bytes`.
    """

    id: str
    url: str
    expires_at: datetime
    max_bytes: int | None = None


@dataclass(frozen=True, slots=True)
class Upload:
    """A file that arrives in pieces, or by a link. `media` is what it has become, once all of it is there.

    `size_bytes` is None as long as its sender has not said it, and `media` to whom a link alone shows it: it is for the
    key that made the link. `url`, where it goes on with the key, `settings` and `metadata` are told in lists alone.
    """

    id: str
    role: Role
    filename: str | None
    size_bytes: int | None
    offset_bytes: int
    media: str | None
    created_at: datetime
    expires_at: datetime
    url: str | None = None
    settings: Mapping[str, str] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        times = {name: _time(body[name]) for name in ("created_at", "expires_at")}
        return cls(**_known(cls, body) | times | {"raw": body})


@dataclass(frozen=True, slots=True)
class Webhook:
    """One event for one receiver. Its `state` is `waiting` for the job's end, `pending`, `delivered` or `failed`.

    `id` is the `webhook-id`, the same in every attempt; `type` is None while the job goes on.
    """

    id: str
    job: str
    url: str
    state: str
    attempts: int
    created_at: datetime
    type: str | None = None
    next_attempt_at: datetime | None = None
    last_attempt_at: datetime | None = None
    last_status: int | None = None
    last_error: str | None = None
    delivered_at: datetime | None = None
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        names = ("created_at", "next_attempt_at", "last_attempt_at", "delivered_at")
        return cls(**_known(cls, body) | {name: _time(body.get(name)) for name in names} | {"raw": body})


@dataclass(frozen=True, slots=True)
class WebhookSecret:
    """What webhooks are signed with, for `verify_webhook`; until `former_valid_until` with the one before as well.

    Of those before that each is good until the time that was said of it.
    """

    secret: str = field(repr=False)
    created_at: datetime
    former_valid_until: datetime | None = None

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read one."""
        return cls(**_known(cls, body) | {name: _time(body.get(name)) for name in ("created_at", "former_valid_until")})


@dataclass(frozen=True, slots=True)
class Used:
    """What is used of a limit, which is None where nothing is limited."""

    used: int
    limit: int | None = None


@dataclass(frozen=True, slots=True)
class Month:
    """What a key has had done in a month of UTC, such as "2026-11": it never falls, whatever is deleted.

    `jobs` are those that ended, by state; `looks` are of those that succeeded, `frames` and `duration_s` of the videos
    of these looks; `uploads` are files that became videos and references.
    """

    month: str
    jobs: Mapping[str, int] = field(default_factory=dict)
    looks: int = 0
    frames: int = 0
    duration_s: float = 0.0
    uploads: int = 0
    upload_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Usage:
    """What a key has used of its limits: requests of a minute, unfinished jobs, bytes; and what it has had done.

    `months` are the present one and former ones in which there was anything, newest first; empty of a service that does
    not tell them.
    """

    requests: Used
    active_jobs: Used
    stored_bytes: Used
    looks_this_month: int = 0
    jobs_this_month: Mapping[str, int] = field(default_factory=dict)
    months: tuple[Month, ...] = ()
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read it."""
        used = {name: Used(**_known(Used, body[name])) for name in ("requests", "active_jobs", "stored_bytes")}
        months = tuple(Month(**_known(Month, one)) for one in body.get("months", ()))
        return cls(**_known(cls, body) | used | {"months": months, "raw": body})


@dataclass(frozen=True, slots=True)
class Limits:
    """What the caller is under, by its parts as docs/api.md has them; `key` is None at a service without keys."""

    key: Body | None
    upload: Body
    request: Body
    output: Body
    retention: Body
    transport: Body = field(default_factory=dict)
    raw: Body = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, body: Body) -> Self:
        """Read them."""
        return cls(**_known(cls, body) | {"raw": body})


def id_of(thing: str | Medium | Job | Result | Webhook | Upload) -> str:
    """The id of something given as itself or by its id."""
    return thing if isinstance(thing, str) else thing.id


def role_of(media_id: str) -> Role:
    """What a medium's id says it is."""
    return "reference" if media_id.startswith("ref_") else "video"
