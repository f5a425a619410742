"""Running a network: the one place that imports onnxruntime."""

from __future__ import annotations

import os
import threading
from types import ModuleType
from typing import TYPE_CHECKING

from pvg.models.networks import MODELS, OWN
from pvg.models.store import own, verified

if TYPE_CHECKING:
    import onnxruntime

__all__ = ["load"]

# keyed by process too: an onnxruntime session's threads do not survive a fork
_sessions: dict[tuple[int, str | None, str, int], onnxruntime.InferenceSession] = {}
_lock = threading.Lock()


def _new_lock() -> None:
    global _lock  # noqa: PLW0603 - another thread may have held it when this process was forked
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_new_lock)


def load(name: str, threads: int = 1) -> onnxruntime.InferenceSession:
    """Return the session of one network of MODELS or OWN, made once a process and thread count, whoever asks.

    Inputs are float32, of MODELS (1, 256, 256, 3) RGB, of efficientnet_lite0 224 a side; the file's sha256 is checked
    before it is used.
    Raises ModelError when the weights are missing or altered, KeyError for an unknown name.
    """
    key = (os.getpid(), os.environ.get("PVG_CACHE_DIR"), name, threads)
    with _lock:
        if key not in _sessions:
            _sessions[key] = _made(own(OWN[name]) if name in OWN else verified(MODELS[name]), threads)
        return _sessions[key]


def _made(data: bytes, threads: int) -> onnxruntime.InferenceSession:
    ort = _silent_onnxruntime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # idle worker threads must not spin: decoding, solving and encoding share the cores
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    session: onnxruntime.InferenceSession = ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    return session


def _silent_onnxruntime() -> ModuleType:
    """onnxruntime with its telemetry off, imported when it is needed: it takes 0.1 s.

    From 1.29 on it reports to its vendor by default, and keeps an identifier of the machine in the home folder. The
    variable is read as the library's environment is made and stops all of that; the call serves a process that had
    imported onnxruntime before.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime  # noqa: PLC0415 - after the variable

    onnxruntime.disable_telemetry_events()
    module: ModuleType = onnxruntime
    return module


def preload() -> None:
    """Load the library without making a session, for processes that are forked from this one."""
    _silent_onnxruntime()
