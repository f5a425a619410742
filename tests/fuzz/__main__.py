"""`python -m tests.fuzz`: feed changed files to what reads untrusted bytes, and tell what it did not answer well.

A find is an error of another kind than the reader's own, a process that dies, memory above 3 GB, or a case that takes
more than 20 s of a processor, or 5 minutes. The first case of each is kept in --finds, named by target, seed and
number; the exit status is 1 when there is one.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path

from tests.fuzz.targets import MAKERS, seeded

MOST_MEMORY_BYTES = 3 * 2**30
#: of a processor, whatever else the machine does; and in all, for a case that waits
MOST_PROCESSOR_S = 20
MOST_S = 300
FOUND = 3


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="in all, shared by the targets")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="the same seed gives the same cases")
    parser.add_argument("--target", choices=[*MAKERS], action="append", help="one or several; all without")
    parser.add_argument("--finds", type=Path, default=Path("finds"), help="folder for the cases that were found")
    parser.add_argument("--cases", type=int, default=sys.maxsize, help="at most so many of a target, however long")
    parser.add_argument("--child", nargs=3, metavar=("TARGET", "FIRST", "FOLDER"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        name, first, folder = given.child
        _child(name, given.seed, range(int(first), given.cases), 60 * given.minutes, Path(folder))
        return 0
    targets = given.target or [*MAKERS]
    seconds = 60 * given.minutes / len(targets)
    found = sum(fuzzed(name, given.seed, seconds, given.finds, cases=given.cases) for name in targets)
    return 1 if found else 0


def fuzzed(name: str, seed: int, seconds: float, kept: Path, *, cases: int = sys.maxsize) -> int:
    """Run children one after the other, each from behind the case that ended the last; the number of finds."""
    spent, first, finds = 0.0, 0, set[str]()
    while spent < seconds and first < cases:
        with tempfile.TemporaryDirectory() as folder:
            said, spent_now, last = _one_child(name, seed, range(first, cases), seconds - spent, Path(folder))
        if said and last < 0:
            raise SystemExit(f"{name} could not begin:\n{said}")
        first, spent = last + 1, spent + max(spent_now, 0.01)
        if said and said not in finds:
            finds.add(said)
            kept.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory() as folder:
                path = kept / f"{name}-{seed}-{last}"
                path.write_bytes(seeded(MAKERS[name](Path(folder)), seed, last))
            print(f"{path}: {said}", flush=True)
    print(f"{name}: seed {seed}, {first} cases in {spent:.0f} s, {len(finds)} finds", flush=True)
    return len(finds)


def _one_child(name: str, seed: int, numbers: range, seconds: float, folder: Path) -> tuple[str, float, int]:
    """(the find or nothing, seconds spent on cases, number of the last case) of one child."""
    command = [sys.executable, "-m", "tests.fuzz", "--seed", str(seed), "--minutes", str(seconds / 60)]
    command += ["--cases", str(numbers.stop), "--child", name, str(numbers.start), str(folder)]
    at, output = folder / "at", folder / "output"
    with output.open("wb") as file:
        child = subprocess.Popen(command, stdout=file, stderr=file)
    why, case, used_before, since = "", "", 0.0, 0.0
    while child.poll() is None:
        time.sleep(0.2)
        now, used = at.read_text() if at.exists() else "", processor_s(child.pid)
        if now != case:
            case, used_before, since = now, used, time.monotonic()
        elif case and used - used_before > MOST_PROCESSOR_S:
            why = f"more than {MOST_PROCESSOR_S} s of a processor"
        elif case and time.monotonic() - since > MOST_S:
            why = f"more than {MOST_S} s"
        if why:
            child.kill()
    last, began = (int(at.read_text()), (folder / "began").stat().st_mtime) if at.exists() else (-1, time.time())
    if child.returncode and not why:
        lines = output.read_text(errors="replace").strip().splitlines() or [""]
        why = lines[-1] if child.returncode == FOUND or last < 0 else f"ended with {child.returncode}: {lines[-1]}"
    return why, time.time() - began, last


def processor_s(pid: int) -> float:
    """Seconds of a processor that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def _child(name: str, seed: int, numbers: range, seconds: float, folder: Path) -> None:
    """Do cases until the time is over; the number of the one at hand stands in a file."""
    work = folder / "work"
    work.mkdir()
    target = MAKERS[name](work)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    (folder / "began").touch()
    until = time.monotonic() + seconds
    at = os.open(folder / "at", os.O_RDWR | os.O_CREAT, 0o600)
    for number in numbers:
        if time.monotonic() >= until:
            break
        os.pwrite(at, f"{number:012}".encode(), 0)
        try:
            target.do(seeded(target, seed, number))
        except target.expected:
            pass
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            print(f"\n{type(error).__name__} in {Path(place.filename).name}, {place.name}: {str(error)[:200]!r}")
            sys.stdout.flush()
            os._exit(FOUND)


if __name__ == "__main__":
    sys.exit(main())
