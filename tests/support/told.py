"""What a program's log tells, in lines that may stand for many."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def log_of(name: str) -> Iterator[list[str]]:
    """The lines that the log of a program tells meanwhile."""
    lines: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines.append(record.getMessage())

    log, ear = logging.getLogger(name), Ear()
    log.addHandler(ear)
    try:
        yield lines
    finally:
        log.removeHandler(ear)


def told(lines: list[str], what: str) -> int:
    """How many times ``what`` came, by the lines that speak of it and the counts in them."""
    its = [line for line in lines if what in line]
    return len(its) + sum(int(n) for n in re.findall(r"\(and (\d+) more", "\n".join(its)))
