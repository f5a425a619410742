from __future__ import annotations

import pytest
import structlog
from sqlalchemy.exc import IntegrityError

from service.catalog import Database
from service.catalog.models import WebhookSecret

SECRET = "whsec_which-no-log-may-have"


def test_a_failing_statement_is_logged_without_what_it_holds(
    database: Database, caplog: pytest.LogCaptureFixture
) -> None:
    row = WebhookSecret(owner="key_1", secret=SECRET)  # without the time that it must have
    try:
        with database.write() as session:
            session.add(row)
    except IntegrityError:
        structlog.get_logger().exception("a step failed")
    assert "INSERT INTO webhook_secrets" in caplog.text
    assert "created_at" in caplog.text, "the reason stays"
    assert SECRET not in caplog.text
