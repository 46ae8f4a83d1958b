"""Both ends on the line with key stores and two key servers: what must happen once is looked at."""

from dataclasses import replace
from typing import Any, Final

from protocol.secret.records import Key, Side, TooFewKeys, UnknownKeys

from protocol.agreement import NO_SYMBOL
from protocol.link.events import Alarm, Event
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Offer
from protocol.secret.blocks import BlockResult, Schedule
from protocol.secret.bound import Assumption
from tests.support.giving import deliver, deliver_named
from tests.support.line_ends import line_rules
from tests.support.mail import Mail
from tests.support.once import Copies, Digits
from tests.support.two_ends import OTHER, SIDES, LineEnds, Name

SMALL_BLOCKS: Final = Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6)
"""Blocks of three transitions and then six, so that keys come all the time."""


def keyed_rules(**more: Any) -> Rules:
    """The rules of the line with :data:`SMALL_BLOCKS`, and what else is given."""
    return replace(line_rules(alpha=4.0, largest_input=1e9), **{"schedule": SMALL_BLOCKS, **more})


class KeyedEnds(LineEnds):
    """Ends whose keys are made, and given to others by two servers.

    Attributes
    ----------
    given : list of Key
        By the servers.
    """

    def __init__(self, rules: Rules, **more: Any) -> None:
        self.copies, self.digits = Copies(), Digits()
        self.counted: dict[Name, dict[tuple[str, int], CountedTransition]] = {s: {} for s in SIDES}
        self.given: list[Key] = []
        super().__init__(rules, **more)

    @property
    def deaths(self) -> int:
        """Lives that are over."""
        return sum(self.lives.values()) - len(SIDES)

    def serve(self, side: Side) -> None:
        """A key server gives a key, and its partner finds the same one by its id."""
        try:
            (key,) = deliver(self.stores[side], 1, side, partner=self.stores[OTHER[side]])
        except TooFewKeys:
            return
        assert key not in self.given, "a key was given twice"
        assert key.key_id not in {name for name, _ in self.digits.served}, "a coin came from it"
        self.given.append(key)
        try:
            (same,) = deliver_named(
                self.stores[OTHER[side]], [key.key_id], partner=self.stores[side]
            )
        except UnknownKeys:
            raise AssertionError("a key was given that the partner does not have") from None
        assert same == key, "the two ends gave different keys under one id"

    def said(self, side: Name, message: Mail) -> None:
        super().said(side, message)
        if message.kind not in (Measurement, Offer):
            return
        said = message.kind.model_validate_json(message.payload)
        assert isinstance(said, Measurement | Offer)
        self.copies.left(said)

    def traced(self, side: Name, event: Event) -> None:
        if isinstance(event, BlockResult):
            assert event.what == "confirmed", "the ends hold different blocks"
        assert not isinstance(event, Alarm), "an honest step made an alarm"
        if isinstance(event, CountedTransition):
            assert (event.coin == NO_SYMBOL) == (side == "controller")
            self.digits.counted(event)
            transition = event.shared
            at = transition.session, transition.j
            self.counted[side][at] = transition
            other = self.counted[OTHER[side]].get(at)
            assert other is None or other == transition, "the ends counted differently"

    def agree(self) -> None:
        """Ids come in one order at both ends."""
        mine, theirs = ([name for name, _ in self.stores[side].ids()] for side in SIDES)
        shared = set(mine) & set(theirs)
        assert [n for n in mine if n in shared] == [n for n in theirs if n in shared]
