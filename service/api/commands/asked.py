"""Who sent a request, and what it asks for besides its use case."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field

from service.api.idempotency import Once


@dataclass(frozen=True)
class Asked:
    """Whose request it is, how it is answered once, and what its sender calls it."""

    owner: str
    once: Once
    _: KW_ONLY
    metadata: dict[str, str] = field(default_factory=dict)
    #: the receiver that is told of the job's end
    webhook: str | None = None
    #: make it again even if it was made before
    force: bool = False
    #: the resumable upload whose bytes it is, which ends with it
    upload: str | None = None
    #: by whoever has a link to that: nothing that is there already gets another name of it
    by_link: bool = False
