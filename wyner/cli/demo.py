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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from runtime.errors import DONE, FAILED, INTERRUPTED
from runtime.options import run_dir_of
from runtime.scenario_file import scenario_of
from wyner.cli.results import show
from wyner.cli.session import Outcome, run_session
from wyner.deployment.one_machine import RunOptions

SPOKEN: Final = "The paper calls this secret. Watch the tap before you believe."
PACE: Final = 5.0
"""Times the plant's clock: a minute in all, and slow enough to be read."""

ATTACKED_PACE: Final = 7.0

SLOWEST: Final = 8
"""What a pace is divided by at most. A run that showed nothing, as a busy machine missed its steps,
is made again at half the pace, and those after it begin so."""

TITLES: Final = {
    "spoken": "1/5 spoken",
    "keys": "2/5 keys",
    "control": "3/5 comparison",
    "caught": "4/5 attacked, secret key",
    "unseen": "5/5 attacked, no key",
}
ABOUT: Final = {
    "spoken": "a message that the loop itself carries, a choice of four inputs a step, beside a "
    "tap that hears all",
    "keys": "keys distilled from what a tap that loses 30 % misses",
    "control": "the same beside a tap that hears all: no key may come of it",
    "caught": "a spoofed sensor where Eve misses 30 %, under keys distilled from that",
    "unseen": "the same where Eve hears all: the claim is refuted, and no key is made",
}
"""What each run is, as the screen's first line begins and as a line says before it."""

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


def run_demo(args: argparse.Namespace) -> int:
    """Make each run and print the lines of verdict; 0 if each run came out as it must.

    Parameters
    ----------
    args : argparse.Namespace
        Of ``wyner up``: ``json`` and ``run_dir`` are used.
    """
    told = _acts(args)
    if told.interrupted:
        return INTERRUPTED
    show(told, args, indent=3)
    return DONE if told.good else FAILED


@dataclass
class _Outcome:
    """What the acts came to, so far."""

    lines: list[str] = field(default_factory=list)
    summaries: dict[str, Any] = field(default_factory=dict)
    good: bool = True
    interrupted: bool = False
    slower: int = 1

    def to_json(self) -> dict[str, Any]:
        """The verdict, whether every run came out as it must, and each run's summary."""
        return {"verdict": self.lines, "as_it_must": self.good, "runs": self.summaries}

    def __str__(self) -> str:
        """A line of verdict for each run."""
        return "\n".join(self.lines)


def _acts(args: argparse.Namespace) -> _Outcome:
    """The runs, one after the other; what was left or interrupted is the last."""
    folder = run_dir_of(args.run_dir)
    told = _Outcome()
    acts: tuple[tuple[str, Callable[..., Act]], ...] = (
        ("spoken", _spoken),
        ("keys", _keys),
        ("control", _control),
        ("caught", _caught),
        ("unseen", _unseen),
    )
    for name, act in acts:
        outcome, line, as_it_must = _shown(act, args, folder / name, told)
        if outcome.left:
            line = f"{TITLES[name]}: left before its end, so that nothing is shown by it."
        if name == "unseen" and not outcome.left:
            told.lines.pop()  # its line is one with that of the run before
        told.lines.append(line)
        told.summaries[name] = outcome.summary
        failed = bool(outcome.summary["failed"])
        told.good = told.good and bool(as_it_must) and not outcome.left and not failed
        if outcome.failure is not None:
            raise outcome.failure
        told.interrupted = outcome.interrupted
        if outcome.left or outcome.interrupted:
            break
    return told


def _shown(
    act: "Callable[..., Act]",
    args: argparse.Namespace,
    folder: Path,
    told: _Outcome,
) -> "Act":
    """A run that showed something, or the slowest of those that did not."""
    name = folder.name
    begins = "Controller, plant and tap start."
    while True:
        if not args.json:
            print(f"{TITLES[name]}: {ABOUT[name]}. {begins}", file=sys.stderr, flush=True)
        outcome, line, as_it_must = act(args, folder, told)
        ended = outcome.left or outcome.interrupted or outcome.failure is not None
        if as_it_must is not None or ended or told.slower == SLOWEST:
            return outcome, line, as_it_must
        if not outcome.summary["missed"]:  # it was not the machine
            return outcome, line, as_it_must
        told.slower *= 2
        shutil.rmtree(folder)
        begins = f"{_missed(outcome.summary)}: once more, at half the pace."


def _options(args: argparse.Namespace, scenario: str, folder: Path, slower: int) -> RunOptions:
    """What one of the runs is asked to be."""
    return RunOptions(
        scenario=scenario,
        run_dir=str(folder),
        message=SPOKEN,
        pace=f"x{PACE / slower:g}",
        steps=MOST_STEPS,
        until_delivered=True,
        json=args.json,
    )


Act = tuple[Outcome, str, bool | None]
"""A run, its line, and whether it came out as it must: None where it shows nothing."""


def _spoken(args: argparse.Namespace, folder: Path, told: _Outcome) -> Act:
    """The packed law with the pipelined scheme: a symbol a step, and every one of them read."""
    options = _options(args, "packed", folder, told.slower)
    outcome = run_session(options, stays=False, title=TITLES["spoken"])
    summary = outcome.summary
    had = [tap["solved_k"] for tap in summary["taps"].values() if tap["messages_exact"]]
    first = min((k for k in had if k >= 0), default=-1)
    if not summary["delivered"]:
        line = f"1. Spoken:  not delivered: {_missed(summary)}."
        return outcome, line, None
    line = (
        f"1. Spoken:  {summary['bits_per_second']:.1f} bit/s by the paper's rule, counted; "
        f"the plant has it at step {summary['delivered_k']}, the tap at {first}."
        if had
        else "1. Spoken:  the tap has not got the message, and should have."
    )
    return outcome, line, bool(had)


def _keys(args: argparse.Namespace, folder: Path, told: _Outcome) -> Act:
    """Keys from what the tap misses."""
    options = _options(args, "keys", folder, told.slower)
    outcome = run_session(options, stays=False, title=TITLES["keys"])
    keys = outcome.summary["keys"] or {}
    made, held = keys.get("made", 0), keys.get("held_by_tap_bits")
    if not made:
        return outcome, f"2. Keys:    none was made: {_missed(outcome.summary)}.", None
    line = f"2. Keys:    {made} keys made. A tap that loses 30 % holds {held} bits."
    return outcome, line, bool(held == 0)


def _control(args: argparse.Namespace, folder: Path, told: _Outcome) -> Act:
    """The same with a tap that hears all: nothing may be claimed of it, and no key comes out."""
    changes = {**HEARS_ALL, "keys.eps_E": 0.0}
    with _scenario("wired-tap", "keys", changes) as scenario:
        options = _options(args, scenario, folder, told.slower)
        outcome = run_session(options, stays=False, title=TITLES["control"])
    summary = outcome.summary
    made = (summary["keys"] or {}).get("made", 0)
    if made:
        line = f"3. Compare: {made} keys beside a tap that hears all: that must not be."
        return outcome, line, False
    if not summary["delivered"]:
        return outcome, f"3. Compare: nothing is shown, for {_missed(summary)}.", None
    line = "3. Compare: where the eavesdropper hears everything, no key is made."
    return outcome, line, True


def _caught(args: argparse.Namespace, folder: Path, told: _Outcome) -> Act:
    """A ghost at the sensor; Eve does not have the key that chooses the input."""
    with _scenario("secret-key", "watched", LISTENED) as scenario:
        options = _attacked(args, scenario, folder, told.slower)
        outcome = run_session(options, stays=False, title=TITLES["caught"])
    found = outcome.summary["attack"] or {}
    delay, caught = found.get("delay", -1), found.get("alarm_k", -1) >= 0
    steps = f"{delay} step{'' if delay == 1 else 's'}"
    line = "4. Attacked: a spoofed sensor is "
    if caught:
        line += f"caught {steps} after its onset under a secret key"
        return outcome, line, not found.get("false_alarms")
    line += "NOT caught"
    if found.get("watched", 0) >= ENOUGH:
        return outcome, line, False
    return outcome, f"{line}, for no key was there in time ({_missed(outcome.summary)})", None


def _unseen(args: argparse.Namespace, folder: Path, told: _Outcome) -> Act:
    """The same where Eve hears all: the claim is refuted, so that no key watches the sensor."""
    before = tuple(told.lines)

    def line_of(summary: dict[str, Any]) -> str:
        found = summary["attack"] or {}
        away, shown = found.get("away") or 0.0, found.get("shown") or 0.0
        if found.get("alarm_k", -1) >= 0:
            return f"{before[-1]}, and where Eve hears all as well: that must not be."
        if (summary["keys"] or {}).get("made", 0):
            return f"{before[-1]}; where Eve hears all keys were made: that must not be."
        if found.get("unwatched", 0) < ENOUGH:
            return f"{before[-1]}; where Eve hears all nothing is shown, for {_missed(summary)}."
        return (
            f"{before[-1]}. Where Eve hears all, no key is made and nothing watches: the plant is "
            f"then {away:.0f} away while the screen shows {shown:.1f}."
        )

    with _scenario("false-claim", "watched", LISTENED | HEARS_ALL) as scenario:
        outcome = run_session(
            _attacked(args, scenario, folder, told.slower),
            epilogue=lambda summary: [*before[:-1], line_of(summary)],
            title=TITLES["unseen"],
        )
    found = outcome.summary["attack"] or {}
    unseen = found.get("alarm_k", 0) < 0 and not (outcome.summary["keys"] or {}).get("made", 0)
    shown = found.get("unwatched", 0) >= ENOUGH or not unseen
    return outcome, line_of(outcome.summary), unseen if shown else None


def _missed(summary: dict[str, Any]) -> str:
    """How many steps the machine missed, as a line says it."""
    return f"{summary['missed']} of {summary['steps']} steps missed"


def _attacked(args: argparse.Namespace, scenario: str, folder: Path, slower: int) -> RunOptions:
    """What a run is asked to be whose sensor is spoofed."""
    options = _options(args, scenario, folder, slower)
    return replace(
        options,
        attack=f"ghost@{ONSET}",
        steps=ONSET + SPOOFED,
        pace=f"x{ATTACKED_PACE / slower:g}",
        until_delivered=False,
    )


@contextmanager
def _scenario(name: str, shipped: str, changes: Mapping[str, Any]) -> Iterator[str]:
    """A file of a shipped scenario with some fields changed, for as long as a run needs it."""
    from wyner.api import vary
    from wyner.fit.toml import as_toml

    changed = vary(scenario_of(shipped), changes)
    tables = json.loads(changed.model_dump_json(exclude_none=True, exclude_unset=True))
    with tempfile.TemporaryDirectory() as where:
        path = Path(where) / f"{name}.toml"
        path.write_text(as_toml(tables), encoding="utf-8")
        yield str(path)
