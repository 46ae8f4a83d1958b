"""How large a test over many runs is: few in the gate, or as many as are tried for a release."""

import os
from typing import Final, TypeVar

WHOLE: Final = os.environ.get("WYNER_TESTS") == "whole"
"""``WYNER_TESTS=whole make test ALL=1`` takes hours; its result stands in docs/reliability.md."""

T = TypeVar("T")


def size(few: T, many: T) -> T:
    """Return the runs, steps, seeds or cases of the gate, or those for a release."""
    return many if WHOLE else few
