"""What is warned of during a run, kept for its report."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

ALL_OF_IT = "stillroom"
MOST = 500
"""Warnings that are kept; a run that has more has one cause for them."""


class _Keeper(logging.Handler):
    def __init__(self, warnings: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._warnings = warnings

    def emit(self, record: logging.LogRecord) -> None:
        if len(self._warnings) < MOST:
            self._warnings.append(" ".join(record.getMessage().split()))
        last = logging.lastResort
        if last is not None and record.levelno >= last.level and self._stands_alone(record.name):
            last.handle(record)  # as where nobody listens; this one only takes notes

    def _stands_alone(self, name: str) -> bool:
        """Return whether this is the first of those that take notes, and nobody else hears a logger."""
        logger: logging.Logger | None = logging.getLogger(name)
        heard: list[logging.Handler] = []
        while logger is not None:
            heard += logger.handlers
            logger = logger.parent if logger.propagate else None
        return heard[0] is self and all(isinstance(handler, _Keeper) for handler in heard)


@contextmanager
def kept_warnings(warnings: list[str]) -> Iterator[None]:
    """Add what the package warns of in the block, on whatever thread, to a list; of two runs at a time, of both."""
    logger, keeper = logging.getLogger(ALL_OF_IT), _Keeper(warnings)
    logger.addHandler(keeper)
    try:
        yield
    finally:
        logger.removeHandler(keeper)
