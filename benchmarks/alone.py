"""Work in a process of its own: for its peak memory, or held to one core.

`python -m benchmarks.alone MODULE FUNCTION ARGUMENTS RESULT THREADS` calls a function of this package with
JSON arguments and writes what it returns, its time and the process's peak memory as JSON.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from benchmarks.timing import one_thread_environment, peak_memory_mb, seconds


@dataclass(frozen=True)
class Alone:
    """What a call returned, its wall and CPU seconds, and the peak memory of its process in MB."""

    result: Any
    wall_s: float
    cpu_s: float
    peak_mb: float


def run_alone(function: Callable[..., Any], *arguments: Any, one_thread: bool = False) -> Alone:
    """Call a module's function in a fresh process; arguments and result must fit in JSON.

    one_thread: pinned to one core, with the numeric libraries told to use one thread.
    """
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        module = function.__module__
        if module == "__main__":  # run as a module, which has a name of its own
            spec = sys.modules[module].__spec__
            assert spec is not None
            module = spec.name
        command = [sys.executable, "-m", "benchmarks.alone", module, function.__name__]
        command += [json.dumps(arguments, default=str), str(answer), "1" if one_thread else "0"]
        subprocess.run(command, check=True, env=one_thread_environment() if one_thread else None)
        return Alone(**json.loads(answer.read_text()))


def hold_to_one_core() -> None:
    """Pin this process to one of its cores and keep OpenCV to one thread."""
    cv2.setNumThreads(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def main() -> None:
    """Do what the command line says."""
    module, name, arguments, answer, threads = sys.argv[1:]
    if threads == "1":
        hold_to_one_core()
    function = getattr(importlib.import_module(module), name)
    results: list[Any] = []
    wall_s, cpu_s = seconds(lambda: results.append(function(*json.loads(arguments))))
    body = {"result": results[0], "wall_s": wall_s, "cpu_s": cpu_s, "peak_mb": peak_memory_mb()}
    Path(answer).write_text(json.dumps(body))


if __name__ == "__main__":
    main()
