"""Delivers webhooks that are due, in threads of its own: no job, request or preview ever waits for a receiver.

The queue is the table of deliveries, which has its truth in the database as jobs have: nothing is lost with a broker,
and several processes may deliver at once. An attempt that its process does not live to conclude is made again, with the
same id: receivers get each message at least once.
"""

from __future__ import annotations

import random
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from typing import Any, Final

import structlog

from service.catalog import Database, webhooks
from service.catalog.webhooks import Attempt, Due
from service.egress import Egress
from service.errors import FetchFailedError, StoppingError, UrlNotAllowedError
from service.outages import is_outage
from service.settings import Settings
from service.webhooks.payloads import payload
from service.webhooks.signing import signed_headers

log = structlog.get_logger(__name__)

#: seconds from each attempt that failed to the next one: 24 h in all, and a little more by chance
RETRIES_S: Final = (5.0, 60.0, 300.0, 1800.0, 7200.0, 18_000.0, 21_600.0, 37_500.0)
#: each is made longer by up to this part of it, so that many that failed together do not come together again
_JITTER: Final = 0.1
#: attempts at a time: of this process, of one owner to one receiver
CONCURRENCY: Final = 16
PER_ORIGIN: Final = 2
#: between two looks at what is due
POLL_S: Final = 0.5
#: for which an attempt may take longer than its own time limit before another one is made
_SPARE_S: Final = 20.0
#: how often, and after how long each time, the outcome of an attempt is tried to be written
_WRITE_TRIES: Final = 5
_WRITE_PAUSE_S: Final = 2.0
#: for which `stop` waits for attempts that are being made
_STOP_S: Final = 2.0
_GONE: Final = 410
_TAKEN: Final = range(200, 300)


class Deliverer:
    """One thread looks for what is due; each attempt has a thread for as long as it takes.

    A receiver that hangs holds `PER_ORIGIN` threads of an owner for at most ``webhook_timeout_s`` each. An owner gets
    no more places than are left free for others: half of them alone, and what two owners leave is enough for a third.
    Who has the fewest attempts under way comes first. ``egress`` is closed with it.
    """

    def __init__(self, settings: Settings, database: Database, egress: Egress) -> None:
        self._settings = settings
        self._database = database
        self._egress = egress
        self._lock = threading.Lock()
        #: attempts being made: by owner and origin, and by owner
        self._to: Counter[tuple[str, str]] = Counter()
        self._of: Counter[str] = Counter()
        self._stop = threading.Event()
        #: something may have come free, or due
        self._look = threading.Event()
        self._fails = False
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)

    def start(self) -> None:
        """Start to deliver."""
        self._thread.start()

    @property
    def busy(self) -> int:
        """How many attempts are being made."""
        return self._of.total()

    def stop(self) -> None:
        """Begin no more attempts, and wait a moment for those that are being made; others are made again later.

        One whose receiver's name has not had its turn to be looked up is given back, and does not count.
        """
        self._stop.set()
        self._look.set()
        self._thread.join(timeout=_STOP_S)
        self._egress.close()  # first: what it turns away is given back while there is a database
        until = time.monotonic() + _STOP_S
        while self.busy and time.monotonic() < until:
            time.sleep(0.02)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._look.clear()
            begun = 0
            try:
                begun = self.round()
            except Exception as error:
                self._note(error)
            else:
                self._fails = False
            if not begun:
                self._look.wait(POLL_S)

    def _note(self, error: Exception) -> None:
        """Log the first failure of several in a row: there are two looks a second."""
        if not self._fails and is_outage(error):
            log.warning("webhooks wait for the database", error=type(error).__name__)
        elif not self._fails:
            log.error("webhooks cannot be delivered for now", exc_info=error)
        self._fails = True

    def round(self) -> int:
        """Begin what is due and has a place. Returns how many attempts were begun."""
        with self._lock:
            free = CONCURRENCY - self._of.total()
            full = {one for one, count in self._to.items() if count >= PER_ORIGIN}
            over = {one for one, count in self._of.items() if count >= free}
        if free <= 0:
            return 0
        with self._database.read() as session:
            found = webhooks.due(session, now=self._database.now(), limit=CONCURRENCY * 4, not_to=full, not_of=over)
        attempts = self._claim(self._chosen(found))
        begun = 0
        try:
            for attempt in attempts:
                threading.Thread(target=self._attempt, args=(attempt,), name=attempt.delivery.id, daemon=True).start()
                begun += 1
        finally:  # there may be no thread left; what was claimed is due again when the claim runs out
            for attempt in attempts[begun:]:
                self._leave(attempt.delivery.origin, attempt.delivery.owner)
        return begun

    def _chosen(self, found: list[Due]) -> list[Due]:
        """Those of the deliveries that have a place; the place is theirs from now on."""
        waiting: dict[str, deque[Due]] = {}
        for one in found:
            waiting.setdefault(one.owner, deque()).append(one)
        chosen: list[Due] = []
        with self._lock:
            # of owners with as many under way, the one who has waited longest
            while waiting and (free := CONCURRENCY - self._of.total()) > 0:
                owner = min(waiting, key=lambda one: self._of[one])
                if self._of[owner] >= free:
                    break
                one = waiting[owner].popleft()
                if not waiting[owner]:
                    del waiting[owner]
                if self._to[owner, one.origin] < PER_ORIGIN:
                    chosen.append(one)
                    self._to[owner, one.origin] += 1
                    self._of[owner] += 1
        return chosen

    def _claim(self, chosen: list[Due]) -> list[Attempt]:
        """Claim these deliveries; those that are not had leave their places."""
        claimed: dict[str, Attempt] = {}
        lease_s = self._settings.webhook_timeout_s + _SPARE_S
        try:
            if chosen:
                with self._database.write() as session:
                    now = self._database.now()
                    # who makes an owner's first secret is waited for: in one order, so that no two wait for each other
                    in_order = sorted(chosen, key=lambda one: one.owner)
                    tried = [webhooks.claim(session, one.delivery_id, now=now, lease_s=lease_s) for one in in_order]
                claimed = {attempt.delivery.id: attempt for attempt in tried if attempt is not None}
        finally:
            for one in chosen:
                if one.delivery_id not in claimed:
                    self._leave(one.origin, one.owner)
        return list(claimed.values())

    def _leave(self, origin: str, owner: str) -> None:
        with self._lock:
            self._to[owner, origin] -= 1
            self._of[owner] -= 1
            # without what is zero they stay as small as what is under way
            self._to, self._of = +self._to, +self._of
        self._look.set()

    def _attempt(self, attempt: Attempt) -> None:
        delivery = attempt.delivery
        # the URL is the receiver's secret, often: the id tells which it is
        about = {"webhook": delivery.id, "job": attempt.job.id, "attempt": attempt.number}
        try:
            status, error = self._sent(attempt, about)
            if status in _TAKEN:
                log.info("webhook delivered", status=status, **about)
            else:
                log.info("webhook not delivered", status=status, error=error, **about)
            self._conclude(attempt, status, error)
        except StoppingError:
            self._give_back(attempt)
        except Exception:
            log.exception("the outcome of a webhook could not be recorded", **about)
        finally:
            self._leave(delivery.origin, delivery.owner)

    def _sent(self, attempt: Attempt, about: Mapping[str, Any]) -> tuple[int | None, str]:
        """As `_send`; what fails on our side is a failure as one of the receiver, so that there is an end to it."""
        try:
            return self._send(attempt)
        except StoppingError:
            raise
        except Exception as error:
            if is_outage(error):  # the claim runs out, and it is sent again
                raise
            log.exception("a webhook could not be sent", **about)
            return None, "could not be sent: an error of the service"

    def _send(self, attempt: Attempt) -> tuple[int | None, str]:
        """The status of the receiver's answer, or None; and what is wrong, if anything is. Raises `StoppingError`."""
        body = payload(attempt.job, attempt.looks, self._settings)
        headers = signed_headers(
            attempt.delivery.id, round(self._database.now().timestamp()), body, attempt.secrets
        ) | {"Content-Type": "application/json"}
        try:
            received = self._egress.post(
                attempt.delivery.url,
                headers=headers,
                content=body,
                timeout_s=self._settings.webhook_timeout_s,
                owner=attempt.delivery.owner,
            )
        except (UrlNotAllowedError, FetchFailedError) as error:
            return None, error.detail
        if received.status in _TAKEN:
            return received.status, ""
        said = "redirects are not followed" if received.leads_on else f"answered with status {received.status}"
        return received.status, said

    def _give_back(self, attempt: Attempt) -> None:
        try:
            with self._database.write() as session:
                webhooks.give_back(session, attempt, now=self._database.now())
        except Exception as error:  # the claim runs out, and it is sent again
            log.warning("a webhook could not be given back", webhook=attempt.delivery.id, error=type(error).__name__)

    def _conclude(self, attempt: Attempt, status: int | None, error: str) -> None:
        for left in range(_WRITE_TRIES, 0, -1):
            try:
                with self._database.write() as session:
                    now = self._database.now()
                    if status is not None and status in _TAKEN:
                        webhooks.succeeded(session, attempt, status, now=now)
                    else:
                        retry_s = None if status == _GONE else _retry_s(attempt.number)
                        webhooks.missed(session, attempt, now=now, retry_s=retry_s, status=status, error=error)
            except Exception as failure:
                if not is_outage(failure) or left == 1:
                    raise  # the claim runs out, and it is sent again
                self._stop.wait(_WRITE_PAUSE_S)
            else:
                return


def _retry_s(number: int) -> float | None:
    """Seconds from the attempt of this number, from 1, to the next; None after the last one."""
    if number > len(RETRIES_S):
        return None
    return RETRIES_S[number - 1] * random.uniform(1, 1 + _JITTER)  # noqa: S311 - only to come apart
