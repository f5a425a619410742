"""Webhooks by the Standard Webhooks specification, 1.0.0: what is sent, how it is signed, and who sends it."""

from __future__ import annotations

from service.webhooks.deliverer import Deliverer
from service.webhooks.payloads import event_type, payload
from service.webhooks.signing import signed_headers

__all__ = ["Deliverer", "event_type", "payload", "signed_headers"]
