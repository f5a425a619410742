"""The HTTP interface."""

from __future__ import annotations

from service.api import server
from service.api.app import create_app
from service.api.services import Services, make_services

__all__ = ["Services", "create_app", "make_services", "server"]
