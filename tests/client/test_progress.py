"""The bar of a job that is waited for."""

from __future__ import annotations

import io
import sys

import pytest

from pvg_client import Client
from tests.client.test_retries import Script, good


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def steps() -> Script:
    running = {"state": "running", "done": False, "progress": {"stage": "render", "fraction": 0.41}}
    return Script(good(**running), good(progress={"stage": "render", "fraction": 1.0}))


def test_on_a_terminal_it_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    monkeypatch.setattr(sys, "stderr", Terminal())
    script = steps()
    with Client(transport=script) as client:
        client.wait("job_1")
    assert "transfer, render  41%" in sys.stderr.getvalue()  # type: ignore[attr-defined]
    assert "transfer, render 100%" in sys.stderr.getvalue()  # type: ignore[attr-defined]
    assert script.requests[0].url.params["wait"] == "1.0"  # so that it moves while the job goes on


def test_the_queue_and_the_rest_of_the_time_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    monkeypatch.setattr(sys, "stderr", Terminal())
    queued = {"state": "queued", "done": False, "progress": {"stage": None, "fraction": 0.0}, "waiting_for": None}
    running = {"state": "running", "done": False, "progress": {"stage": "render", "fraction": 0.41}, "queue": None}

    def eta(seconds: float) -> dict[str, float]:
        return {"seconds": seconds, "low": seconds / 2, "high": seconds * 2}

    script = Script(
        good(**queued | {"waiting_for": "media"}, queue=None, eta=None),
        good(**queued, queue={"position": 3}, eta=eta(7200)),
        good(**queued, queue={"position": 1}, eta=eta(300)),
        good(**running, eta=eta(24.1)),
        good(queue=None, eta=None, progress={"stage": "render", "fraction": 1.0}),
    )
    with Client(transport=script) as client:
        done = client.wait("job_1")
    printed = sys.stderr.getvalue()  # type: ignore[attr-defined]
    assert "transfer, waiting for media   0%" in printed
    steps = [("queued, number 3   0%", "about 2.0 h left"), ("queued, number 1   0%", "about 5 min left")]
    for stands, left in [*steps, ("render  41%", "about 24 s left")]:
        assert [line for line in printed.split("\r") if f"transfer, {stands}" in line and left in line], printed
    assert "left" not in [line for line in printed.split("\r") if "100%" in line][-1]
    assert (done.queue_position, done.eta) == (None, None)


@pytest.mark.parametrize("terminal", [False, True])
def test_elsewhere_or_unasked_nothing_is_printed(monkeypatch: pytest.MonkeyPatch, terminal: bool) -> None:
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    monkeypatch.setattr(sys, "stderr", Terminal() if terminal else io.StringIO())
    with Client(transport=steps()) as client:
        client.wait("job_1", progress=not terminal)
    assert sys.stderr.getvalue() == ""  # type: ignore[attr-defined]


@pytest.mark.parametrize("closed", [False, True], ids=["none", "closed"])
def test_without_a_standard_error_a_wait_is_the_same(monkeypatch: pytest.MonkeyPatch, closed: bool) -> None:
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    stream = Terminal()
    stream.close()
    monkeypatch.setattr(sys, "stderr", stream if closed else None)
    with Client(transport=steps()) as client:
        assert client.wait("job_1").done


def test_without_tqdm_a_wait_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with Client(transport=steps()) as client:
        assert client.wait("job_1").done
    assert sys.stderr.getvalue() == ""  # type: ignore[attr-defined]
