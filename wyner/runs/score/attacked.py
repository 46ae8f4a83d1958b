"""What an attack came to: onset, alarm, and how far the plant was from what was shown."""

from dataclasses import dataclass, field, fields
from math import isnan, nan
from typing import Any

import numpy as np

from protocol.arrays import Array
from protocol.link.events import AttackBegan
from protocol.scenario import Scenario
from protocol.statistics import GIVEN
from wyner.runs.lines import AlarmLine
from wyner.runs.run import Run
from wyner.runs.score.counts import parted, truth_of
from wyner.runs.trace import Places, Rows, Trace


@dataclass(slots=True)
class AttackCounts:
    """What an attack came to, from the traces of the plant and of its controller.

    Distances are between true and reported state, the largest of their components. A place is a
    step's among those of all sessions: in the first it is the step itself.

    Parameters
    ----------
    attack : dict, optional
        The attack as the plant's trace names it.
    failed : str
        Why the attack itself was over before the run.
    unread : list of str
        Traces that cannot be read to their end, and why: what they would tell is not known.
    off : float array
        The distance at the end of each step of the plant, not a number where it is not known.
    begin : int
        The place at the end of the first.
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
    off: Array = field(default_factory=lambda: np.zeros(0))
    begin: int = 1
    alarms: list[tuple[int, int]] = field(default_factory=list)
    watched: int = 0
    unwatched: int = 0
    shown: float | None = None

    def plant(self, trace: Trace, scenario: Scenario) -> None:
        """Take the plant's trace."""
        line, rows = trace.attack, trace.steps
        if line is None:
            return
        self.attack = {f.name: getattr(line, f.name) for f in fields(line) if f.name != "event"}
        self.attack["knows"] = list(line.knows)
        self.failed = trace.failed
        self.begin = 1 + int(rows["k"][0]) if len(rows) else 1
        true = truth_of(rows)
        if true is not None:
            read = true if scenario.observer is None else true @ np.array(scenario.observer.C).T
            self.off = np.abs(read - rows["x_next"]).max(axis=1)
            self.off[: max(0, line.onset - self.begin)] = np.nan
        else:
            self.off = np.full(len(rows), np.nan)

    def controller(self, trace: Trace, plant: Trace) -> None:
        """Take the controller's trace, after the plant's."""
        places = Places(plant)
        for told in trace.told("alarm"):
            line = told.line
            assert isinstance(line, AlarmLine)
            place = places.of(line.session, line.k)
            place = line.k + 1 if place < 0 else place + self.begin
            self.alarms.append((place, line.k + 1))
        for rows in parted(trace.steps) if self.attack is not None else ():
            self._shown(trace, rows, plant, places)

    def _shown(self, trace: Trace, rows: Rows, plant: Trace, places: Places) -> None:
        assert self.attack is not None
        self.shown = float(np.abs(rows["x_next"][-1]).max())
        for row in rows:
            place = places.of(*trace.where(row))
            if (row["k"] + 1 if place < 0 else place + self.begin) < self.attack["onset"]:
                continue
            if self.attack["at"] == "bus" and place >= 0:
                self.off[place] = np.abs(plant.rows["x_next"][place] - row["x_next"]).max()
            self.watched += bool(row["expected"] >= 0)
            self.unwatched += bool(row["expected"] < 0)

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
        off = self.off[~np.isnan(self.off)].tolist()
        at = place - self.begin
        away = float(self.off[at]) if alarm >= 0 and 0 <= at < len(self.off) else nan
        return {
            **self.attack,
            "failed": self.failed,
            "alarm_k": alarm,
            "delay": place - onset + 1 if alarm >= 0 else -1,
            "false_alarms": sum(at < onset for at, _ in alarms),
            "watched": self.watched,
            "unwatched": self.unwatched,
            "away_at_alarm": None if isnan(away) else away,
            "away": off[-1] if off else None,
            "shown": self.shown,
            "away_most": max(off, default=None),
            "unread": self.unread,
            "no_interval": {"options": GIVEN},
        }


def attacked(run: Run) -> AttackCounts:
    """Read it from a run's traces; one that is damaged, or not there, is named in ``unread``.

    The controller's is read where the plant's names an attack.
    """
    counts = AttackCounts()
    plant = run.so_far("plant", counts.unread)
    if plant is not None:
        counts.plant(plant, run.scenario)
    controller = None if counts.attack is None else run.so_far("controller", counts.unread)
    if plant is not None and controller is not None:
        counts.controller(controller, plant)
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
