"""The `pvg-service` command where the service may not be installed: then one line instead of a traceback."""

from __future__ import annotations

import sys
from importlib.util import find_spec

# what each of the service's processes needs first; all of them come with the extra
_OF_THE_EXTRA = ("celery", "fastapi", "pydantic_settings", "sqlalchemy", "typer", "uvicorn")


def main() -> None:
    """Run the service's command; exit code 1 without what it needs."""
    missing = [name for name in _OF_THE_EXTRA if find_spec(name) is None]
    if missing:
        sys.exit(f"pvg-service: {missing[0]} is not installed; pip install 'pvg-face-color[service]'")
    from service.cli import main as run  # noqa: PLC0415 - after the check

    run()
