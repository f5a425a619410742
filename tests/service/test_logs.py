from __future__ import annotations

import subprocess
import sys

import pytest

FAILING = """
import io, logging, sys
import structlog
from service.logs import configure

class Terminal(io.StringIO):
    def isatty(self):
        return {is_terminal}

told, sys.stderr = sys.stderr, Terminal()
configure("INFO")

def answer(key):
    headers = {{"authorization": "Bearer " + key}}
    raise RuntimeError("boom")

try:
    answer("s3cr" + "et")
except RuntimeError:
    structlog.get_logger("service").exception("unhandled error")
    logging.getLogger("uvicorn.error").exception("failed")
told.write(sys.stderr.getvalue())
"""


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_traceback_shows_no_values_of_variables(is_terminal: bool) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FAILING.format(is_terminal=is_terminal)], capture_output=True, text=True, check=True
    )
    assert done.stderr.count("RuntimeError: boom") == 2
    assert done.stderr.count("in answer") == 2
    assert "s3cret" not in done.stderr


LEVELS = """
import logging, sys
from service.logs import configure

configure("{level}")
for name in ("alembic", "multiprocessing", "httpx", "service"):
    for said in (logging.INFO, logging.WARNING, logging.ERROR):
        logging.getLogger(name).log(said, "said")
"""


@pytest.mark.parametrize(("level", "lines"), [("DEBUG", 9), ("WARNING", 8), ("ERROR", 4)])
def test_nothing_below_the_level_that_is_asked_for_is_logged(level: str, lines: int) -> None:
    """Of some libraries no line below a warning is at any level."""
    done = subprocess.run(
        [sys.executable, "-c", LEVELS.format(level=level)], capture_output=True, text=True, check=True
    )
    assert len(done.stderr.splitlines()) == lines
