"""Python's garbage collection, in a program that runs for long."""

import gc
from typing import Final

_NEVER: Final = 2**31 - 1
"""Collections of the middle generation before one of the oldest."""

_GROWN: Final = 50_000
"""Containers by which a service grows before what is young is searched for garbage."""


def freeze_startup() -> None:
    """Take what a service has loaded out of garbage collection, once, before its loop begins.

    Modules, schemas and the design live as long as the process; searching them again and again
    made a control step a sixth longer. After that a search pays only where garbage in circles
    comes, and a loop makes none. Python counts what is made less what is let go: where windows
    roll, 700 more are there only every 18 s, but all that was made since then and lives is young,
    and with 200 loops searching it stopped a host for 20 to 50 ms. So it is searched once a
    service has grown by `_GROWN`, and what has grown old is not.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(_GROWN, gc.get_threshold()[1], _NEVER)
