"""The answers about webhooks."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import BaseModel, Field

from service.catalog import ENDED, Delivery
from service.catalog.models import WebhookSecret
from service.webhooks import event_type


class DeliveryBody(BaseModel):
    """One event for one receiver."""

    id: str = Field(description="the `webhook-id`, the same in every attempt")
    job: str
    type: str | None = Field(description="of the event, such as job.succeeded; null while the job goes on")
    url: str
    state: Literal["waiting", "pending", "delivered", "failed"]
    attempts: int = Field(description="since the job has ended, or since it was replayed")
    next_attempt_at: datetime | None
    last_attempt_at: datetime | None
    last_status: int | None = Field(description="of the receiver's last answer")
    last_error: str | None
    created_at: datetime
    delivered_at: datetime | None


class DeliveryPage(BaseModel):
    """A page of deliveries, newest first."""

    data: list[DeliveryBody]
    next_cursor: str | None


class SecretBody(BaseModel):
    """What webhooks are signed with."""

    secret: str = Field(description="`whsec_` and base64, as the libraries of Standard Webhooks take it")
    created_at: datetime
    former_valid_until: datetime | None = Field(description="until then messages are signed with the one before, too")


def delivery_body(delivery: Delivery, job_state: str) -> DeliveryBody:
    """The answer that shows a delivery."""
    return DeliveryBody.model_validate(
        {
            "id": delivery.id,
            "job": delivery.job_id,
            "type": event_type(job_state) if job_state in ENDED else None,
            "url": delivery.url,
            "state": delivery.state,
            "attempts": delivery.attempts,
            "next_attempt_at": delivery.next_at,
            "last_attempt_at": delivery.last_attempt_at,
            "last_status": delivery.last_status,
            "last_error": delivery.last_error,
            "created_at": delivery.created_at,
            "delivered_at": delivery.delivered_at,
        }
    )


def secret_body(secret: WebhookSecret, *, now: datetime) -> SecretBody:
    """The answer that shows a secret."""
    lives = secret.former_until is not None and secret.former_until > now
    return SecretBody(
        secret=secret.secret,
        created_at=secret.created_at,
        former_valid_until=secret.former_until if lives else None,
    )
