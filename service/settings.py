"""Every setting of the service and its worker, read from ``PVG_*`` environment variables; units are in the names."""

from __future__ import annotations

import difflib
import ipaddress
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Self
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pydantic import AfterValidator, BeforeValidator, Field, SecretStr, ValidationInfo, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from service import setting_values as values

GIB = 1024**3
DAY_S = 86_400
#: what a number in the database, and a limit of a process, can be
MAX_BYTES: Final = 2**63 - 1
#: of one transfer, whatever is set: all of them are read before they are counted
MAX_LOOKS: Final = 1000

_PREFIX: Final = "PVG_"
#: settings that are secrets: the path of a file that holds one is given in a variable of the same name and this ending
FROM_FILES: Final = ("database_url", "broker_url", "link_secret", "metrics_token")
FILE_ENDING: Final = "_FILE"
#: what obstore reads of S3's credentials from variables, and we from files as well
_STORE_SECRETS: Final = ("access_key_id", "secret_access_key", "session_token")
#: variables of the same prefix that are read elsewhere: by the library, from `serve` to its worker, by the tests
_READ_ELSEWHERE: Final = ("PVG_CACHE_DIR", "PVG_STARTER_PID", "PVG_REQUIRE_SERVERS", "PVG_TEST_DATABASE_URL")
_MIN_SECRET: Final = 32
#: what can stand behind `Bearer` in a header; nothing at all is no token
_SENDABLE: Final = re.compile(r"[!-~]*")
#: names by which only this machine itself can mean this machine
_LOOPBACK_NAMES: Final = frozenset({"localhost", "127.0.0.1", "::1"})


class Settings(BaseSettings):
    """Settings with their defaults: one machine, SQLite, a local folder and a broker made of files.

    The sentence below a setting is what docs/operations.md says of it: `python -m scripts.settings_table --write`.
    """

    model_config = SettingsConfigDict(
        env_prefix=_PREFIX,
        extra="ignore",
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        hide_input_in_errors=True,  # addresses hold passwords
    )

    # where the API listens
    host: Annotated[str, AfterValidator(values.address)] = "127.0.0.1"
    """Address of the API."""
    port: int = Field(default=8000, ge=0, le=65_535)
    """Port of the API."""
    allow_unauthenticated_network: bool = False
    """Allow an address other than loopback before there are keys; see "Who may connect"."""
    root_path: Annotated[str, AfterValidator(values.root_path)] = ""
    """Path below which a proxy in front serves this service; the proxy removes it. None by default."""

    # whom the API answers: names of hosts, origins of other web pages that may write
    allowed_hosts: Annotated[str, AfterValidator(values.host_names)] = ""
    """Host names, besides those of loopback, by which the service may be called, with commas; `*` allows any."""
    allowed_origins: Annotated[str, AfterValidator(values.origins)] = ""
    """Origins of other sites whose pages may use the service, with commas, such as `https://studio.example`, or
    `capacitor://localhost` for the pages of an app."""

    # what it asks for itself: files by URL, receivers of webhooks
    allow_private_networks: bool = False
    """Allow files by URL and webhooks at addresses that are not public; for closed networks."""
    allowed_networks: Annotated[str, AfterValidator(values.networks)] = ""
    """Networks that are not public but allowed for such URLs, with commas, such as `10.1.2.0/24,fd00:1:2::/64`. Every
    address of a host, IPv4 and IPv6, must be public or lie in one of them."""
    fetch_timeout_s: float = Field(default=3600.0, gt=0)
    """Time limit for fetching a file by its URL."""

    # links that need no key: what signs them, and whether results are had from the object store itself
    link_secret: SecretStr = SecretStr("")
    """Secret that signs links that need no key, 32 characters or more; the same for all APIs. Without one, a file in
    the data folder."""
    links_to_store: bool = False
    """Links to results lead to the object store itself. Clients must be able to reach it at the address in
    `AWS_ENDPOINT`."""

    # connections
    max_connections: int = Field(default=1000, gt=0)
    """Maximum number of open connections; fewer if there are too few file descriptors."""
    idle_timeout_s: float = Field(default=10.0, gt=0)
    """Silence after which a connection without a request is closed."""
    head_timeout_s: float = Field(default=10.0, gt=0)
    """Time limit for the head of a request."""
    body_timeout_s: float = Field(default=20.0, gt=0)
    """Time over which the speed of a body is measured."""
    min_body_bytes_per_s: float = Field(default=500.0, ge=0)
    """Minimum speed of a body; slower ones are refused."""
    send_timeout_s: float = Field(default=60.0, gt=0)
    """A client that reads nothing of its answer for this long is cut off."""
    stop_notice_s: float = Field(default=1.0, ge=0)
    """When told to stop: time between reporting not ready and accepting no more connections."""

    # where data is kept
    data_dir: Annotated[Path, BeforeValidator(values.folder)] = Path("var/data")
    """SQLite file, blobs, broker files and drafts, unless placed elsewhere."""
    database_url: Annotated[str, AfterValidator(values.database_url)] = ""
    """`postgresql://user:password@host/name`. Without one, SQLite in the data folder."""
    broker_url: Annotated[str, AfterValidator(values.broker_url)] = ""
    """`redis://host:6379/0`, of Valkey or Redis, `rediss://` with TLS. Without one, files in the data folder."""
    storage_url: Annotated[str, AfterValidator(values.storage_url)] = ""
    """A folder, or `s3://bucket/prefix` (credentials from `AWS_*`). Without one, `blobs/` in the data folder."""
    broker_polling_interval_s: float = Field(default=0.2, gt=0)
    """How often the embedded broker looks for messages."""

    # room on the disk below which uploads and new jobs are refused and queued ones wait
    min_free_bytes: int = Field(default=GIB // 4, ge=0)
    """Free disk space below which nothing new is begun; see "A full disk"."""

    # limits of uploads and requests
    max_upload_bytes: int = Field(default=2 * GIB, gt=0, le=MAX_BYTES)
    """Maximum size of one uploaded file."""
    max_json_bytes: int = Field(default=1024**2, gt=0)
    """Maximum size of a JSON body."""
    max_looks: int = Field(default=16, gt=0, le=MAX_LOOKS)
    """Maximum number of looks of one transfer."""
    max_pixels: int = Field(default=33_554_432, gt=0)
    """Maximum number of pixels of one frame."""
    max_frames: int = Field(default=200_000, gt=0)
    """Maximum number of frames of one clip."""
    max_duration_s: float = Field(default=3600.0, gt=0)
    """Maximum length of one clip."""
    max_frame_rate: float = Field(default=240.0, gt=0)
    """Maximum number of frames a second."""
    max_streams: int = Field(default=32, gt=0)
    """Maximum number of streams in one file."""
    min_face_px: int = Field(default=64, gt=0)
    """Minimum width of a face; narrower ones are refused."""
    warn_face_px: int = Field(default=200, gt=0)
    """Width of a face below which there is a warning."""

    # jobs
    lease_s: float = Field(default=30.0, gt=0)
    """A worker that does not answer for this long loses its job."""
    heartbeat_s: float = Field(default=5.0, gt=0)
    """How often a worker renews its lease."""
    progress_interval_s: float = Field(default=1.0, ge=0)
    """How often progress is written. The worker looks for a cancel as often, and at least each second."""
    reap_interval_s: float = Field(default=10.0, gt=0)
    """Time between two rounds of the reaper."""
    republish_after_s: float = Field(default=5.0, ge=0)
    """Age from which a job without a message is sent again."""
    max_attempts: int = Field(default=3, gt=0)
    """Maximum number of attempts at one job."""
    max_queued_s: float = Field(default=DAY_S, gt=0)
    """Jobs queued for longer expire, counted from when they were last queued."""
    max_outage_s: float = Field(default=600.0, ge=0)
    """How long a running job waits for a database or an object store that is away."""
    job_soft_limit_s: float = Field(default=7200.0, gt=0)
    """A job that takes longer is killed and fails with `time-limit`, at once and for good."""
    job_hard_limit_s: float = Field(default=7800.0, gt=0)
    """A supervisor that hangs for longer is killed."""
    job_memory_bytes: int = Field(default=6 * GIB, ge=3 * GIB // 2, le=MAX_BYTES)
    """Memory limit of one job's process, at least 1.5 GiB; jobs that need more fail with `too-large`
    (docs/security.md)."""
    job_file_bytes: int = Field(default=128 * GIB, gt=0, le=MAX_BYTES)
    """Maximum size of one file that a job writes."""
    part_s: float = Field(default=7.5, ge=5.0)
    """Length of the parts that a long clip is drawn in. The bytes of results depend on it, so use the same for all
    workers."""

    # webhooks
    webhook_timeout_s: float = Field(default=10.0, gt=0)
    """Time limit for one attempt to deliver a webhook."""

    # the worker
    worker_concurrency: int = Field(default=2, gt=0)
    """Number of pool processes of a worker; each supervises one job."""
    worker_max_tasks_per_child: int = Field(default=50, gt=0)
    """Number of jobs after which a pool process is replaced."""
    worker_max_memory_per_child_bytes: int = Field(default=4 * GIB, gt=0)
    """A pool process that uses more memory is replaced after its job."""
    worker_stop_grace_s: float = Field(default=8.0, ge=0)
    """When a worker is told to stop: time that a job which is about to end gets."""
    worker_restart_delay_s: float = Field(default=1.0, ge=0)
    """Pause before a dead worker is started again."""

    # previews
    preview_concurrency: int = Field(default=2, gt=0)
    """Number of pictures that are made at once."""
    preview_timeout_s: float = Field(default=10.0, gt=0, le=60.0)
    """Time limit for one picture; after it the answer is 503."""
    preview_idle_s: float = Field(default=30.0, gt=0)
    """How long a clip stays open for the next picture."""
    preview_open_clips: int = Field(default=4, gt=0)
    """Maximum number of clips that are open at once."""
    preview_copy_idle_s: float = Field(default=600.0, gt=0)
    """How long the worker of previews keeps a file from an object store after its last use."""
    preview_copy_bytes: int = Field(default=4 * GIB, ge=0)
    """Maximum size of all such files together; those in use, or used just before, are kept beyond it."""
    preview_polling_interval_s: float = Field(default=0.02, gt=0)
    """How often the worker of previews looks at the embedded broker."""
    max_open_previews: int = Field(default=8, gt=0)
    """Maximum number of pictures of one key that may wait; more are 429."""

    # retention
    upload_ttl_s: float = Field(default=DAY_S, gt=0)
    """Retention of an unfinished resumable upload, from its last piece."""
    media_ttl_s: float = Field(default=30 * DAY_S, gt=0)
    """Retention of videos and references, from their last use."""
    result_ttl_s: float = Field(default=7 * DAY_S, gt=0)
    """Retention of results."""
    job_ttl_s: float = Field(default=30 * DAY_S, gt=0)
    """Retention of records of finished jobs."""
    usage_months: int = Field(default=25, ge=1, le=1200)
    """Number of calendar months, with the present one, for which usage is kept (`months` of `/usage`)."""
    draft_ttl_s: float = Field(default=60.0, ge=0)
    """Age from which a received file is removed if no process has it open."""
    orphan_ttl_s: float = Field(default=3600.0, ge=0)
    """Age from which files that no record names are removed."""
    collect_interval_s: float = Field(default=6 * 3600.0, gt=0)
    """Time between two searches for files that no record names."""
    idempotency_ttl_s: float = Field(default=DAY_S, gt=0)
    """How long the answer to an `Idempotency-Key` is kept."""

    # what Prometheus says to see /metrics; a service with keys shows them to nobody else
    metrics_token: SecretStr = SecretStr("")
    """Bearer token that Prometheus sends to read `/metrics`; see "Figures"."""

    log_level: Annotated[str, AfterValidator(values.log_level)] = "INFO"
    """Lowest level that is logged: `DEBUG`, `INFO`, `WARNING`, `ERROR`, `CRITICAL`."""

    @field_validator("*")
    @classmethod
    def _check_time(cls, value: object, info: ValidationInfo) -> object:
        """What times are counted from must be a date still."""
        name = info.field_name or ""
        is_time = name.endswith("_s") and not name.endswith("_per_s")
        if is_time and isinstance(value, float) and value > values.LONGEST_S:
            raise ValueError(f"at most {values.LONGEST_S} seconds (100 years)")
        return value

    @model_validator(mode="before")
    @classmethod
    def _read_files(cls, given: dict[str, Any]) -> dict[str, Any]:
        files = _from_files(os.environ, _PREFIX, FROM_FILES)
        return given | {name: secret for name, secret in files.items() if not given.get(name)}

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_names(os.environ)
        if self.storage_url.startswith("s3"):
            store_secrets(os.environ)
        if self.heartbeat_s * 2 > self.lease_s:
            raise ValueError("lease_s must be at least twice heartbeat_s, or one slow beat loses the job")
        if self.job_hard_limit_s <= self.job_soft_limit_s:
            raise ValueError("job_hard_limit_s must be longer than job_soft_limit_s")
        if 0 < len(self.link_secret.get_secret_value()) < _MIN_SECRET:
            raise ValueError(f"link_secret must have at least {_MIN_SECRET} characters")
        if not _SENDABLE.fullmatch(self.metrics_token.get_secret_value()):
            raise ValueError("metrics_token must be of visible ASCII characters: it is sent in a header")
        return self

    @property
    def networks(self) -> tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...]:
        """Networks that are not public and that URLs of others may lead to all the same."""
        return tuple(ipaddress.ip_network(network) for network in values.listed(self.allowed_networks))

    @property
    def worker_stop_limit_s(self) -> float:
        """Seconds after which a worker that was told to stop is ended: jobs have ended or are given back by then."""
        return self.worker_stop_grace_s + 7

    @property
    def silent_s(self) -> float:
        """Seconds of silence after which a worker is taken for dead: three heartbeats."""
        return 3 * self.heartbeat_s

    @property
    def folder(self) -> Path:
        """The data folder, absolute, so that processes started elsewhere agree on it."""
        return self.data_dir.expanduser().resolve()

    @property
    def spool_folder(self) -> Path:
        """Uploads being received and files being written; the local blobs may be on another disk."""
        return self.folder / "spool"

    @property
    def database(self) -> str:
        """SQLAlchemy URL: the configured one, or SQLite in the data folder."""
        if not self.database_url:
            return f"sqlite:///{self.folder / 'catalog.sqlite3'}"
        # psycopg 3 is the driver that is installed
        for short in ("postgresql://", "postgres://"):
            if self.database_url.startswith(short):
                return "postgresql+psycopg://" + self.database_url[len(short) :]
        return self.database_url

    @property
    def database_file(self) -> Path | None:
        """The file of a SQLite database, or None for another one."""
        scheme, _, path = self.database.partition(":///")
        return Path(path) if scheme.startswith("sqlite") and path else None

    @property
    def local_storage_folder(self) -> Path | None:
        """The folder of the blobs, or None when they live in an object store."""
        if not self.storage_url:
            return self.folder / "blobs"
        parts = urlsplit(self.storage_url)
        if parts.scheme == "file":
            return Path(url2pathname(parts.path))
        return None if parts.scheme else Path(self.storage_url).expanduser().resolve()

    @property
    def host_names(self) -> frozenset[str] | None:
        """The names that a request's Host may have, in lower case and without ports; None when it may be any."""
        given = values.listed(self.allowed_hosts)
        if "*" in given:
            return None
        # the address listened at is no secret name: a page cannot make a name resolve to an address in its URL
        own = () if self.host in {"0.0.0.0", "::"} else (self.host,)  # noqa: S104 - compared, not bound
        return _LOOPBACK_NAMES | {name.lower().strip("[]") for name in (*given, *own)}

    @property
    def origins(self) -> frozenset[str]:
        """The origins of other sites whose pages may write, such as ``https://studio.example``."""
        return frozenset(origin.lower().rstrip("/") for origin in values.listed(self.allowed_origins))

    @property
    def uses_broker_of_files(self) -> bool:
        """True for the embedded broker, whose messages are files in the data folder."""
        return not self.broker_url or self.broker_url.startswith("filesystem://")

    @property
    def listens_to_loopback_only(self) -> bool:
        """True when the configured address can be reached from this machine only."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def store_secrets(environment: Mapping[str, str]) -> dict[str, str]:
    """S3's credentials that ``AWS_…_FILE`` name, as obstore calls them. Raises `ValueError` as `Settings` does."""
    return _from_files(environment, "AWS_", _STORE_SECRETS)


def _from_files(environment: Mapping[str, str], prefix: str, names: Iterable[str]) -> dict[str, str]:
    """What is in the files that ``{prefix}…_FILE`` name, without the line's end, by names.

    Raises `ValueError` for a file that is missing, empty or no text, and for a variable beside its file.
    """
    variables = {name.upper(): value for name, value in environment.items() if value}
    found = {}
    for name in names:
        variable = f"{prefix}{name}".upper()
        path = variables.get(variable + FILE_ENDING)
        if path is None:
            continue
        if variable in variables:
            raise ValueError(f"{variable} and {variable}{FILE_ENDING} are both given")
        try:
            found[name] = Path(path).read_text().strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "not text"
            raise ValueError(f"{variable}{FILE_ENDING}: {path}: {reason}") from None
        if not found[name]:
            raise ValueError(f"{variable}{FILE_ENDING}: {path} is empty")
    return found


def check_names(names: Iterable[str]) -> None:
    """Raise `ValueError` for a variable that looks like a setting and is none: a typing error must not pass."""
    own = (*Settings.model_fields, *(f"{name}{FILE_ENDING}" for name in FROM_FILES))
    known = {f"{_PREFIX}{name}".upper() for name in own} | set(_READ_ELSEWHERE)
    for name in sorted(names):
        if name.upper().startswith(_PREFIX) and name.upper() not in known:
            near = difflib.get_close_matches(name.upper(), known, n=1, cutoff=0.0)
            raise ValueError(f"{name} is not a setting; the nearest is {near[0]}")
