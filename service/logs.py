"""Structured logs on standard error: one JSON object a line, or readable lines on a terminal."""

from __future__ import annotations

import logging
import sys

import structlog


def configure(level: str) -> None:
    """Send structlog's and the standard library's records the same way."""
    number = logging.getLevelNamesMapping().get(level.upper(), logging.INFO)
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.StackInfoRenderer(),
    ]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.make_filtering_bound_logger(number),
        cache_logger_on_first_use=True,
    )
    final: list[structlog.typing.Processor] = [structlog.stdlib.ProcessorFormatter.remove_processors_meta]
    if sys.stderr.isatty():
        # rich's tracebacks, its own choice, show the values of variables: keys and passwords among them
        final.append(structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback))
    else:
        final += [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    handler = logging.StreamHandler()
    handler.setFormatter(structlog.stdlib.ProcessorFormatter(foreign_pre_chain=shared, processors=final))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(number)
    logging.captureWarnings(capture=True)  # as they are, they are several lines of text
    for name in ("uvicorn", "uvicorn.error", "celery", "kombu", "alembic", "multiprocessing"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
    # the request log is ours; the migration's own lines are noise
    logging.getLogger("uvicorn.access").disabled = True
    # so are those of Celery's pool, of each step of each process; addresses that others name may hold secrets
    for name in ("alembic", "multiprocessing", "httpx", "httpcore"):
        logging.getLogger(name).setLevel(max(number, logging.WARNING))
