"""Both ends on the line with distilled keys: what must happen once is looked at."""

from dataclasses import replace
from typing import Any, Final

from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import BlockEnded
from protocol.link.events import Alarm, Event
from protocol.link.records import Side
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Offer
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from protocol.secret.stream import Held
from tests.support.line import line_rules
from tests.support.mail import Mail
from tests.support.once import Copies, Digits
from tests.support.pair import OTHER, SIDES, LinePair, Name
from tests.support.safety import differing_key

SMALL_BLOCKS: Final = Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6)
"""Blocks of three transitions and then six, so that keys come all the time."""


def keyed_rules(**more: Any) -> Rules:
    """The rules of the line with :data:`SMALL_BLOCKS`, and what else is given."""
    return replace(line_rules(alpha=4.0, largest_input=1e9), **{"schedule": SMALL_BLOCKS, **more})


class KeyedPair(LinePair):
    """Ends whose keys are made, and serve where the rules say so.

    Attributes
    ----------
    copies, digits
        What the onlooker saw.
    confirmed : dict of str to list
        Blocks that each end has confirmed, by session and number, and how many keys each gave.
    """

    def __init__(self, rules: Rules, **more: Any) -> None:
        self.copies, self.digits = Copies(), Digits(rules.digits)
        self.counted: dict[Name, dict[tuple[str, int], CountedTransition]] = {s: {} for s in SIDES}
        self.confirmed: dict[Name, dict[tuple[str, int], int]] = {s: {} for s in SIDES}
        super().__init__(rules, **more)

    @property
    def deaths(self) -> int:
        """Lives that are over."""
        return sum(self.lives.values()) - len(SIDES)

    def said(self, side: Name, message: Mail) -> None:
        super().said(side, message)
        if message.kind not in (Measurement, Offer):
            return
        said = message.kind.model_validate_json(message.payload)
        assert isinstance(said, Measurement | Offer)
        self.copies.left(said)
        if isinstance(said, Offer):
            self.digits.named(said)

    def traced(self, side: Name, event: Event) -> None:
        if isinstance(event, BlockEnded):
            assert event.what != "unequal", "the ends hold different blocks"
            self.confirmed[side][event.session, event.number] = event.keys
        honest = not isinstance(event, Alarm) or event.reason == "unwatched"  # the stream was dry
        assert honest, "an honest step made an alarm"
        if isinstance(event, CountedTransition):
            assert (event.coin == NO_SYMBOL) == (side == "controller")
            self.digits.counted(event, coins=self.rules.keyed)
            transition = event.shared
            at = transition.session, transition.j
            self.counted[side][at] = transition
            other = self.counted[OTHER[side]].get(at)
            assert other is None or other == transition, "the ends counted differently"

    def held(self, side: Side) -> Held:
        """The key stream that an end's journal holds."""
        return self.journals[side].load().held

    def agree(self) -> None:
        """What both journals hold of the key stream of one session is the same."""
        mine, theirs = (self.journals[side].load() for side in SIDES)
        if mine.record is None or theirs.record is None:
            return
        if mine.record.session.id != theirs.record.session.id:
            return
        wrong = differing_key(self.rules.size, mine.held, theirs.held)
        assert not wrong, wrong
