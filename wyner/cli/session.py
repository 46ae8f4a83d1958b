"""One run of controller, plant and tap on this machine, watched, stopped and summed up."""

import json
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from protocol.messages import ControllerStatus, PlantStatus, StopKeys, TapStatus
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.errors import Failure, UsageError
from runtime.options import (
    message_of,
    pace_of,
    run_dir_of,
)
from runtime.run_folder import (
    CAPTURE,
    CONTROLLER_JOURNAL,
    MANIFEST,
    PLANT_JOURNAL,
)
from runtime.scenario_file import attack_option, scenario_in
from wyner.deployment.one_machine import RunOptions, lay_out, text_of
from wyner.printout import Printout

if TYPE_CHECKING:
    from protocol.link.events import AttackBegan
    from protocol.scenario import Scenario
    from wyner.deployment.supervisor import Supervisor

DEFAULT_MESSAGE: Final = "The paper calls this secret. Watch the tap before you believe."

SAID_S: Final = 120.0
"""Seconds within which plant and controller have to say something: opening one may take a while."""

GRACE_S: Final = 0.5
"""Seconds that the tap has for its last thoughts once the message has arrived."""


@dataclass(frozen=True, eq=False)
class Outcome(Printout):
    """What a run came to, its summary, and how it ended.

    Parameters
    ----------
    scenario : Scenario
    failure : Failure or None
    interrupted : bool
    left : bool
        Whether the screen was left before the run had come to its end.
    """

    scenario: "Scenario"
    failure: Failure | None
    interrupted: bool
    left: bool


def run_session(
    options: RunOptions,
    epilogue: Callable[[dict[str, Any]], Sequence[str]] | None = None,
    *,
    stays: bool = True,
    title: str = "",
) -> Outcome:
    """Run the three services, watch them, stop them and sum up.

    Parameters
    ----------
    options : RunOptions
    epilogue : callable, optional
        Lines for the last screen, from the summary; the verdict's if not given.
    stays : bool, optional
        Whether a last screen stays until a key is pressed.
    title : str, optional
        What the screen's first line begins with.
    """
    from runtime.zenoh_bus import ZenohBus
    from wyner.dashboard.app import STOPPING, Ending, has_screen, run_dashboard
    from wyner.dashboard.headless import run_headless
    from wyner.dashboard.source import BusSource
    from wyner.deployment.running import announced
    from wyner.runs.run import Run
    from wyner.runs.score.summary import render, summarise, verdict_lines
    from wyner.runs.seal import seal

    _take_signals()
    pace_of(options.pace)
    scenario = scenario_in(text_of(options), options.scenario)
    _check_steps(options.steps, scenario)
    payload = message_of(options.message) or DEFAULT_MESSAGE.encode()
    _design(scenario)
    eavesdroppers = eavesdroppers_of(options, scenario)
    attack = _attack(options, scenario)
    run_dir = run_dir_of(options.run_dir)
    traces_of_a_run = (MANIFEST, CONTROLLER_JOURNAL, PLANT_JOURNAL, CAPTURE)
    if any((run_dir / path).exists() for path in traces_of_a_run):
        raise UsageError(f"--run-dir: {run_dir}: has a run already, expected a new folder")
    try:
        supervisor, loop = lay_out(options, scenario, eavesdroppers, run_dir, payload, attack)
    except OSError as error:
        raise UsageError(f"--run-dir: {run_dir}: cannot be written: {error.strerror}") from None
    summary: dict[str, Any] = {}
    note = ExitStack()

    def conclude() -> Sequence[str]:
        """Stop the services and sum up: once, and the tap's last thoughts are part of it."""
        if not summary:
            note.close()  # the last screen may stay for long; there is nothing left to join
            supervisor.stop()
            summary.update(summarise(Run.load(run_dir), payload))
        return (epilogue or verdict_lines)(summary)

    watching = Progress(until_delivered=options.until_delivered, supervisor=supervisor)
    screen = not options.json and has_screen()
    failure: Failure | None = None
    ending = Ending.FINISHED
    management_ends = [loop.plant_management, loop.controller_management]
    try:
        supervisor.start()
        note.enter_context(announced(loop))
        with (
            ZenohBus(connect=management_ends) as management,
            ZenohBus(connect=[loop.adversary]) as adversary_bus,
        ):
            management.subscribe(key_of(PlantStatus, DEFAULT_LOOP), watching.plant_said)
            management.subscribe(key_of(ControllerStatus, DEFAULT_LOOP), watching.controller_said)
            watching.stop_keys = management.publisher(key_of(StopKeys, DEFAULT_LOOP)).put
            adversary_bus.subscribe(key_of(TapStatus, DEFAULT_LOOP), watching.tap_said)
            source = BusSource(management, adversary_bus, DEFAULT_LOOP)
            if screen:
                ending = run_dashboard(
                    source,
                    until=watching.over,
                    story=options.story,
                    conclude=conclude if stays else None,
                    title=title,
                )
            else:
                out = sys.stderr if options.json else sys.stdout
                ending = run_headless(source, until=watching.over, out=out, story=options.story)
    except Failure as error:
        failure = error
    except KeyboardInterrupt:
        ending = Ending.INTERRUPTED
    finally:
        if not summary:
            print(f"wyner: {STOPPING}", file=sys.stderr, flush=True)
        conclude()
    try:
        seal(run_dir, json.dumps(summary, indent=2).encode() + b"\n")
    except OSError as error:
        why = f"{error.filename or run_dir}: {error.strerror}"
        failure = failure or Failure(f"{why}: the run was not sealed")
    interrupted, left = ending is Ending.INTERRUPTED, ending is Ending.QUIT
    lines = render(summary).split("\n")
    return Outcome(summary, lines, scenario, failure, interrupted, left)


def _take_signals() -> None:
    """Let SIGINT and SIGTERM both end the run with its summary.

    A shell starts what it puts in the background with SIGINT ignored; here it is taken back.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


def _check_steps(steps: int | None, scenario: "Scenario") -> None:
    """A run that ends before its first key would end before anything that it is about."""
    if steps is None or scenario.keys is None or not scenario.digits:
        return
    schedule = scenario.keys.schedule()
    assert schedule is not None, "a scenario that takes digits makes keys"
    if steps <= schedule.first_use:
        raise UsageError(
            f"--steps: got {steps}, expected more than {schedule.first_use}: under this claim no "
            "step before has a key"
        )


def _design(scenario: "Scenario") -> None:
    """Compute the design before anything starts, and check that the plant starts inside it."""
    from controller_service.command import designed

    try:
        designed(scenario).index(scenario.initial_state)
    except LookupError as error:
        raise UsageError(
            f"plant.initial_state: {error}; start nearer to the origin, or enlarge control.horizon"
        ) from None


def eavesdroppers_of(options: RunOptions, scenario: "Scenario") -> tuple[str, ...]:
    """The scenario's eavesdroppers, and those asked for besides: true is what the best one leaves.

    Each is looked for before anything starts.
    """
    from tap_service.command import find_each, names_of
    from tap_service.config import each_once
    from tap_service.eavesdroppers import KnowledgeError, default_names, named

    text = options.eavesdropper
    asked = () if text is None else names_of([text])
    if text is not None and not asked:
        raise UsageError(f"--eavesdropper: got {text!r}, expected at least one name")
    knowledge = scenario.knowledge()

    def find(name: str) -> None:
        named(name).suits(knowledge)

    find_each(asked, find, "--eavesdropper: ")
    its = scenario.tap.eavesdroppers
    find_each(its, find, f"{options.scenario}: tap.eavesdroppers: ")
    if not its:
        its = default_names(knowledge)
    try:
        return each_once((*its, *asked))
    except KnowledgeError as error:
        raise UsageError(f"--eavesdropper: {error}") from None


def _attack(options: RunOptions, scenario: "Scenario") -> "AttackBegan | None":
    """The attack with every parameter, made once before anything starts."""
    from attacker_service.attacker import Attacker

    attack = attack_option(options.attack, scenario.attack, options.steps)
    if attack is None:
        return None
    return Attacker(scenario, attack, options.seed).began


class Progress:
    """Says when the run is over, from what plant and controller say on the management bus."""

    def __init__(self, *, until_delivered: bool, supervisor: "Supervisor") -> None:
        self._until_delivered = until_delivered
        self._supervisor = supervisor
        self.received = 0
        self.delivered = 0
        self.waiting = True
        self.keys_stopped = False
        self.stop_keys: Callable[[bytes], None] = lambda _payload: None
        """Sends a :class:`StopKeys` to the controller."""
        self._over_at: float | None = None
        self._began = time.monotonic()
        self._silent = {"plant", "controller"}

    def plant_said(self, _key: str, payload: bytes, _t_ns: int) -> None:
        """How many messages the plant has (called on the transport's thread)."""
        self._silent.discard("plant")
        with suppress(ValidationError):  # the dashboard counts malformed
            self.received = PlantStatus.model_validate_json(payload).frame.messages

    def controller_said(self, _key: str, payload: bytes, _t_ns: int) -> None:
        """What the controller has delivered, and whether more is waiting (the same thread)."""
        self._silent.discard("controller")
        with suppress(ValidationError):
            status = ControllerStatus.model_validate_json(payload)
            frame = status.frame
            self.delivered = frame.delivered
            self.keys_stopped = status.keys.refused != ""
            self.waiting = frame.queue > 0 or frame.symbols < frame.length

    def tap_said(self, _key: str, payload: bytes, _t_ns: int) -> None:
        """Have the keys stopped where the tap misses less than is claimed (the same thread).

        It is said again with each status, until the controller says that it makes no more.
        """
        with suppress(ValidationError):
            keys = TapStatus.model_validate_json(payload).keys
            if keys is not None and keys.refuted and not self.keys_stopped:
                share = f"{keys.at_most:.2g} of the {keys.direction}"
                reason = f"the claim is refuted: the tap misses {share} at most"
                self.stop_keys(StopKeys(reason=reason).wire())

    def over(self) -> bool:
        """Whether there is nothing more to watch.

        Raises
        ------
        Failure
            When a service ended with an error, or has not said anything yet.
        """
        self._supervisor.poll()
        now = time.monotonic()
        if self._silent and now >= self._began + SAID_S:
            name = min(self._silent)
            log = self._supervisor.child(name).log
            raise Failure(f"{name}: no status of it within {SAID_S:g} s (log: {log})")
        ended = self._supervisor.child("plant").returned is not None
        arrived = 0 < self.delivered <= self.received and not self.waiting
        if self._over_at is None and (ended or (self._until_delivered and arrived)):
            self._over_at = now + GRACE_S
        return self._over_at is not None and now >= self._over_at
