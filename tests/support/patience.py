"""How long a test waits for what has to come: no test is of how fast the machine is."""

import time
from collections.abc import Callable
from typing import Final

PATIENCE_S: Final = 240.0
"""Seconds. Less than a test may take in all, so that it fails where it waits."""


def wait_for(condition: Callable[[], object], what: str = "what has to come") -> None:
    """Wait until a condition holds.

    Raises
    ------
    AssertionError
        When it does not in :data:`PATIENCE_S`.
    """
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until, f"waited in vain: {what}"
        time.sleep(0.02)
