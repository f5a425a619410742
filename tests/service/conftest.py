"""Fixtures of the service's tests."""

from __future__ import annotations

from tests.service.fixtures import api, clock, database, own_database, plain_logs, settings

__all__ = ["api", "clock", "database", "own_database", "plain_logs", "settings"]
