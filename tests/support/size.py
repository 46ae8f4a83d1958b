"""How large a test over many runs is: few in the gate, or as many as are tried for a release."""

import os
from typing import Final, TypeVar

WHOLE: Final = os.environ.get("WYNER_TESTS") == "whole"
"""As with ``WYNER_TESTS=whole make test ALL=1``, the last part of ``make campaign``: hours."""

T = TypeVar("T")


def size(few: T, many: T) -> T:
    """Return the runs, steps, seeds or cases of the gate, or those for a release."""
    return many if WHOLE else few
