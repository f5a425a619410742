from __future__ import annotations

import pytest


def test_groups_are_kept_together(request: pytest.FixtureRequest) -> None:
    """xdist tells groups by the ends of ids; with pytest 9.2 it cannot, and services run beside each other."""
    if request.config.getoption("loadgroup", default=False):
        assert request.node.nodeid.endswith("@whole")
