"""What an attack came to: onset, alarm, and how far the plant was from what was shown."""

from dataclasses import dataclass, field
from typing import Any

from protocol.link.events import AttackBegan
from protocol.statistics import GIVEN
from runtime.recording import TraceError
from wyner.runs.run import Run


@dataclass(slots=True)
class AttackCounts:
    """Follows the traces of an attacked plant and of its controller.

    Distances are between true and reported state, the largest of their components.

    Parameters
    ----------
    attack : dict, optional
        The attack as the plant's trace names it.
    failed : str
        Why the attack itself was over before the run.
    off : dict of int to float
        The distance at x(k), from the onset on.
    alarms : list of int
        Steps of the readings over which the controller alarmed, in order.
    shown : float, optional
        The largest component of the last state that the controller was shown.
    watched, unwatched : int
        Transitions from the onset on that a key's digit was asked of, and others.
    """

    attack: dict[str, Any] | None = None
    failed: str = ""
    off: dict[int, float] = field(default_factory=dict)
    alarms: list[int] = field(default_factory=list)
    watched: int = 0
    unwatched: int = 0
    shown: float | None = None
    _sent: dict[int, list[float]] = field(default_factory=dict)

    def plant(self, event: dict[str, Any]) -> None:
        """Take an event of the plant's trace."""
        if event["event"] == "attack":
            self.attack = {name: value for name, value in event.items() if name != "event"}
        true = event.get("true_x_next")
        if true is not None and self.attack is not None and event["k"] + 1 >= self.attack["onset"]:
            pairs = zip(true, event["x_next"], strict=True)
            self.off[event["k"] + 1] = max(abs(a - b) for a, b in pairs)
        elif self.attack is not None and event["event"] == "transition":
            self._sent[event["k"] + 1] = event["x_next"]
        self.failed = event.get("attack_failed") or self.failed

    def controller(self, event: dict[str, Any]) -> None:
        """Take an event of the controller's trace."""
        if event["event"] == "alarm":
            self.alarms.append(event["k"] + 1)
        if event["event"] == "transition" and self.attack is not None:
            self.shown = max(map(abs, event["x_next"]))
            late = event["k"] + 1 >= self.attack["onset"]
            if late and self.attack["at"] == "bus" and event["k"] + 1 in self._sent:
                pairs = zip(self._sent[event["k"] + 1], event["x_next"], strict=True)
                self.off[event["k"] + 1] = max(abs(a - b) for a, b in pairs)
            self.watched += late and event.get("expected", -1) >= 0
            self.unwatched += late and event.get("expected", -1) < 0

    def as_json(self) -> dict[str, Any] | None:
        """What it came to; None where nobody attacked.

        ``alarm_k`` is the first alarm from the onset on, -1 none; ``delay`` the steps from the
        last true reading to it. ``false_alarms`` came before. ``away_at_alarm``, ``away``,
        ``away_most``: the distance at the alarm, at the end, at most (None: not known); ``shown``:
        the largest component of the last state that was shown.
        """
        if self.attack is None:
            return None
        onset = self.attack["onset"]
        alarms = sorted(self.alarms)
        alarm = next((k for k in alarms if k >= onset), -1)
        return {
            **self.attack,
            "failed": self.failed,
            "alarm_k": alarm,
            "delay": alarm - onset + 1 if alarm >= 0 else -1,
            "false_alarms": sum(k < onset for k in alarms),
            "watched": self.watched,
            "unwatched": self.unwatched,
            "away_at_alarm": self.off.get(alarm),
            "away": self.off[max(self.off)] if self.off else None,
            "shown": self.shown,
            "away_most": max(self.off.values(), default=None),
            "no_interval": {"options": GIVEN},
        }


def attacked(run: Run) -> AttackCounts:
    """Read it from a run's traces, as far as they can be read."""
    counts = AttackCounts()
    for side, take in (("plant", counts.plant), ("controller", counts.controller)):
        try:
            run.feed(side, take)  # type: ignore[arg-type]
        except TraceError:
            continue
    return counts


def _steps(number: int) -> str:
    return f"{number} step{'' if number == 1 else 's'}"


def attack_lines(found: dict[str, Any]) -> list[str]:
    """What an attack came to, for people."""
    head = AttackBegan(found).sentence()
    if found["failed"]:
        return [f"Attack     {head}: FAILED, the truth passed: {found['failed']}"]
    if found["alarm_k"] >= 0:
        away = found["away_at_alarm"]
        text = f"alarm at step {found['alarm_k']}, {_steps(found['delay'])} on"
        told = "" if away is None else f"the plant was then {away:.2g} from what was shown"
    else:
        away = found["away"]
        text = "no alarm"
        told = "" if away is None else f"at the end the plant is {away:.2g} from what is shown"
    lines = [f"Attack     {head}: {text}", *([f"           {told}"] if told else [])]
    if not found["watched"]:
        lines.append("           no step was watched: no key chose the plant's input")
    elif found["unwatched"]:
        lines.append(f"           {found['watched']} steps watched, {found['unwatched']} unwatched")
    if found["false_alarms"]:
        lines.append(f"           {found['false_alarms']} FALSE ALARMS before the onset")
    return lines
