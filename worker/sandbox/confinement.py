"""What a job's process gives up before it looks at a file from outside, and what of that this machine can do."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from worker import lifeline
from worker.sandbox import landlock, seccomp

_PR_SET_NO_NEW_PRIVS, _PR_CAP_AMBIENT, _CLEAR_AMBIENT = 38, 47, 4
_CLONE_NEWUSER, _CLONE_NEWNET = 0x1000_0000, 0x4000_0000
_CAPABILITY_VERSION_3 = 0x2008_0522

_OPEN_FILES = 256
_CPU_GRACE_S = 5
_PROCESSES = 1024  # threads count; a process of its own cannot be made at all
#: address space beyond the memory: libraries, and what the C library's allocator only reserves, 64 MB a thread
_RESERVED_BYTES = 16 * 2**30
#: what libraries read of the machine
_OF_THE_SYSTEM: Final = (
    *("/usr/lib", "/usr/lib64", "/lib", "/lib64", "/usr/local/lib", "/usr/share/zoneinfo"),
    *("/etc/ld.so.cache", "/etc/localtime", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat"),
    *("/proc/sys/vm/overcommit_memory", "/sys/devices/system/cpu", "/sys/fs/cgroup", "/dev/urandom"),
)


@dataclass(frozen=True)
class Limits:
    """What one job may take. ``cpu_s``: of all its threads together; ``file_bytes``: of one file."""

    memory_bytes: int
    cpu_s: int
    file_bytes: int


@dataclass(frozen=True)
class View:
    """What one job sees of the disk beside the program itself: files to read, and the folder that is its own."""

    read: tuple[Path, ...]
    folder: Path


def confine(limits: Limits, view: View, *, parent: int) -> list[str]:
    """Give up, for good, what the job does not need. Returns what could not be had, a line each.

    For a process of one thread, right after the fork. What no Linux lacks is required: raises `OSError` for limits,
    and ends the process when ``parent`` is gone.
    """
    _end_with(parent)
    _limit(limits)
    tempfile.tempdir = str(view.folder)
    missing = [] if sys.platform == "linux" else ["this is not Linux: limits only, no sandbox"]
    if missing:
        return missing
    steps: tuple[tuple[str, Callable[[], None]], ...] = (
        ("network namespace", _leave_network),
        ("no_new_privs", _no_new_privileges),
        ("landlock", lambda: _see(view)),
        ("capabilities", _drop_capabilities),
        ("seccomp", seccomp.restrict),
    )
    for name, step in steps:
        try:
            step()
        except OSError as error:
            missing.append(f"{name}: {error.strerror or error}")
    return missing


def _end_with(parent: int) -> None:
    lifeline.die_with_parent()
    if os.getppid() != parent:  # it ended before the kernel was told
        os._exit(1)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")  # where the machine runs out of memory, this goes first


def _limit(limits: Limits) -> None:
    wanted = {
        resource.RLIMIT_CORE: (0, 0),
        resource.RLIMIT_DATA: (limits.memory_bytes, limits.memory_bytes),
        resource.RLIMIT_AS: (limits.memory_bytes + _RESERVED_BYTES,) * 2,
        resource.RLIMIT_CPU: (limits.cpu_s, limits.cpu_s + _CPU_GRACE_S),  # SIGXCPU, then SIGKILL
        resource.RLIMIT_FSIZE: (limits.file_bytes, limits.file_bytes),
        resource.RLIMIT_NOFILE: (_OPEN_FILES, _OPEN_FILES),
    }
    for which, values in wanted.items():
        most = resource.getrlimit(which)[1]
        soft, hard = (value if most == resource.RLIM_INFINITY else min(value, most) for value in values)
        resource.setrlimit(which, (soft, hard))
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a file over the limit is an error of that file


def _leave_network() -> None:
    """A network of its own without any device, in a user namespace of its own, where threads are counted apart."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET) == 0:
        resource.setrlimit(resource.RLIMIT_NPROC, (_PROCESSES, _PROCESSES))
        return
    reason = ctypes.get_errno()
    if libc.unshare(_CLONE_NEWNET):  # root may have this without the other
        raise OSError(reason, os.strerror(reason))


def _no_new_privileges() -> None:
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)


def _see(view: View) -> None:
    landlock.restrict(
        read=(*program_folders(), Path(f"/proc/{os.getpid()}"), *view.read),
        write=(view.folder,),
        devices=(Path("/dev/null"),),
    )


def _drop_capabilities() -> None:
    """Root's, or those over a namespace of one's own."""
    _prctl(_PR_CAP_AMBIENT, _CLEAR_AMBIENT)
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    nothing = (ctypes.c_uint32 * 6)()
    if ctypes.CDLL(None, use_errno=True).capset(header, nothing):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _prctl(option: int, value: int) -> None:
    arguments = [ctypes.c_ulong(number) for number in (value, 0, 0, 0)]
    if ctypes.CDLL(None, use_errno=True).prctl(option, *arguments):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


@cache
def program_folders() -> tuple[Path, ...]:
    """Where Python, the libraries, this project's packages, the networks and the compiled kernels lie."""
    from pvg import _folders  # noqa: PLC0415 - not by the supervisor

    packages = [Path(str(sys.modules[name].__file__)).parent for name in ("pvg", "worker")]
    libraries = (sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
    paths = {*packages, Path(sys.base_prefix, "lib"), *(Path(name) for name in (*libraries, *_OF_THE_SYSTEM))}
    if "NUMBA_CACHE_DIR" in os.environ:
        paths.add(Path(os.environ["NUMBA_CACHE_DIR"]))
    cache_root = _folders.cache_root()
    if cache_root is not None:
        paths.add(cache_root)
    return tuple(sorted(path for path in paths if path.exists() and path != Path("/")))
