"""`python -m pvg` is the command `pvg`."""

from __future__ import annotations

from pvg.cli import main

main()
