"""Fixtures of the tests of the contract."""

from __future__ import annotations

from tests.service.fixtures import api, clock, database, plain_logs, settings

__all__ = ["api", "clock", "database", "plain_logs", "settings"]
