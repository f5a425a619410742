"""Webhooks as the service sends them: what was told to whom, telling it again, and what it is signed with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pvg_client.calls import Api, Flow, Params, asked, once
from pvg_client.models import Job, Webhook, WebhookSecret, id_of
from pvg_client.pages import Listing, each
from pvg_client.paths import path_to

State = Literal["waiting", "pending", "delivered", "failed"]


def webhooks(
    api: Api,
    *,
    job: Job | str | None = None,
    state: Sequence[State] | State = (),
) -> Listing[Webhook]:
    """Webhooks, newest first: all, those of a job, or those in any of some states."""
    params: Params = [("job", id_of(job))] if job is not None else []
    return Listing("/webhooks", params + [("state", one) for one in each(state)], Webhook.of)


def webhook(api: Api, webhook_id: Webhook | str) -> Flow[Webhook]:
    """A webhook, as it is now."""
    return (yield from asked(api, Webhook.of, "GET", path_to("webhooks", id_of(webhook_id))))


def replay(api: Api, webhook: Webhook | str, *, idempotency_key: str | None = None) -> Flow[Webhook]:
    """Have it told again, with the same id. Raises `ApiError` 409 while its job goes on."""
    path = path_to("webhooks", id_of(webhook), "replay")
    return (yield from asked(api, Webhook.of, "POST", path, headers=once(idempotency_key)))


def webhook_secret(api: Api) -> Flow[WebhookSecret]:
    """What webhooks are signed with; each key has its own."""
    return (yield from asked(api, WebhookSecret.of, "GET", "/webhooks/secret"))


def rotate_webhook_secret(api: Api, *, idempotency_key: str | None = None) -> Flow[WebhookSecret]:
    """Have another secret made; for 24 h messages are signed with the one before, too.

    Raises `ApiError` (409) while four former ones are good; its ``retry_after_s`` says for how long.
    """
    return (yield from asked(api, WebhookSecret.of, "POST", "/webhooks/secret/rotate", headers=once(idempotency_key)))
