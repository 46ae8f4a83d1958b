"""Does an answer take longer when it carries a message symbol? ``python -m benchmarks.timing``.

A tap sees when messages pass. So the time from a message's arrival at either end to its answer on
the way, journal included, must not depend on the automaton's state. Both ends run as the services
open them. What each hears and draws is recorded once; then each lives it again alone, since in one
process what the partner did just before would be in the caches. The two states' times are compared
within blocks of a few milliseconds, and the same is measured again with a wait of one microsecond
added in one state: a test that does not see that has no power, and says so. :mod:`benchmarks.work`
counts the bytecodes up to the answer instead, which no other program disturbs.

``--run DIR`` takes the times of a run's capture instead: what a tap saw on the bus.
"""

import argparse
import hashlib
import json
import math
import multiprocessing
import os
import secrets
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from unittest.mock import patch

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.link.events import lines
from protocol.messages import FIELD, ControllerHello, Measurement, Offer, PlantHello

if TYPE_CHECKING:
    from controller_service.core import ControllerCore
    from plant_service.core import PlantCore
    from protocol.link.events import Event
    from protocol.link.peer import Actions, Notice, Peer
    from protocol.messages import Message, Status
    from protocol.secret.tasks import Done, Task
    from runtime.ports import Files

SIDES: Final = ("controller", "plant")
HEARS: "Final[dict[str, tuple[type[Message], ...]]]" = {
    "controller": (Measurement, PlantHello),
    "plant": (Offer, ControllerHello),
}

TWO_STATES: Final = ('"pipelined"', '"switched"')
"""A scenario that agrees on every key would stay in state 2 for ever."""

BLOCK: Final = 40
"""Answers that are compared with one another."""

FEWEST: Final = 4
"""Answers of each state that a block needs."""

TRIM: Final = 0.2
"""Share of the blocks that is left out at each end: a scheduler's, and not the program's."""

SURE: Final = 3.29
"""Standard errors beyond which a difference is one, at one in a thousand."""

CONTROL_NS: Final = 1000
"""What the control adds where a message symbol is carried."""

WARM_UP: Final = 0.1
"""Share of the steps that is not looked at."""


class Difference(NamedTuple):
    """How much longer an answer takes that carries a message symbol, and its standard error."""

    ns: float
    error_ns: float

    @property
    def seen(self) -> bool:
        """Whether it is more than chance."""
        return abs(self.ns) > SURE * self.error_ns

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return {"ns": self.ns, "error_ns": self.error_ns, "seen": self.seen}


Answers = list[tuple[bool, float]]
"""Of each answer, in order: whether a message symbol is carried, and its nanoseconds."""


def difference(answers: Answers) -> Difference:
    """How much longer an answer takes that carries: the trimmed mean over blocks of answers.

    Of each block it is the difference of the two states' medians. Whatever else runs on a machine
    changes from second to second, and within a block of some milliseconds both states have the
    same of it. The standard error is the trimmed mean's (Yuen, Biometrika 61, 1974).

    Raises
    ------
    ValueError
        When fewer than ten blocks have both states.
    """
    found = []
    for at in range(0, len(answers), BLOCK):
        block = answers[at : at + BLOCK]
        two = [[ns for carries, ns in block if carries == state] for state in (False, True)]
        if min(map(len, two)) >= FEWEST:
            found.append(median(two[1]) - median(two[0]))
    n, cut = len(found), int(TRIM * len(found))
    if n < 10:
        raise ValueError(f"expected ten blocks of {BLOCK} answers at least, got {n}")
    values = np.sort(np.asarray(found, dtype=float))
    inner = values[cut : n - cut]
    winsorised = np.clip(values, inner[0], inner[-1])
    h = len(inner)
    error = math.sqrt(float(winsorised.var(ddof=1)) * (n - 1) / (h * (h - 1)))
    return Difference(float(inner.mean()), error)


class TimingPorts:
    """An end's ports; notes when a field message leaves, and what all of them say."""

    def __init__(self, files: "Files") -> None:
        self.files = files
        self.key_maker = None if files.key_maker is None else files.key_maker.open()
        self.left_ns = 0
        self.mail: list[tuple[type[Message], bytes]] = []
        self.kept: list[Done] = []
        self.said = hashlib.sha256()

    def save(self, actions: "Actions") -> None:
        """Keep it in the journal."""
        self.files.journal.save(actions)

    def publish(self, message: "Message") -> None:
        """Leave it for the partner."""
        kind, payload = type(message), message.wire()
        if kind in FIELD:
            self.left_ns = time.perf_counter_ns()
            self.said.update(payload)
        self.mail.append((kind, payload))

    def submit_key_task(self, task: "Task") -> None:
        """Make and store keys, which the services leave to a process of its own."""
        from runtime.keys.key_maker import work

        assert self.key_maker is not None
        self.kept.append(work(self.key_maker, task))

    def trace(self, event: "Event") -> None:
        """Write it to the trace."""
        self.files.trace.write(*lines(event))

    def log_notice(self, notice: "Notice") -> None:
        """Nobody reads the log."""

    def health(self, status: "Status") -> None:
        """Nobody asks for the health."""


class TimedOffer(NamedTuple):
    """What an end was given at a time: a message, or nothing where it was only woken."""

    now: float
    kind: "type[Message] | None" = None
    payload: bytes = b""


@dataclass(slots=True)
class Life:
    """All that one end's doings depend on: what it heard, and what it drew; and what it said."""

    began: float
    heard: list[TimedOffer] = field(default_factory=list)
    drawn: list[bytes] = field(default_factory=list)
    said: bytes = b""


class LivingEnd:
    """One end as the services open it; ``life`` grows with it, or is lived again."""

    def __init__(self, side: str, scenario: str, folder: Path, life: Life, *, again: bool) -> None:
        from runtime.perform import perform

        self.life = life
        self._again = iter(life.drawn) if again else None
        self._perform = perform
        with self._drawing():
            self.endpoint, files, end = open_end(side, scenario, folder, life.began)
            self.end: ControllerCore | PlantCore = end
            self.ports = TimingPorts(files)
            perform(self.endpoint.start(life.began), self.endpoint, self.ports)

    @contextmanager
    def _drawing(self) -> Iterator[None]:
        """This end's draws, those of its first life where it lives again; they cost the same."""
        system, kept, again = os.urandom, self.life.drawn, self._again

        def urandom(count: int, /) -> bytes:
            drawn = system(count)
            if again is not None:
                return next(again)
            kept.append(drawn)
            return drawn

        with patch.object(os, "urandom", urandom), patch.object(secrets, "token_bytes", urandom):
            yield

    @property
    def carries(self) -> bool:
        """Whether the step under way carries a message symbol."""
        return self.end.rules.scheme.pad(self.end.record.state) != NO_SYMBOL

    def take(self, heard: TimedOffer, added_ns: int = 0) -> int:
        """Do what is to be done; nanoseconds to the answer on the field bus, 0 where none came."""
        endpoint, ports = self.endpoint, self.ports
        with self._drawing():
            if heard.kind is None:
                self._perform(endpoint.wake(heard.now), endpoint, ports)
                return 0
            carries, ports.left_ns = self.carries, 0
            began = time.perf_counter_ns()
            if added_ns and carries:
                while time.perf_counter_ns() < began + added_ns:
                    pass
            actions = endpoint.receive(heard.kind, heard.payload, heard.now)
            self._perform(actions._replace(finish_step=False), endpoint, ports)
            answered = ports.left_ns - began if heard.kind in FIELD and ports.left_ns else 0
            if actions.finish_step:
                self._perform(endpoint.finish_step(), endpoint, ports)
            while ports.kept:
                self._perform(endpoint.key_task_done(ports.kept.pop(0), heard.now), endpoint, ports)
        return answered

    def close(self) -> None:
        """Close its files."""
        self.ports.files.close()
        if self.ports.key_maker is not None:
            self.ports.key_maker.store.close()


def open_end(
    side: str, name: str, folder: Path, now: float
) -> "tuple[Peer, Files, ControllerCore] | tuple[Peer, Files, PlantCore]":
    """An end of the scenario's link as the services open it."""
    from controller_service import service as controllers
    from controller_service.laws.registry import cached_design, make_law
    from plant_service import service as plants
    from protocol.scenario import parse_scenario
    from runtime.chance import noise
    from runtime.pace import Pace
    from runtime.shipped import SCENARIOS

    text = (SCENARIOS / f"{name}.toml").read_text().replace(*TWO_STATES)
    scenario = parse_scenario(tomllib.loads(text), name)
    numbers = count(1 if side == "plant" else 2**60)
    ids: dict[str, Any] = {"new_id": lambda: f"{next(numbers):016x}"}
    winds: dict[str, Any] = {"noise": lambda _seed, width: noise(1, width)}
    with patch.multiple(controllers, **ids), patch.multiple(plants, **ids, **winds):
        if side == "controller":
            law = make_law(scenario, cached_design(scenario))
            config = controllers.ControllerConfig(scenario, folder, "loop", law, b"x" * 60_000)
            controller, files = controllers.open_controller(config)
            return controller, files, controller
        fast = plants.PlantConfig(scenario, folder, "loop", Pace("fast"))
        plant, files = plants.open_plant(fast, now)
        return plant, files, plant


def recorded(steps: int, scenario: str, folder: Path) -> dict[str, Life]:
    """Both ends in lock-step, side by side: what each of them heard and drew."""
    lives = {side: Life(time.monotonic()) for side in SIDES}
    ends = {side: LivingEnd(side, scenario, folder, lives[side], again=False) for side in SIDES}
    while ends["plant"].end.record.k < steps:
        for side, other in zip(SIDES, reversed(SIDES), strict=True):
            end, now = ends[side], time.monotonic()
            mail, ends[other].ports.mail = ends[other].ports.mail, []
            heard = [TimedOffer(now)] if end.endpoint.wake_at() <= now else []
            for one in (*heard, *(TimedOffer(now, *m) for m in mail if m[0] in HEARS[side])):
                lives[side].heard.append(one)
                end.take(one)
    for side, end in ends.items():
        lives[side].said = end.ports.said.digest()
        end.close()
    return lives


def response_times(side: str, scenario: str, life: Life, added_ns: int = 0) -> Answers:
    """Nanoseconds of each answer of an end that lives ``life`` again, alone in this process.

    Its partner cannot slow it, and what is drawn and heard is the same each time. ``added_ns`` is
    waited, by the clock, before an answer that belongs to a carried symbol.

    Raises
    ------
    RuntimeError
        When it did not say the same again.
    """
    times: Answers = []
    with tempfile.TemporaryDirectory() as folder:
        end = LivingEnd(side, scenario, Path(folder), life, again=True)
        for number, heard in enumerate(life.heard):
            carries = end.carries
            answered = end.take(heard, added_ns)
            end.ports.mail.clear()
            if answered and number > WARM_UP * len(life.heard):
                times.append((carries, answered))
        end.close()
    if end.ports.said.digest() != life.said:
        raise RuntimeError(f"the {side} did not say the same again")
    return times


def bus_times(run_dir: Path) -> dict[str, Answers]:
    """Nanoseconds of each answer of both ends, as the tap of a run saw them on the bus.

    Both times are the senders' own, which every message has.

    Raises
    ------
    RunError
        When the folder holds no run with a capture and the controller's trace.
    """
    from wyner.runs.run import Run

    run = Run.load(run_dir)
    roles: dict[int, bool] = {}

    def note(event: dict[str, Any]) -> None:
        if event["event"] == "transition":
            roles[event["k"]] = event["role"] == "message"

    run.feed("controller", note)
    asked: dict[int, int] = {}
    offered: dict[int, int] = {}
    for t_ns, message in run.capture().records():
        if isinstance(message, Measurement):
            asked.setdefault(message.k, t_ns)
        elif isinstance(message, Offer):
            offered.setdefault(message.k, t_ns)
    steps = [k for k in sorted(roles) if k in offered]
    return {
        "controller": [(roles[k], offered[k] - asked[k]) for k in steps if k in asked],
        "plant": [(roles[k], asked[k + 1] - offered[k]) for k in steps if k + 1 in asked],
    }


def measure(steps: int = 100_000, scenario: str = "sustained") -> dict[str, Any]:
    """Both ends' difference between the states, and the same with the control.

    Returns
    -------
    dict
        For each side: ``plain`` and ``control`` (:class:`Difference`), ``median_us``, ``answers``,
        and ``powered``: whether the control's microsecond was seen.
    """
    with tempfile.TemporaryDirectory() as folder:
        lives = recorded(steps, scenario, Path(folder))
    told: dict[str, Any] = {"scenario": scenario, "steps": steps, "block": BLOCK, "trim": TRIM}
    for side in SIDES:
        plain = response_times(side, scenario, lives[side])
        control = response_times(side, scenario, lives[side], CONTROL_NS)
        found, checked = difference(plain), difference(control)
        told[side] = {
            "plain": found.as_json(),
            "control": checked.as_json(),
            "powered": checked.seen and checked.ns > 0,
            "median_us": median(ns for _, ns in plain) / 1e3,
            "answers": [sum(carries == state for carries, _ in plain) for state in (False, True)],
        }
    return told


def render(told: dict[str, Any]) -> str:
    """For people."""
    lines = [f"{told['scenario']}, {told['steps']} steps"]
    for side in SIDES:
        r = told[side]
        p, c = r["plain"], r["control"]
        verdict = "a difference" if p["seen"] else "no difference seen"
        power = "saw" if r["powered"] else "DID NOT SEE"
        lines.append(
            f"{side}: median {r['median_us']:.1f} us; carrying takes {p['ns']:+.0f} ns longer "
            f"(standard error {p['error_ns']:.0f}): {verdict}; the control {power} its microsecond "
            f"({c['ns']:+.0f} ns, standard error {c['error_ns']:.0f})"
        )
    return "\n".join(lines)


def _on_the_bus(run_dir: Path, *, as_json: bool) -> int:
    found = {side: difference(answers) for side, answers in bus_times(run_dir).items()}
    if as_json:
        print(json.dumps({side: one.as_json() for side, one in found.items()}))
        return 0
    for side, one in found.items():
        verdict = "a difference" if one.seen else "no difference seen"
        print(f"{side}: carrying takes {one.ns:+.0f} ns longer (se {one.error_ns:.0f}): {verdict}")
    return 0


def _spin() -> None:
    while True:
        pass


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """So many other programs that never rest, for as long as it takes."""
    others = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(count)]
    for other in others:
        other.start()
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.join()


def main(argv: list[str] | None = None) -> int:
    """Measure; 1 when a difference was seen, 2 when the test had no power."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--scenario", default="sustained", help="shipped; `keys` makes keys")
    parser.add_argument("--busy", action="store_true", help="beside a busy program on each core")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--run", type=Path, metavar="DIR", help="a run with a tap: times on its bus"
    )
    args = parser.parse_args(argv)
    if args.run is not None:
        return _on_the_bus(args.run, as_json=args.json)
    with _busy((os.cpu_count() or 1) if args.busy else 0):
        told = measure(args.steps, args.scenario)
    print(json.dumps(told) if args.json else render(told))
    sides = [told[side] for side in SIDES]
    if any(side["plain"]["seen"] for side in sides):
        return 1
    return 0 if all(side["powered"] for side in sides) else 2


if __name__ == "__main__":
    sys.exit(main())
