"""Calls that may never come back, and the end of a process in which one has not."""

import logging
import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final

_CALLS: Final[list[threading.Thread]] = []
"""Those that did not come back in time."""


def within(limit_s: float, call: Callable[[], object]) -> bool:
    """Make a call, and wait for it so many seconds; whether it came back.

    It is made on a thread of its own, which is left where it is if it does not. What the call
    raises is raised here.
    """
    raised: list[BaseException] = []

    def make() -> None:
        try:
            call()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=make, daemon=True)
    thread.start()
    thread.join(limit_s)
    if thread.is_alive():
        _CALLS.append(thread)
        return False
    if raised:
        raise raised[0]
    return True


def leave(code: int) -> int:
    """The exit code; where a call still hangs the process ends here.

    The interpreter would wait for what the call holds, or end in it.
    """
    if any(thread.is_alive() for thread in _CALLS):
        logging.shutdown()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    return code
