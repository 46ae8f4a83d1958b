"""The loop that is explored: a plant on a line, with key blocks as short as they can be."""

from dataclasses import replace
from functools import cache
from typing import Any, Final

from protocol.link.session import Rules
from protocol.schemes.base import Scheme
from protocol.schemes.pipelined import Pipelined
from protocol.schemes.sealed import Sealed
from protocol.schemes.switched import Switched
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from tests.support.line import line_rules

SHIFT: Final = 1.5
SCHEMES: Final[dict[str, type[Scheme[Any]]]] = {
    scheme.name: scheme for scheme in (Switched, Pipelined, Sealed)
}

BLOCK: Final = Schedule(Assumption(1.0, 0.5), first=2, largest=2)
"""Key blocks of two transitions, the smallest: four copies, two rows at least for a key."""

DIGITS: Final = 2
"""Of a key, so that the stream is filled and runs dry all the time."""


@cache
def rules_of(scheme: str, *, keys: bool, coin: bool = False) -> Rules:
    """The rules of a scheme: with coin 0 a disturbance of 0.3 agrees, with coin 1 it does not.

    With ``coin`` distilled keys choose it, as long as there are some.
    """
    rules = line_rules(alpha=3.0, largest_input=1e9, scheme=SCHEMES[scheme](2))
    return replace(rules, schedule=BLOCK, keyed=coin) if keys else rules


def propose(x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    """Two candidates about the origin."""
    return (-x[0] - SHIFT,), (-x[0] + SHIFT,)
