"""``[defence]``: how the controller tests what it is told, and what it does over an alarm."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from protocol.defence.alarm_rule import AlarmRule, alarm_rule
from protocol.defence.watch import BLOCKS, Watch
from protocol.scenario.defender import Calibration
from protocol.scenario.keys import Keys
from protocol.scenario.link import Link
from protocol.scenario.parts import Positive, ScenarioTable


class DefenceTable(ScenarioTable):
    """The controller's test of each transition, and where the plant's coin comes from.

    It asks whether some candidate explains x(k+1). Where the coin comes from keys, it also asks
    whether the candidate does that the key stream has chosen.
    """

    coin: Literal["private", "keys"] = "private"
    """Where the plant's coin comes from: ``private``, its own random draws; ``keys``, digits of the
    key stream, which the controller knows too."""
    unwatched: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Share of steps that may have no digit of the key stream, in the long run, once there were
    keys; more make an alarm."""
    on_alarm: Literal["report", "safe"] = "report"
    """What an alarm does beside being told: safe ends the offers for good, and the watchdog sends
    the plant to its safe state."""
    false_alarms_a_day: Positive = 0.01
    """Honest alarms that a fitted D_c may cost; they fix how many failed tests make one."""

    @property
    def keyed(self) -> bool:
        """Whether the plant's coin comes from keys."""
        return self.coin == "keys"

    def watch(self, keys: Keys | None) -> Watch:
        """When unwatched steps make an alarm."""
        schedule = None if keys is None else keys.schedule()
        return Watch(self.unwatched, 0 if schedule is None else BLOCKS * schedule.begins(1))

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
        if self.keyed:
            yield from needs_keys("defence.coin: 'keys'", keys)
        if self.on_alarm == "safe" and link.watchdog_s is None:
            yield (
                "defence.on_alarm: safe ends the offers, so that the watchdog bites: expected "
                "link.watchdog_s beside it"
            )


def needs_keys(what: str, keys: Keys | None) -> Iterator[str]:
    """Why something that takes the key stream has none."""
    if keys is None:
        yield f"{what} takes distilled keys, expected a table [keys] beside it"
    elif keys.schedule() is None:
        yield f"{what} takes distilled keys, and {keys.refusal()}"
