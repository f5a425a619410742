"""Prefixed UUIDv7 identifiers, sortable by creation time and telling what they name; and the ids of workers."""

from __future__ import annotations

import os
import re
import secrets
import socket
import time
from typing import Final, Literal

Prefix = Literal["vid", "ref", "job", "res", "req", "key", "msg", "upl", "prv"]

JOB_ID: Final = re.compile(r"job_[0-9a-f]{32}")
DELIVERY_CURSOR: Final = re.compile(r"^msg_[0-9a-f]{32}$")
JOB_CURSOR: Final = re.compile(r"^job_[0-9a-f]{32}$")
UPLOAD_CURSOR: Final = re.compile(r"^upl_[0-9a-f]{32}$")
VIDEO_CURSOR: Final = re.compile(r"^vid_[0-9a-f]{32}$")
REFERENCE_CURSOR: Final = re.compile(r"^ref_[0-9a-f]{32}$")
MEDIA_ID: Final = re.compile(r"^(vid|ref)_[0-9a-f]{32}$")

_HOST_CHARACTERS: Final = 60  # of the machine's name in a worker's id


def uuid7_hex() -> str:
    """A UUIDv7 (RFC 9562, 5.7) as 32 hex digits: 48 bits of milliseconds, 12 of their fraction, 62 random."""
    milliseconds, rest_ns = divmod(time.time_ns(), 1_000_000)
    # RFC 9562, 6.2 method 3: the fraction of the millisecond keeps ids of one process in order
    fraction = (rest_ns << 12) // 1_000_000
    value = (milliseconds & ((1 << 48) - 1)) << 80
    value |= 0x7 << 76 | fraction << 64
    value |= 0b10 << 62 | secrets.randbits(62)
    return f"{value:032x}"


def new_id(prefix: Prefix) -> str:
    """A new identifier such as ``vid_0192f0c1…``."""
    return f"{prefix}_{uuid7_hex()}"


def worker_id() -> str:
    """The name of this process among all workers."""
    return f"{socket.gethostname()[:_HOST_CHARACTERS]}-{os.getpid()}"


def host_of(worker: str) -> str:
    """The name of a worker's machine, as its id has it."""
    return worker.rpartition("-")[0]
