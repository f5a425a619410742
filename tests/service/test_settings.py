from __future__ import annotations

import pytest
from pydantic import ValidationError

from service.settings import Settings


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_loopback_addresses_are_open_to_this_machine_only(host: str) -> None:
    assert Settings(host=host).listens_to_loopback_only


def test_settings_that_would_lose_jobs_are_refused() -> None:
    with pytest.raises(ValidationError):
        Settings(lease_s=5, heartbeat_s=5)
    with pytest.raises(ValidationError):
        Settings(job_soft_limit_s=10, job_hard_limit_s=10)


def test_postgres_addresses_use_the_installed_driver() -> None:
    for given in ("postgres://u@h/d", "postgresql://u@h/d", "postgresql+psycopg://u@h/d"):
        assert Settings(database_url=given).database == "postgresql+psycopg://u@h/d"
