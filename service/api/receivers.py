"""The receiver of webhooks that a request names."""

from __future__ import annotations

from collections.abc import Sequence

from service.api.problems import invalid_values
from service.api.schemas import WebhookRequest
from service.api.services import Services
from service.errors import UrlNotAllowedError


def receiver(services: Services, webhook: WebhookRequest | None, place: str = "/webhook/url") -> str | None:
    """The URL of a receiver, as far as it can be checked before anything is sent there.

    ``place`` is where in the request it stands. Raises `UrlNotAllowedError`.
    """
    if webhook is None:
        return None
    try:
        if not webhook.url.isascii() or not webhook.url.isprintable() or " " in webhook.url:
            raise UrlNotAllowedError("the URL must hold ASCII characters alone, and no spaces")
        services.egress.check(webhook.url)
    except UrlNotAllowedError as error:
        raise UrlNotAllowedError(error.detail, errors=[{"pointer": place, "detail": error.detail}]) from error
    return webhook.url


def receiver_of_fields(services: Services, fields: Sequence[str]) -> str | None:
    """The same of what a query, a form or tus has as `webhook`, once at most. Raises `ValidationFailedError` too."""
    if not fields:
        return None
    if len(fields) > 1:
        raise invalid_values({"/webhook": "it is given more than once"})
    return receiver(services, WebhookRequest(url=fields[0]), "/webhook")
