"""Every setting of the service and its worker, read from ``PVG_*`` environment variables; units are in the names."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pydantic import Field, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

GIB = 1024**3
DAY_S = 86_400


class Settings(BaseSettings):
    """Settings with their defaults: one machine, SQLite, a local folder and a broker made of files."""

    model_config = SettingsConfigDict(env_prefix="PVG_", extra="ignore", frozen=True)

    # where the API listens
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65_535)
    allow_unauthenticated_network: bool = False
    root_path: str = ""

    # where data is kept
    data_dir: Path = Path("var/data")
    database_url: str = ""
    broker_url: str = ""
    storage_url: str = ""
    broker_polling_interval_s: float = Field(default=0.2, gt=0)

    # limits of uploads and requests
    max_upload_bytes: int = Field(default=2 * GIB, gt=0)
    max_json_bytes: int = Field(default=1024**2, gt=0)
    max_looks: int = Field(default=16, gt=0)
    max_pixels: int = Field(default=33_554_432, gt=0)
    max_frames: int = Field(default=200_000, gt=0)
    max_duration_s: float = Field(default=3600.0, gt=0)
    max_frame_rate: float = Field(default=240.0, gt=0)
    max_streams: int = Field(default=16, gt=0)
    min_face_px: int = Field(default=64, gt=0)
    warn_face_px: int = Field(default=200, gt=0)

    # jobs
    lease_s: float = Field(default=30.0, gt=0)
    heartbeat_s: float = Field(default=5.0, gt=0)
    progress_interval_s: float = Field(default=1.0, ge=0)
    reap_interval_s: float = Field(default=10.0, gt=0)
    republish_after_s: float = Field(default=10.0, ge=0)
    max_attempts: int = Field(default=3, gt=0)
    max_queued_s: float = Field(default=DAY_S, gt=0)
    job_soft_limit_s: float = Field(default=7200.0, gt=0)
    job_hard_limit_s: float = Field(default=7260.0, gt=0)

    # the worker
    worker_concurrency: int = Field(default=2, gt=0)
    worker_max_tasks_per_child: int = Field(default=50, gt=0)
    worker_max_memory_per_child_bytes: int = Field(default=4 * GIB, gt=0)
    worker_stop_grace_s: float = Field(default=10.0, ge=0)
    worker_restart_delay_s: float = Field(default=1.0, ge=0)

    # retention
    media_ttl_s: float = Field(default=30 * DAY_S, gt=0)
    result_ttl_s: float = Field(default=7 * DAY_S, gt=0)
    job_ttl_s: float = Field(default=30 * DAY_S, gt=0)
    draft_ttl_s: float = Field(default=3 * 3600, gt=0)
    orphan_ttl_s: float = Field(default=DAY_S, ge=0)

    log_level: str = "INFO"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.heartbeat_s * 2 > self.lease_s:
            raise ValueError("lease_s must be at least twice heartbeat_s, or one slow beat loses the job")
        if self.draft_ttl_s <= self.job_hard_limit_s:
            raise ValueError("draft_ttl_s must be longer than job_hard_limit_s, or a running job loses its files")
        if self.job_hard_limit_s <= self.job_soft_limit_s:
            raise ValueError("job_hard_limit_s must be longer than job_soft_limit_s")
        return self

    @property
    def folder(self) -> Path:
        """The data folder, absolute, so that processes started elsewhere agree on it."""
        return self.data_dir.expanduser().resolve()

    @property
    def spool_folder(self) -> Path:
        """Uploads being received and files being written; on the same disk as the local blobs."""
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
    def local_storage_folder(self) -> Path | None:
        """The folder of the blobs, or None when they live in an object store."""
        if not self.storage_url:
            return self.folder / "blobs"
        parts = urlsplit(self.storage_url)
        if parts.scheme == "file":
            return Path(url2pathname(parts.path))
        return None if parts.scheme else Path(self.storage_url).expanduser().resolve()

    @property
    def listens_to_loopback_only(self) -> bool:
        """True when the configured address can be reached from this machine only."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False
