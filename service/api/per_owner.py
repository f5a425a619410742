"""How much each owner has at a time, in one process."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager


class PerOwner:
    """Counts what is taken, by owner, until it is left. An owner who has nothing takes no memory."""

    def __init__(self) -> None:
        self._of: Counter[str] = Counter()

    @property
    def total(self) -> int:
        """What all have."""
        return self._of.total()

    def held(self, owner: str) -> int:
        """What one has."""
        return self._of[owner]

    def take(self, owner: str) -> None:
        """One more."""
        self._of[owner] += 1

    def leave(self, owner: str) -> None:
        """One less."""
        self._of[owner] -= 1
        if not self._of[owner]:
            del self._of[owner]

    @contextmanager
    def one_more(self, owner: str) -> Iterator[None]:
        """One more inside the block."""
        self.take(owner)
        try:
            yield
        finally:
            self.leave(owner)
