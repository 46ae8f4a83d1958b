"""What an attack came to: onset, alarm, and how far the plant was from what was shown."""

from array import array
from dataclasses import dataclass, field
from math import isnan, nan
from typing import Any

from protocol.link.events import AttackBegan
from protocol.statistics import GIVEN
from runtime.recording import TraceError
from wyner.runs.run import Run


class Places:
    """Steps of all sessions, counted through: a session that begins anew goes on with the count."""

    def __init__(self) -> None:
        self._first: dict[str, int] = {}
        self._next = 0

    def of(self, session: str, k: int) -> int:
        """The place of a step; in the first session it is the step itself."""
        if session not in self._first:
            self._first[session] = self._next - k if self._first else 0
        place = self._first[session] + k
        self._next = max(self._next, place + 1)
        return place


class Rows:
    """A few numbers a step, by place; 8 bytes each from the first one on."""

    def __init__(self) -> None:
        self._values = array("d")
        self._begin = self._width = 0

    def put(self, place: int, row: list[float]) -> None:
        """Keep the numbers of a step."""
        if not self._values:
            self._begin, self._width = place, len(row)
        at = (place - self._begin) * self._width
        if at < 0:
            return
        self._values.extend([nan] * (at + self._width - len(self._values)))
        self._values[at : at + self._width] = array("d", row)

    def get(self, place: int) -> list[float]:
        """Those of a step; empty where there are none."""
        at = (place - self._begin) * self._width
        row = self._values[at : at + self._width].tolist() if at >= 0 else []
        return [] if any(map(isnan, row)) else row

    def known(self) -> list[float]:
        """All numbers, in order."""
        return [value for value in self._values if not isnan(value)]


@dataclass(slots=True)
class AttackCounts:
    """Follows the traces of an attacked plant and of its controller, the plant's first.

    Distances are between true and reported state, the largest of their components.

    Parameters
    ----------
    attack : dict, optional
        The attack as the plant's trace names it.
    failed : str
        Why the attack itself was over before the run.
    unread : list of str
        Traces that cannot be read to their end, and why: what they would tell is not known.
    off : Rows
        The distance at x(k+1), from the onset on.
    alarms : list of (int, int)
        Place and step of the readings over which the controller alarmed.
    shown : float, optional
        The largest component of the last state that the controller was shown.
    watched, unwatched : int
        Transitions from the onset on that a key's digit was asked of, and others.
    """

    attack: dict[str, Any] | None = None
    failed: str = ""
    unread: list[str] = field(default_factory=list)
    off: Rows = field(default_factory=Rows)
    alarms: list[tuple[int, int]] = field(default_factory=list)
    watched: int = 0
    unwatched: int = 0
    shown: float | None = None
    _sent: Rows = field(default_factory=Rows)
    _places: Places = field(default_factory=Places)

    def plant(self, event: dict[str, Any]) -> None:
        """Take an event of the plant's trace."""
        if event["event"] == "attack":
            self.attack = {name: value for name, value in event.items() if name != "event"}
        if event["event"] in ("transition", "missed", "interrupted"):
            after = self._places.of(event["session"], event["k"]) + 1
            true = event.get("true_x_next")
            if self.attack is not None and after >= self.attack["onset"]:
                if true is not None:
                    self.off.put(after, [_distance(true, event["x_next"])])
                elif event["event"] == "transition":
                    self._sent.put(after, event["x_next"])
        self.failed = event.get("attack_failed") or self.failed

    def controller(self, event: dict[str, Any]) -> None:
        """Take an event of the controller's trace."""
        if event["event"] == "alarm":
            k = event["k"]
            self.alarms.append((self._places.of(event["session"], k) + 1, k + 1))
        if event["event"] == "transition" and self.attack is not None:
            self.shown = max(map(abs, event["x_next"]))
            after = self._places.of(event["session"], event["k"]) + 1
            if after < self.attack["onset"]:
                return
            if self.attack["at"] == "bus" and (sent := self._sent.get(after)):
                self.off.put(after, [_distance(sent, event["x_next"])])
            self.watched += event.get("expected", -1) >= 0
            self.unwatched += event.get("expected", -1) < 0

    def as_json(self) -> dict[str, Any] | None:
        """What it came to; None where nobody attacked, as far as the plant's trace tells.

        ``alarm_k`` is the first alarm from the onset on, -1 none; ``delay`` the steps from the
        last true reading to it. ``false_alarms`` came before. ``away_at_alarm``, ``away``,
        ``away_most``: the distance at the alarm, at the end, at most (None: not known); ``shown``:
        the largest component of the last state that was shown. ``unread`` names the traces of
        which a part cannot be read: what stands there is not in these figures.
        """
        if self.attack is None:
            return None
        onset = self.attack["onset"]
        alarms = sorted(self.alarms)
        place, alarm = next((one for one in alarms if one[0] >= onset), (-1, -1))
        off = self.off.known()
        return {
            **self.attack,
            "failed": self.failed,
            "alarm_k": alarm,
            "delay": place - onset + 1 if alarm >= 0 else -1,
            "false_alarms": sum(at < onset for at, _ in alarms),
            "watched": self.watched,
            "unwatched": self.unwatched,
            "away_at_alarm": next(iter(self.off.get(place)), None) if alarm >= 0 else None,
            "away": off[-1] if off else None,
            "shown": self.shown,
            "away_most": max(off, default=None),
            "unread": self.unread,
            "no_interval": {"options": GIVEN},
        }


def _distance(true: list[float], told: list[float]) -> float:
    return max(abs(a - b) for a, b in zip(true, told, strict=True))


def attacked(run: Run) -> AttackCounts:
    """Read it from a run's traces; one that is damaged, or not there, is named in ``unread``."""
    counts = AttackCounts()
    for side, take in (("plant", counts.plant), ("controller", counts.controller)):
        try:
            run.feed(side, take)  # type: ignore[arg-type]
        except TraceError as error:
            counts.unread.append(str(error))
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
        text = "alarm or not is unknown" if found["unread"] else "no alarm"
        told = "" if away is None else f"at the end the plant is {away:.2g} from what is shown"
    lines = [f"Attack     {head}: {text}", *([f"           {told}"] if told else [])]
    lines += [f"           WARNING: counted up to there: {why}" for why in found["unread"]]
    if not found["watched"]:
        lines.append("           no step was watched: no key chose the plant's input")
    elif found["unwatched"]:
        lines.append(f"           {found['watched']} steps watched, {found['unwatched']} unwatched")
    if found["false_alarms"]:
        lines.append(f"           {found['false_alarms']} FALSE ALARMS before the onset")
    return lines
