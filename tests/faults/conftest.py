"""Fixtures of the drills: harm done to the running service."""

from __future__ import annotations

from tests.service.fixtures import plain_logs

__all__ = ["plain_logs"]
