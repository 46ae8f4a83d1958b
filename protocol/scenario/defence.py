"""``[defence]``: how the controller tests what it is told, and what it does over an alarm."""

from collections.abc import Iterator
from typing import Literal

from protocol.defence.alarm_rule import AlarmRule, alarm_rule
from protocol.scenario.defender import Calibration
from protocol.scenario.keys import Keys
from protocol.scenario.link import Link
from protocol.scenario.parts import Positive, ScenarioTable


class DefenceTable(ScenarioTable):
    """The controller's test of each transition.

    ``residual`` asks whether some candidate explains x(k+1), in every scenario. ``keyed-coin`` asks
    besides whether the one does that a key has chosen at both ends, as long as there are keys.
    """

    kind: Literal["residual", "keyed-coin"] = "residual"
    """The test: ``residual``, some candidate explains the step; ``keyed-coin``, the one that a
    distilled key chose."""
    on_alarm: Literal["report", "safe"] = "report"
    """What an alarm does beside being told: safe ends the offers for good, and the watchdog sends
    the plant to its safe state."""
    false_alarms_a_day: Positive = 0.01
    """Honest alarms that a fitted D_c may cost; they fix how many failed tests make one."""

    @property
    def keyed(self) -> bool:
        """Whether the plant's coin comes from keys."""
        return self.kind == "keyed-coin"

    def shared(self) -> dict[str, object]:
        """What both ends must agree on, for their fingerprint."""
        return {"coin": "keyed"} if self.keyed else {}

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

    def problems(self, keys: Keys | None, link: Link) -> Iterator[str]:
        """What the scenario lacks for this, a line each."""
        if self.keyed and keys is None:
            yield f"defence.kind: {self.kind} takes distilled keys, and there is no table keys"
        elif self.keyed and keys is not None and keys.schedule() is None:
            yield (
                f"defence.kind: {self.kind} takes distilled keys, and under keys.eps_E = "
                f"{keys.eps_E:g} none is made"
            )
        if self.on_alarm == "safe" and link.watchdog_s is None:
            yield (
                "defence.on_alarm: safe ends the offers, so that the watchdog bites: expected "
                "link.watchdog_s beside it"
            )
