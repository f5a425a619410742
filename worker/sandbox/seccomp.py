"""A filter of system calls: what a process that decodes and draws never needs fails with EPERM (Linux).

A list of what is refused, not of what is allowed: the libraries that decode change with every release, and a call they
begin to use must not end a job. What is refused is everything that reaches outside: sockets, programs, other processes,
mounts, the kernel's own tools, and memory that the limits do not count.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

_PR_SET_SECCOMP, _MODE_FILTER = 22, 2
_KILL_PROCESS, _ERRNO, _ALLOW = 0x8000_0000, 0x0005_0000, 0x7FFF_0000
_X32 = 0x4000_0000  # calls of the x32 ABI have this bit
_CLONE_THREAD = 0x10000
#: of ioctl and fcntl: what types for a terminal, and what has the kernel send signals to others as a file changes,
#: which Landlock forbids only from its version 6 on (`asm-generic/ioctls.h`, `asm-generic/sockios.h`, `linux/fcntl.h`)
_TIOCSTI, _FIOSETOWN, _SIOCSPGRP = 0x5412, 0x8901, 0x8902
_F_SETOWN, _F_SETSIG, _F_SETOWN_EX = 8, 10, 15
#: of prctl: the signal at the parent's death, by which the process ends with its server
_PR_SET_PDEATHSIG = 1
#: of mmap: memory that RLIMIT_DATA does not count is that which processes share, and that which grows as a stack does
_MAP_SHARED, _MAP_ANONYMOUS, _MAP_GROWSDOWN = 0x1, 0x20, 0x100

# classic BPF: (code, jump if true, jump if false, operand)
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_Instruction = tuple[int, int, int, int]
# fields of `struct seccomp_data`; arguments are of 64 bits, their low half first on both processors
_NUMBER_AT, _ARCH_AT, _FIRST_ARGUMENT_AT, _SECOND_ARGUMENT_AT, _FOURTH_ARGUMENT_AT = 0, 4, 16, 24, 40


@dataclass(frozen=True)
class _Processor:
    """audit: what `linux/audit.h` calls it;  column: of `_REFUSED`."""

    audit: int
    column: int


_PROCESSORS: Final = {"x86_64": _Processor(0xC000_003E, 0), "aarch64": _Processor(0xC000_00B7, 1)}

#: numbers of what is refused, on x86_64 and aarch64; None where the processor has no such call
REFUSED: Final[dict[str, tuple[int | None, int | None]]] = {
    # sockets: those a process already has go on working
    "socket": (41, 198), "socketpair": (53, 199), "bind": (49, 200), "listen": (50, 201), "accept": (43, 202),
    "accept4": (288, 242), "connect": (42, 203),
    # programs and processes; `clone` is looked at below
    "execve": (59, 221), "execveat": (322, 281), "fork": (57, None), "vfork": (58, None),
    "setsid": (112, 157), "setpgid": (109, 154), "setpriority": (141, 140), "ioprio_set": (251, 30),
    # files, where landlock does not ask: by their names, or by descriptors, for which one to read by is enough
    "chmod": (90, None), "fchmod": (91, 52), "fchmodat": (268, 53), "fchmodat2": (452, 452), "chown": (92, None),
    "fchown": (93, 55), "lchown": (94, None), "fchownat": (260, 54), "truncate": (76, 45), "setxattr": (188, 5),
    "lsetxattr": (189, 6), "fsetxattr": (190, 7), "removexattr": (197, 14), "lremovexattr": (198, 15),
    "fremovexattr": (199, 16), "setxattrat": (463, 463), "removexattrat": (466, 466), "file_setattr": (469, 469),
    "utime": (132, None), "utimes": (235, None), "futimesat": (261, None), "utimensat": (280, 88),
    "inotify_init": (253, None), "inotify_init1": (294, 26), "inotify_add_watch": (254, 27),
    # other processes
    "ptrace": (101, 117), "process_vm_readv": (310, 270), "process_vm_writev": (311, 271),
    "process_madvise": (440, 440), "kcmp": (312, 272), "pidfd_open": (434, 434), "pidfd_getfd": (438, 438),
    "pidfd_send_signal": (424, 424), "tkill": (200, 130), "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240),
    # which of them has the processor: libraries that ask for more of it, or for cores, go on without
    "sched_setparam": (142, 118), "sched_setscheduler": (144, 119), "sched_setattr": (314, 274),
    "sched_setaffinity": (203, 122),
    # mounts and namespaces
    "mount": (165, 40), "umount2": (166, 39), "pivot_root": (155, 41), "chroot": (161, 51), "open_tree": (428, 428),
    "open_tree_attr": (467, 467), "statmount": (457, 457), "listmount": (458, 458),
    "move_mount": (429, 429), "fsopen": (430, 430), "fsconfig": (431, 431), "fsmount": (432, 432),
    "fspick": (433, 433), "mount_setattr": (442, 442), "unshare": (272, 97), "setns": (308, 268),
    # the kernel's own tools
    "bpf": (321, 280), "perf_event_open": (298, 241), "userfaultfd": (323, 282), "keyctl": (250, 219),
    "add_key": (248, 217), "request_key": (249, 218), "io_uring_setup": (425, 425), "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427), "init_module": (175, 105), "finit_module": (313, 273),
    "delete_module": (176, 106), "kexec_load": (246, 104), "kexec_file_load": (320, 294), "reboot": (169, 142),
    "swapon": (167, 224), "swapoff": (168, 225), "acct": (163, 89), "syslog": (103, 116), "quotactl": (179, 60),
    "settimeofday": (164, 170), "clock_settime": (227, 112), "clock_adjtime": (305, 266), "adjtimex": (159, 171),
    "sethostname": (170, 161), "setdomainname": (171, 162), "personality": (135, 92), "iopl": (172, None),
    "ioperm": (173, None), "modify_ldt": (154, None), "name_to_handle_at": (303, 264),
    "open_by_handle_at": (304, 265), "fanotify_init": (300, 262), "mknod": (133, None), "mknodat": (259, 33),
    # memory that outlives the process, or that no limit counts
    "memfd_create": (319, 279), "memfd_secret": (447, 447), "mq_open": (240, 180),
    # System V's: by its number anybody of the same user may use what another process has made
    "shmget": (29, 194), "shmat": (30, 196), "shmctl": (31, 195), "shmdt": (67, 197), "semget": (64, 190),
    "semctl": (66, 191), "semop": (65, 193), "semtimedop": (220, 192), "msgget": (68, 186), "msgctl": (71, 187),
    "msgsnd": (69, 189), "msgrcv": (70, 188),
}  # fmt: skip
#: numbers of what depends on its arguments
CHECKED: Final[dict[str, tuple[int, int]]] = {
    "clone": (56, 220),
    "clone3": (435, 435),
    "kill": (62, 129),
    "tgkill": (234, 131),
    "prlimit64": (302, 261),
    "ioctl": (16, 29),
    "fcntl": (72, 25),
    "prctl": (157, 167),
    "mmap": (9, 222),
}


def unsupported() -> str | None:
    """Why there can be no filter here; None where there can."""
    if sys.platform != "linux":
        return "only Linux has it"
    if platform.machine() not in _PROCESSORS or sys.maxsize < 2**32:
        return f"its calls are not listed for {platform.machine()}"
    return None


def restrict() -> None:
    """Put the filter on this thread and all it starts. Needs `no_new_privs`. Raises `OSError`."""
    reason = unsupported()
    if reason is not None:
        raise OSError(reason)
    program = _program(_PROCESSORS[platform.machine()], os.getpid())
    code = b"".join(struct.pack("<HBBI", *one) for one in program)
    filters = ctypes.create_string_buffer(code, len(code))

    class Program(ctypes.Structure):
        _fields_ = (("length", ctypes.c_ushort), ("filters", ctypes.c_void_p))

    whole = Program(len(program), ctypes.cast(filters, ctypes.c_void_p))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_SECCOMP, ctypes.c_ulong(_MODE_FILTER), ctypes.byref(whole), 0, 0):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _program(processor: _Processor, own_pid: int) -> list[_Instruction]:
    """The filter: calls of another architecture kill, the refused ones give EPERM, all others pass."""
    refuse = (_RETURN, 0, 0, _ERRNO | errno.EPERM)
    program: list[_Instruction] = [
        (_LOAD, 0, 0, _ARCH_AT),
        (_EQUAL, 1, 0, processor.audit),
        (_RETURN, 0, 0, _KILL_PROCESS),
        (_LOAD, 0, 0, _NUMBER_AT),
        (_AT_LEAST, 0, 1, _X32),
        refuse,
    ]
    for numbers in REFUSED.values():
        number = numbers[processor.column]
        if number is not None:
            program += [(_EQUAL, 0, 1, number), refuse]
    numbers_of = {name: numbers[processor.column] for name, numbers in CHECKED.items()}
    # a filter cannot look behind clone3's pointer: without that call the C library makes its threads by clone
    program += [(_EQUAL, 0, 1, numbers_of["clone3"]), (_RETURN, 0, 0, _ERRNO | errno.ENOSYS)]
    thread: Sequence[_Instruction] = ((_LOAD, 0, 0, _FIRST_ARGUMENT_AT), (_ANY_BIT, 1, 0, _CLONE_THREAD), refuse)
    own: Sequence[_Instruction] = ((_LOAD, 0, 0, _FIRST_ARGUMENT_AT), (_EQUAL, 1, 0, own_pid), refuse)
    itself: Sequence[_Instruction] = ((_LOAD, 0, 0, _FIRST_ARGUMENT_AT), (_EQUAL, 1, 0, 0), refuse)
    counted: Sequence[_Instruction] = (
        (_LOAD, 0, 0, _FOURTH_ARGUMENT_AT),
        (_ANY_BIT, 2, 0, _MAP_GROWSDOWN),
        (_ANY_BIT, 0, 2, _MAP_ANONYMOUS),
        (_ANY_BIT, 0, 1, _MAP_SHARED),
        refuse,
    )
    checks: dict[str, Sequence[_Instruction]] = {
        "clone": thread,
        "kill": own,
        "tgkill": own,
        "prlimit64": itself,
        "ioctl": _none_of(_SECOND_ARGUMENT_AT, (_TIOCSTI, _FIOSETOWN, _SIOCSPGRP), refuse),
        "fcntl": _none_of(_SECOND_ARGUMENT_AT, (_F_SETOWN, _F_SETSIG, _F_SETOWN_EX), refuse),
        "prctl": _none_of(_FIRST_ARGUMENT_AT, (_PR_SET_PDEATHSIG,), refuse),
        "mmap": counted,
    }
    allow = (_RETURN, 0, 0, _ALLOW)
    for name, check in checks.items():
        program += [(_EQUAL, 0, len(check) + 1, numbers_of[name]), *check, allow]
    return [*program, allow]


def _none_of(argument_at: int, values: Sequence[int], refuse: _Instruction) -> Sequence[_Instruction]:
    """Refuse these values of an argument, of which the kernel looks at the low half alone."""
    return [(_LOAD, 0, 0, argument_at), *(one for value in values for one in ((_EQUAL, 0, 1, value), refuse))]
