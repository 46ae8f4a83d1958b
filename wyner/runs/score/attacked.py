"""What an attack came to: onset, alarm, and how far the plant was from what was shown."""

from typing import Any, Final

import numpy as np

from protocol.arrays import Array
from protocol.link.events import Alarm, AttackBegan
from protocol.statistics import GIVEN
from wyner.runs.lines import AttackLine
from wyner.runs.run import Run
from wyner.runs.score.counts import truth_of
from wyner.runs.trace import Places, Trace

NO_INTERVAL: Final = {"no_interval": {"options": GIVEN}}


def attacked(run: Run) -> dict[str, Any] | None:
    """What an attack came to; None where nobody attacked, as far as the plant's trace tells.

    ``failed`` says why the attack itself was over before the run. ``alarm_k`` is the first alarm
    from the onset on, -1 none; ``delay`` the steps from the last true reading to it.
    ``false_alarms`` came before. ``watched`` counts the transitions from the onset on that a key's
    digit was asked of, ``unwatched`` the others. ``away_at_alarm``, ``away``, ``away_most``: the
    distance between true and reported state, the largest of their components, at the alarm, at
    the end, at most (None: not known); ``shown``: the largest component of the last state that the
    controller was shown. ``unread`` names the traces of which a part cannot be read, or that are
    not there: what stands there is not in these figures.
    """
    unread: list[str] = []
    plant = run.so_far("plant", unread)
    attack = None if plant is None else plant.attack
    if plant is None or attack is None:
        return None
    controller = run.so_far("controller", unread)
    places = Places(plant)
    # A place is a step's among those of all sessions: in the first it is the step itself.
    begin = 1 + int(plant.steps["k"][0]) if len(plant.steps) else 1
    off = _off(plant, attack, begin, run)
    alarms: list[tuple[int, int]] = []  # place and step of the readings
    watched, since, shown = 0, 0, None
    if controller is not None:
        for told in controller.told("alarm"):
            line = told.line
            assert isinstance(line, Alarm)
            at = places.of(line.session, line.k)
            alarms.append((line.k + 1 if at < 0 else at + begin, line.k + 1))
        rows = controller.steps
        known = np.array([places.session(name) for name in controller.sessions], np.int64)
        found = places.all_of(known[rows["session"]], rows["k"].astype(np.int64))
        later = np.where(found < 0, rows["k"] + 1, found + begin) >= attack.onset
        since, watched = int(later.sum()), int((rows["expected"][later] >= 0).sum())
        if len(rows):
            shown = float(np.abs(rows["x_next"][-1]).max())
        if attack.at == "bus":
            both = later & (found >= 0)
            sent = plant.steps["x_next"][found[both]]
            off[found[both]] = np.abs(sent - rows["x_next"][both]).max(axis=1)
    place, alarm = next((one for one in sorted(alarms) if one[0] >= attack.onset), (-1, -1))
    away = off[~np.isnan(off)].tolist()
    at_alarm = off[place - begin : place - begin + 1] if place >= begin else off[:0]
    return {
        **attack._asdict(),
        "knows": list(attack.knows),
        "failed": plant.failed,
        "alarm_k": alarm,
        "delay": place - attack.onset + 1 if alarm >= 0 else -1,
        "false_alarms": sum(at < attack.onset for at, _ in alarms),
        "watched": watched,
        "unwatched": since - watched,
        "away_at_alarm": next((v for v in at_alarm.tolist() if not np.isnan(v)), None),
        "away": away[-1] if away else None,
        "shown": shown,
        "away_most": max(away, default=None),
        "unread": unread,
        **NO_INTERVAL,
    }


def _off(plant: Trace, attack: AttackLine, begin: int, run: Run) -> Array:
    """The distance at the end of each step of the plant, not a number where it is not known."""
    rows, observer = plant.steps, run.scenario.observer
    true = truth_of(rows)
    if true is None:
        return np.full(len(rows), np.nan)
    read = true if observer is None else true @ np.array(observer.C).T
    off: Array = np.abs(read - rows["x_next"]).max(axis=1)
    off[: max(0, attack.onset - begin)] = np.nan
    return off


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
