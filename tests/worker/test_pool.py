"""Pool children that are killed, on the embedded broker."""

from __future__ import annotations

import subprocess
import sys

from worker.app import app
from worker.pool import TaskPool

#: each in turn: one of the two is the one that waits for the next message
KILL_IDLE = """
import os, signal, time
from worker.pool import Pool

def is_idle(pid):  # it sleeps: in between it holds the lock of the answers for a moment
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] == "S"

pool = Pool(2)
for victim in [process.pid for process in pool._pool]:
    for _ in range(4):
        pool.apply_async(os.getpid).get(60)
    until = time.monotonic() + 120
    while not is_idle(victim):
        assert time.monotonic() < until
        time.sleep(0.05)
    os.kill(victim, signal.SIGKILL)
    while victim in {process.pid for process in pool._pool} or len(pool._pool) < 2:
        assert time.monotonic() < until
        time.sleep(0.05)
    assert all(pool.apply_async(os.getpid).get(60) != victim for _ in range(4))
pool.terminate()
pool.join()
"""
SEND_MANY = """
from worker.pool import Pool

pool = Pool(2)
sent = [f"{number}" * 1000 for number in range(200)]
answers = [pool.apply_async(str.encode, (text,)) for text in sent]
assert [answer.get(60) for answer in answers] == [text.encode() for text in sent]
pool.close()
pool.join()
"""


def run(code: str) -> None:
    """In a process without threads: a pool forks."""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=500)


def test_the_worker_uses_it() -> None:
    assert app.conf.worker_pool == f"{TaskPool.__module__}:{TaskPool.__name__}"


def test_whichever_idle_child_is_killed_the_next_message_is_worked_on() -> None:
    run(KILL_IDLE)


def test_each_message_reaches_one_child_whole_and_the_pool_ends() -> None:
    run(SEND_MANY)
