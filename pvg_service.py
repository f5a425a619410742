"""The `pvg-service` command where the service may not be installed: then one line instead of a traceback."""

from __future__ import annotations

import sys
from importlib.util import find_spec

# what each of the service's processes needs first; all of them come with the extra
_OF_THE_EXTRA = ("celery", "fastapi", "pydantic_settings", "sqlalchemy", "typer", "uvicorn")
_HEALTH = (["health"], ["health", "--worker"], ["health", "--previews"])


def main() -> None:
    """Run the service's command; exit code 1 without what it needs."""
    missing = [name for name in _OF_THE_EXTRA if find_spec(name) is None]
    if missing:
        sys.exit(f"pvg-service: {missing[0]} is not installed; pip install 'pvg-face-color[service]'")
    # asked for every few seconds, beside work that wants the processor: without all that the other commands load
    if sys.argv[1:] in _HEALTH:
        _tell_health()
    from service.cli import main as run  # noqa: PLC0415 - after the check

    run()


def _tell_health() -> None:
    """End with what `pvg-service health` says; settings that are wrong are left to the command itself."""
    from service import health  # noqa: PLC0415 - after the check
    from service.settings import Settings  # noqa: PLC0415 - the same

    try:
        settings = Settings()
    except ValueError:
        return
    parts: tuple[health.Part, ...] = ("api", "jobs", "previews")
    sys.exit(health.report(settings, parts[_HEALTH.index(sys.argv[1:])]))
