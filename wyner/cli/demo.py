"""``wyner up --demo``: the whole story in five short runs on one screen.

The law `packed` at its limit, read by the tap as it is spoken; keys distilled beside a tap that
misses three messages of ten; the control, a tap that hears all; and a sensor
that is spoofed, under a key that is secret, and where no key can be secret.
"""

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from runtime.errors import DONE, FAILED, INTERRUPTED
from runtime.options import run_dir_of
from runtime.scenario_file import scenario_of
from wyner.cli.results import show
from wyner.cli.session import Outcome, run_session
from wyner.deployment.one_machine import RunOptions
from wyner.printout import Printout

SPOKEN: Final = "The paper calls this secret. Watch the tap before you believe."
PACE: Final = 5.0
"""Times the plant's clock: a minute in all, and slow enough to be read."""

ATTACKED_PACE: Final = 7.0

SLOWEST: Final = 8
"""What a pace is divided by at most. A run that showed nothing, for the machine was too busy, is
made again at half the pace, and those after it begin so."""

MOST_STEPS: Final = 2000
"""A run that did not come to its point by then ends all the same."""

ONSET: Final = 360
"""Step from which the sensor is spoofed: five seconds in, keys are there."""

SPOOFED: Final = 100
"""Steps of the attack."""

ENOUGH: Final = 20
"""Of them, what a key must have watched: who does not have the key guesses half of them wrong."""

ATTACKED_BY: Final = ("nearest-centre", "key-solver")
"""Who listens to the attacked runs: what the attack may use is what the key-solver holds, and those
who go on to read the message would take half of their processor time."""

LISTENED: Final = {"tap.eavesdroppers": ATTACKED_BY}
HEARS_ALL: Final = {"tap.loss": 0.0}

Verdict = tuple[str, bool | None]
"""A run's line, and whether the run came out as it must: None where it shows nothing."""


def _spoken(summary: dict[str, Any]) -> Verdict:
    """Every symbol is read."""
    had = [tap["solved_k"] for tap in summary["taps"].values() if tap["messages_exact"]]
    first = min((k for k in had if k >= 0), default=-1)
    if not summary["delivered"]:
        return f"1. Spoken:  not delivered: {_missed(summary)}.", None
    if not had:
        return "1. Spoken:  the tap has not got the message, and should have.", False
    line = (
        f"1. Spoken:  {summary['bits_per_second']:.1f} bit/s by the paper's rule, counted; "
        f"the plant has it at step {summary['delivered_k']}, the tap at {first}."
    )
    return line, True


def _keys(summary: dict[str, Any]) -> Verdict:
    """Keys are made, and the tap holds no bit of them."""
    keys = summary["keys"] or {}
    made, held = keys.get("made", 0), keys.get("held_by_tap_bits")
    if not made:
        return f"2. Keys:    none was made: {_missed(summary)}.", None
    line = f"2. Keys:    {made} keys made. A tap that loses 30 % holds {held} bits."
    return line, bool(held == 0)


def _control(summary: dict[str, Any]) -> Verdict:
    """Beside a tap that hears all nothing may be claimed of it, and no key comes out."""
    made = _made(summary)
    if made:
        return f"3. Compare: {made} keys beside a tap that hears all: that must not be.", False
    if not summary["delivered"]:
        return f"3. Compare: nothing is shown, for {_missed(summary)}.", None
    return "3. Compare: where the eavesdropper hears everything, no key is made.", True


def _caught(summary: dict[str, Any]) -> Verdict:
    """Eve does not have the key that chooses the input, and a ghost at the sensor is caught."""
    found = summary["attack"] or {}
    delay = found.get("delay", -1)
    line = "4. Attacked: a spoofed sensor is "
    if found.get("alarm_k", -1) >= 0:
        line += f"caught {delay} step{'' if delay == 1 else 's'} after its onset under a secret key"
        return line, not found.get("false_alarms")
    line += "NOT caught"
    if found.get("watched", 0) >= ENOUGH:
        return line, False
    return f"{line}, for no key was there in time ({_missed(summary)})", None


def _unseen(summary: dict[str, Any]) -> Verdict:
    """Where Eve hears all the claim is refuted, so that no key watches the sensor."""
    found = summary["attack"] or {}
    away, shown = found.get("away") or 0.0, found.get("shown") or 0.0
    if found.get("alarm_k", -1) >= 0:
        return ", and where Eve hears all as well: that must not be.", False
    if _made(summary):
        if not any(rate["refuted"] for rate in summary["keys"]["audited"].values()):
            return "; where Eve hears all keys were made: that must not be.", False
        # steps went by faster than the tap told what it hears
        return "; where Eve hears all keys were made before the claim was refuted.", None
    if found.get("unwatched", 0) < ENOUGH:
        return f"; where Eve hears all nothing is shown, for {_missed(summary)}.", None
    line = (
        ". Where Eve hears all, no key is made and nothing watches: the plant is "
        f"then {away:.0f} away while the screen shows {shown:.1f}."
    )
    return line, True


def _missed(summary: dict[str, Any]) -> str:
    """How many steps the machine missed, as a line says it."""
    return f"{summary['missed']} of {summary['steps']} steps missed"


def _made(summary: dict[str, Any]) -> int:
    """Keys that were distilled."""
    return int((summary["keys"] or {}).get("made", 0))


@dataclass(frozen=True)
class Act:
    """One of the runs.

    Parameters
    ----------
    name : str
        Its folder.
    title : str
        As the screen's first line begins.
    about : str
        What it is, for a line before it.
    scenario : str
        A shipped one.
    verdict : callable
        What the run shows, from its summary.
    changes : mapping, optional
        Of the scenario's fields.
    attacked : bool, optional
        Whether its sensor is spoofed.
    goes_on : bool, optional
        Whether its line goes on with that of the run before.
    """

    name: str
    title: str
    about: str
    scenario: str
    verdict: Callable[[dict[str, Any]], Verdict]
    changes: Mapping[str, Any] = field(default_factory=dict)
    attacked: bool = False
    goes_on: bool = False

    def told(self, lines: list[str], line: str) -> list[str]:
        """The verdict so far, with this run's line."""
        return [*lines[:-1], lines[-1] + line] if self.goes_on else [*lines, line]


ACTS: Final = (
    Act(
        "spoken",
        "1/5 spoken",
        "a message that the loop itself carries, a choice of four inputs a step, beside a "
        "tap that hears all",
        "packed",
        _spoken,
    ),
    Act("keys", "2/5 keys", "keys distilled from what a tap that loses 30 % misses", "keys", _keys),
    Act(
        "control",
        "3/5 comparison",
        "the same beside a tap that hears all: no key may come of it",
        "keys",
        _control,
        {**HEARS_ALL, "keys.eps_E": 0.0},
    ),
    Act(
        "caught",
        "4/5 attacked, secret key",
        "a spoofed sensor where Eve misses 30 %, under keys distilled from that",
        "watched",
        _caught,
        LISTENED,
        attacked=True,
    ),
    Act(
        "unseen",
        "5/5 attacked, no key",
        "the same where Eve hears all: the claim is refuted, and no key is made",
        "watched",
        _unseen,
        LISTENED | HEARS_ALL,
        attacked=True,
        goes_on=True,
    ),
)


def run_demo(args: argparse.Namespace) -> int:
    """Make each run and print the lines of verdict; 0 if each run came out as it must.

    Parameters
    ----------
    args : argparse.Namespace
        Of ``wyner up``: ``json`` and ``run_dir`` are used.
    """
    folder = run_dir_of(args.run_dir)
    lines: list[str] = []
    summaries: dict[str, Any] = {}
    good, slower = True, 1
    for act in ACTS:
        outcome, as_it_must, slower = _shown(act, args.json, folder / act.name, lines, slower)
        if outcome.left:
            lines.append(f"{act.title}: left before its end, so that nothing is shown by it.")
        else:
            lines = act.told(lines, act.verdict(outcome.figures)[0])
        summaries[act.name] = outcome.figures
        good = good and bool(as_it_must) and not outcome.left and not outcome.figures["failed"]
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.interrupted:
            return INTERRUPTED
        if outcome.left:
            break
    figures = {"verdict": lines, "as_it_must": good, "runs": summaries}
    show(Printout(figures, lines), args, indent=3)
    return DONE if good else FAILED


def _shown(
    act: Act, as_json: bool, folder: Path, lines: list[str], slower: int
) -> tuple[Outcome, bool | None, int]:
    """A run that showed something, or the slowest of those that did not; and its pace's divisor."""
    begins = "Controller, plant and tap start."
    while True:
        if not as_json:
            print(f"{act.title}: {act.about}. {begins}", file=sys.stderr, flush=True)
        with _scenario(act) as scenario:
            outcome = run_session(
                _options(act, scenario, folder, slower, as_json=as_json),
                epilogue=lambda summary: act.told(lines, act.verdict(summary)[0]),
                stays=act is ACTS[-1],
                title=act.title,
            )
        _, as_it_must = act.verdict(outcome.figures)
        ended = outcome.left or outcome.interrupted or outcome.failure is not None
        if as_it_must is not None or ended or slower == SLOWEST:
            return outcome, as_it_must, slower
        slower *= 2
        shutil.rmtree(folder)
        begins = f"Nothing was shown ({_missed(outcome.figures)}): once more, at half the pace."


def _options(act: Act, scenario: str, folder: Path, slower: int, *, as_json: bool) -> RunOptions:
    """What a run is asked to be."""
    return RunOptions(
        scenario=scenario,
        run_dir=str(folder),
        message=SPOKEN,
        pace=f"x{(ATTACKED_PACE if act.attacked else PACE) / slower:g}",
        steps=ONSET + SPOOFED if act.attacked else MOST_STEPS,
        until_delivered=not act.attacked,
        attack=f"ghost@{ONSET}" if act.attacked else None,
        json=as_json,
    )


@contextmanager
def _scenario(act: Act) -> Iterator[str]:
    """The shipped scenario, or a file of it with some fields changed, for as long as it runs."""
    from wyner.api import vary
    from wyner.fit.toml import as_toml

    if not act.changes:
        yield act.scenario
        return
    changed = vary(scenario_of(act.scenario), act.changes)
    tables = json.loads(changed.model_dump_json(exclude_none=True, exclude_unset=True))
    with tempfile.TemporaryDirectory() as where:
        path = Path(where) / f"{act.name}.toml"
        path.write_text(as_toml(tables), encoding="utf-8")
        yield str(path)
