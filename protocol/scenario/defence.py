"""``[defence]``: how the controller tests what it is told, and what it does over an alarm."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

from protocol.defence.alarm_rule import AlarmRule, alarm_rule
from protocol.defence.words import KEY_WORDS
from protocol.registry import UnknownError, names_a_file
from protocol.scenario.defender import Calibration
from protocol.scenario.keys import Keys
from protocol.scenario.link import Link
from protocol.scenario.parts import Positive, ScenarioTable

if TYPE_CHECKING:
    from protocol.defence.base import Defence

CLEAR: Final = "clear"
"""Messages as they are."""

TESTS: Final = ("residual", "keyed-coin")
"""The tests that are shipped."""

GUARDS: Final = (CLEAR, "mac", "coding")
"""What is shipped to guard messages, and nothing."""


def _class(name: str) -> "type[Defence]":
    """A defence's class; loaded where there is one, since it takes numerics."""
    from protocol.defence.registry import DEFENCES

    return DEFENCES[name]


class DefenceTable(ScenarioTable):
    """The controller's test of each transition, and what guards the messages.

    ``residual`` asks whether some candidate explains x(k+1), in every scenario. ``keyed-coin`` asks
    besides whether the one does that a key has chosen at both ends, as long as there are keys. A
    class of the user's asks what it likes, beside the residual.
    """

    kind: str = "residual"
    """The test: ``residual``, some candidate explains the step; ``keyed-coin``, the one that a
    distilled key chose; or that of a class of the user's, ``path/to/file.py:Name``."""
    messages: str = CLEAR
    """What guards the messages on the field bus: ``clear``, nothing; ``mac``, a one-time tag on
    each; ``coding``, each measurement turned by a fresh orthogonal matrix; or a class of the
    user's, ``path/to/file.py:Name``. All but clear take distilled keys."""
    on_alarm: Literal["report", "safe"] = "report"
    """What an alarm does beside being told: safe ends the offers for good, and the watchdog sends
    the plant to its safe state."""
    false_alarms_a_day: Positive = 0.01
    """Honest alarms that a fitted D_c may cost; they fix how many failed tests make one."""

    @property
    def keyed(self) -> bool:
        """Whether the plant's coin comes from keys."""
        return self.kind == "keyed-coin"

    def test(self, states: int, candidates: int) -> "Defence | None":
        """The test of the user's; None where it is a shipped one.

        Raises
        ------
        UnknownError
            In one line, when there is no such class.
        """
        return None if self.kind in TESTS else _class(self.kind)(states, candidates)

    @property
    def guards(self) -> bool:
        """Whether messages on the field bus are guarded."""
        return self.messages != CLEAR

    def guard(self, states: int, candidates: int) -> "Defence | None":
        """What guards the messages; None: nothing does.

        Raises
        ------
        UnknownError
            In one line, when there is no such class.
        """
        return None if self.messages == CLEAR else _class(self.messages)(states, candidates)

    def words(self) -> str:
        """The test and what guards the messages."""
        return self.kind if self.messages == CLEAR else f"{self.kind} + {self.messages}"

    def shared(self) -> dict[str, object]:
        """What both ends must agree on, for their fingerprint."""
        coin = {"coin": "keyed"} if self.keyed else {}
        guard = {} if self.messages == CLEAR else {"messages": self._name(self.messages)}
        return {**coin, **guard}

    @staticmethod
    def _name(name: str) -> tuple[str, ...]:
        from protocol.defence.registry import DEFENCES

        source = DEFENCES.source(name)
        return (DEFENCES[name].name, source) if source else (name,)

    def rule(self, calibration: Calibration | None, period_s: float, candidates: int) -> AlarmRule:
        """When failed tests make an alarm: the first one does, unless D_c is a fitted one.

        Raises
        ------
        ValueError
            When no rule keeps to ``false_alarms_a_day``.
        """
        if calibration is None:
            return AlarmRule()
        return alarm_rule(
            calibration.violation,
            calibration.steps,
            period_s,
            self.false_alarms_a_day,
            candidates,
        )

    def problems(
        self, keys: Keys | None, link: Link, states: int, candidates: int
    ) -> Iterator[str]:
        """What the scenario lacks for this, a line each."""
        for field, name in (("kind", self.kind), ("messages", self.messages)):
            shipped = TESTS if field == "kind" else (CLEAR,)
            unfit = () if name in shipped else tuple(self._unfit(field, name, states, candidates))
            if unfit:
                yield from unfit
                continue
            taken = name not in ("residual", CLEAR) and (field == "messages" or self.keyed)
            if taken and keys is None:
                yield f"defence.{field}: {name} takes distilled keys, and there is no table keys"
            elif taken and keys is not None and keys.schedule() is None:
                yield (
                    f"defence.{field}: {name} takes distilled keys, and under keys.eps_E = "
                    f"{keys.eps_E:g} none is made"
                )
        if self.on_alarm == "safe" and link.watchdog_s is None:
            yield (
                "defence.on_alarm: safe ends the offers, so that the watchdog bites: expected "
                "link.watchdog_s beside it"
            )

    @staticmethod
    def _unfit(field: str, name: str, states: int, candidates: int) -> Iterator[str]:
        """Why a defence cannot do what ``field`` asks of it."""
        from protocol.defence.registry import DEFENCES

        shipped, own = (
            (TESTS, "a test without a key of its own")
            if field == "kind"
            else (GUARDS, "one that codes or tags")
        )
        expected = f"expected {', '.join(shipped)} or {own}, as path/to/file.py:Name"
        other = f"defence.{field}: got {name!r}, {expected}"
        if name not in DEFENCES and not names_a_file(name):
            yield other
            return
        try:
            made = DEFENCES[name](states, candidates)
        except UnknownError as error:
            yield f"defence.{field}: {error}"
            return
        words = made.session_words + made.step_words
        tests, guards = not words and name not in DEFENCES.shipped, made.codes or made.tags
        if not (tests if field == "kind" else guards):
            yield other
        elif field == "messages" and not made.step_words:
            yield f"defence.messages: {name}: expected one with a fresh key for each message"
        elif field == "messages" and words > KEY_WORDS:
            yield (
                f"defence.messages: {name} takes {words} words of key for a message of {states} "
                f"states, expected {KEY_WORDS} at most, a key"
            )
