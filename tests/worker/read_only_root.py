"""Run a command as a container of ours does: a root that cannot be written, a tmpfs at /tmp's place, no capabilities.

    unshare --user --map-root-user --mount python -m tests.worker.read_only_root VOLUME TMP COMMAND …

VOLUME and TMP are folders that are there; the first stays writable, the second and /dev/shm become empty tmpfs. All
else below / becomes read-only, mounts within mounts too (mount_setattr(2), Linux 5.12). Status 77: it cannot be had.
"""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Final

CANNOT: Final = 77

_SYS_MOUNT_SETATTR: Final = 442
_AT_FDCWD, _AT_RECURSIVE = -100, 0x8000
_MOUNT_ATTR_RDONLY = 0x1
_MS_REMOUNT, _MS_BIND, _MS_REC, _MS_PRIVATE = 32, 4096, 16384, 1 << 18
_MS_NOSUID, _MS_NODEV = 2, 4
_PR_SET_NO_NEW_PRIVS, _PR_CAP_AMBIENT, _PR_CAPBSET_DROP = 38, 47, 24
_LAST_CAPABILITY = 40

_libc = ctypes.CDLL(None, use_errno=True)


class _Attributes(ctypes.Structure):
    _fields_ = (
        ("set", ctypes.c_uint64),
        ("clear", ctypes.c_uint64),
        ("propagation", ctypes.c_uint64),
        ("namespace", ctypes.c_uint64),
    )


def _checked(result: int, what: str) -> None:
    if result != 0:
        print(f"{what}: {os.strerror(ctypes.get_errno())}", file=sys.stderr)
        sys.exit(CANNOT)


def _mount(source: str | None, target: str, kind: str | None, flags: int, data: str | None = None) -> None:
    encoded = [part and part.encode() for part in (source, target, kind)]
    _checked(_libc.mount(*encoded, flags, data and data.encode()), f"mount {target}")


def _change(path: str, attributes: _Attributes, flags: int) -> None:
    size = ctypes.sizeof(attributes)
    done = _libc.syscall(_SYS_MOUNT_SETATTR, _AT_FDCWD, path.encode(), flags, ctypes.byref(attributes), size)
    _checked(done, f"mount_setattr {path}")


def enter(volume: str, tmp: str) -> None:
    """Make everything read-only but a folder and a tmpfs, for good."""
    _mount(None, "/", None, _MS_REC | _MS_PRIVATE)
    _mount(volume, volume, None, _MS_BIND)
    _mount("tmpfs", tmp, "tmpfs", _MS_NOSUID | _MS_NODEV, "size=64m,mode=1777")
    # every container has one of its own, also with a read-only root
    _mount("tmpfs", "/dev/shm", "tmpfs", _MS_NOSUID | _MS_NODEV, "size=64m,mode=1777")
    _change("/", _Attributes(set=_MOUNT_ATTR_RDONLY), _AT_RECURSIVE)
    for path in (volume, tmp, "/dev/shm"):
        _change(path, _Attributes(clear=_MOUNT_ATTR_RDONLY), 0)


def give_up_privileges() -> None:
    """As `cap_drop: ALL` and `no-new-privileges` do."""
    for capability in range(_LAST_CAPABILITY + 1):
        _checked(_libc.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0), f"capability {capability}")
    _checked(_libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "no_new_privs")
    header = (ctypes.c_uint32 * 2)(0x2008_0522, 0)
    _checked(_libc.capset(header, (ctypes.c_uint32 * 6)()), "capset")


def main() -> None:
    """Give up what a container has not, and become the command."""
    volume, tmp, *command = sys.argv[1:]
    enter(volume, tmp)
    give_up_privileges()
    os.execve(command[0], command, os.environ | {"TMPDIR": tmp, "HOME": tmp})


if __name__ == "__main__":
    main()
