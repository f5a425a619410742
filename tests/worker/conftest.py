"""Fixtures of the worker's tests."""

from __future__ import annotations

from tests.service.fixtures import clock, database, plain_logs, postgres_url, redis_url, settings

__all__ = ["clock", "database", "plain_logs", "postgres_url", "redis_url", "settings"]
