"""Repeated measurements: medians with their spread, and things compared in turns so that noise meets both."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

Work = Callable[[], Any]

_PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "onnxruntime", "numba", "av")
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Measured:
    """Values of one quantity, all in one unit."""

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        """The middle value."""
        return statistics.median(self.values)

    @property
    def spread(self) -> float:
        """(greatest - least) / median."""
        return (max(self.values) - min(self.values)) / abs(self.median) if self.median else 0.0

    def scaled(self, factor: float) -> Measured:
        """All values times a factor."""
        return Measured(tuple(value * factor for value in self.values))

    def less(self, other: Measured) -> Measured:
        """Differences of what was measured in the same rounds."""
        return Measured(tuple(a - b for a, b in zip(self.values, other.values, strict=True)))

    def over(self, other: Measured) -> Measured:
        """Ratios of what was measured in the same rounds."""
        return Measured(tuple(a / b for a, b in zip(self.values, other.values, strict=True)))

    def to_json(self) -> dict[str, Any]:
        """Median, least, greatest and the values themselves."""
        return {
            "median": self.median,
            "min": min(self.values),
            "max": max(self.values),
            "values": [float(f"{value:.6g}") for value in self.values],
        }


def seconds(work: Work) -> tuple[float, float]:
    """(wall seconds, CPU seconds of all threads of this process) of one call."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def cpu_ms(work: Work) -> float:
    """CPU milliseconds of one call, over all threads of this process."""
    return seconds(work)[1] * 1000.0


@dataclass(frozen=True)
class Taken:
    """Seconds that one work took in each round: on the wall clock, and of the processor over all threads."""

    wall: Measured
    cpu: Measured

    def to_json(self) -> dict[str, Any]:
        """The wall clock's measures, and the processor's under "cpu"."""
        return {**self.wall.to_json(), "cpu": self.cpu.to_json()}


def in_turns(works: Mapping[str, Work], rounds: int) -> dict[str, Taken]:
    """Each work once a round, forwards and backwards in turns, so that noise meets all of them alike."""
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for turn in range(rounds):
        names: Sequence[str] = list(works)
        for name in names if turn % 2 == 0 else reversed(names):
            taken[name].append(seconds(works[name]))
    return {
        name: Taken(Measured(tuple(wall for wall, _ in pairs)), Measured(tuple(cpu for _, cpu in pairs)))
        for name, pairs in taken.items()
    }


def machine_facts() -> dict[str, Any]:
    """What the figures depend on: processor, cores, memory, load and versions."""
    cpu = "unknown"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu)
        total = next(line for line in Path("/proc/meminfo").read_text().splitlines() if line.startswith("MemTotal"))
        memory_gb = round(int(total.split()[1]) / 2**20, 1)
    except (OSError, StopIteration):
        memory_gb = None
    versions = {"python": platform.python_version()}
    versions |= {name: metadata.version(name) for name in _PACKAGES}
    return {
        "cpu": cpu,
        "cores": usable_cores(),
        "memory_gb": memory_gb,
        "load": [round(value, 2) for value in os.getloadavg()],
        "system": f"{platform.system()} {platform.machine()}",
        "versions": versions,
    }


def usable_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def one_thread_environment() -> dict[str, str]:
    """Environment that keeps numeric libraries to one thread."""
    return {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, "1")}


def peak_memory_mb() -> float:
    """Largest resident size this process ever had, in MB of 10^6 bytes; 0 where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0.0
    peak = next((line for line in lines if line.startswith("VmHWM")), "VmHWM: 0 kB")
    return int(peak.split()[1]) * 1024 / 1e6
