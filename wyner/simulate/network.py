"""Both ends in one process: virtual clock, seeded faulty network, processes that die.

The endpoints driven here are the ones the services run, through the same
:func:`runtime.perform.perform`. Only time, network and disk are make-believe, and every
choice of theirs comes from one seed, so that a failure replays.
"""

import heapq
import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from math import inf
from pathlib import Path
from typing import Final, Literal

from controller_service.core import ControllerCore
from plant_service.adapters.base import PlantAdapter, Stepped
from plant_service.core import PlantCore
from plant_service.opening import open_core
from protocol.agreement import NO_SYMBOL
from protocol.link.channel import Channel, Direction, channel_of
from protocol.link.effects import Effect, Effects, Extract, Publish, Save, Tell
from protocol.link.endpoint import Endpoint
from protocol.link.events import Event, Missed
from protocol.link.pacing import Pacing
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.session import CountedTransition, reports, rules_of
from protocol.link.step import Answered
from protocol.messages import (
    Message,
    Offer,
    SendCommand,
)
from protocol.scenario import Scenario
from protocol.secret.blocks import ClosedBlock
from protocol.secret.extractor import extracted
from protocol.streams import CIPHER, COIN, DISTURBANCE, SENSOR, SeededSymbols, Stream
from runtime.chance import seeded_nonces
from runtime.journal import ControllerJournal, PlantJournal
from runtime.perform import Crashed, Crashing, perform
from runtime.user_code import load_model
from wyner.simulate.engine import Law
from wyner.simulate.faults import Faults


@dataclass
class History:
    """What happened, as both ends saw it.

    ``offered`` has each offer ever sent whose cipher symbol is not of the key stream, after the
    transition it was meant for. ``rewritten`` names transitions that one side counted in two
    versions.
    """

    plant: dict[tuple[str, int], CountedTransition] = field(default_factory=dict)
    controller: dict[tuple[str, int], CountedTransition] = field(default_factory=dict)
    rewritten: list[tuple[str, int]] = field(default_factory=list)
    offered: list[tuple[int, Offer]] = field(default_factory=list)
    inbox: list[bytes] = field(default_factory=list)
    delivered: list[int] = field(default_factory=list)
    missed: int = 0
    crashes: int = 0
    amnesias: int = 0
    seconds: float = 0.0
    record: PlantRecord | None = None


Side = Literal["plant", "controller"]

LONGEST: Final = 5
"""A process that dies does so before one of the first so many things that an event asks of it: the
four of a step (save it, publish it, trace what it counted, keep the record), or after all."""


def reported(core: ControllerCore) -> int:
    """Transitions that the plant has reported, the one that waits to be counted included."""
    record, step = core.state.record, core.state.step
    counts = isinstance(step, Answered) and reports(record.link, record.offer, step.measurement)
    return record.link.transitions + counts


class SimulatedEnd:
    """One end: its journal and, while it lives, its endpoint."""

    def __init__(
        self,
        world: "Simulation",
        side: Side,
        partner: Side,
        journal: ControllerJournal | PlantJournal,
    ) -> None:
        self._world = world
        self.side: Side = side
        self.partner: Side = partner
        self.journal = journal
        self.shell = Crashing(self.do)
        self.endpoint: Endpoint | None = None
        self.wakes_at = inf
        self.incarnations = 0

    def do(self, effect: Effect) -> None:
        """What it does to the world: to its disk, to the network, to the history."""
        match effect:
            case Save():
                self.journal.save(effect)
                self._world.kept(effect)
            case Publish(message):
                self._world.send(self.partner, message)
            case Extract(block):
                self._world.extract(self.side, block)
            case Tell(event):
                self._world.traced(event)


class Simulation:
    """One plant and one controller on a network of given faults.

    Parameters
    ----------
    scenario : Scenario
    law : Law
        As :func:`controller_service.laws.registry.make_law` gives it.
    seed : int
        Of the plant's and the controller's draws (streams of run ``run``) and of the faults.
    payloads : tuple of bytes
        Messages to deliver, in order.
    faults : Faults, optional
        None: nothing goes wrong.
    step_s : float, optional
        A deadline each step, in virtual seconds; None for lock-step.
    own : callable, optional
        Gives what stands in the place of the scenario's plant, for each process.
    folder : Path
        Where the files that the scenario names are looked for.

    Attributes
    ----------
    ends : dict of Side to SimulatedEnd
    plant : PlantCore
        The plant's core in this process.
    random : random.Random
        From which all that the world does is drawn.
    """

    def __init__(
        self,
        scenario: Scenario,
        law: Law,
        *,
        seed: int,
        payloads: tuple[bytes, ...] = (),
        faults: Faults | None = None,
        step_s: float | None = None,
        run: int = 0,
        own: Callable[[], Stepped | PlantAdapter] | None = None,
        folder: Path = Path(),
    ) -> None:
        self._own = own
        self._folder = folder
        self.history = History()
        self.now_s = 0.0
        self.scenario = scenario
        self._law = law
        self._seed, self._run = seed, run
        self._nonces = seeded_nonces(seed, run)
        self._predict = load_model(scenario, folder)
        self._width = len(scenario.plant.disturbance.half_widths)
        self._faults = faults or Faults()
        self._step_s = step_s
        self._scheme = rules_of(scenario).scheme
        self.random = random.Random(seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._number = 0
        self._payloads = payloads
        self._queue = ControllerJournal(None, scenario.fingerprint())
        self._hand_over()
        self._plant_journal = PlantJournal(None, scenario.fingerprint())
        self._controller: ControllerCore
        self.plant: PlantCore
        self._delivered = 0
        self.ends: dict[Side, SimulatedEnd] = {
            "controller": SimulatedEnd(self, "controller", "plant", self._queue),
            "plant": SimulatedEnd(self, "plant", "controller", self._plant_journal),
        }
        for side in self.ends:
            self._start(side)

    # --- the world --------------------------------------------------------------------------------

    def run(
        self,
        *,
        steps: int | None = None,
        seconds: float | None = None,
        until: Callable[[], bool] | None = None,
    ) -> History:
        """Go on until the plant's k, the virtual time or ``until`` says so."""
        while self._events:
            at, _, event = self._events[0]
            if seconds is not None and at > seconds:
                self.now_s = seconds
                break
            heapq.heappop(self._events)
            self.now_s = at
            event()
            if steps is not None and self.k >= steps:
                break
            if until is not None and until():
                break
        self.history.seconds = self.now_s
        self.history.record = self.plant.state.record
        return self.history

    @property
    def k(self) -> int:
        """The plant's step."""
        return self.plant.state.link.k

    @property
    def _sick(self) -> bool:
        return self.now_s < self._faults.until_s

    def chance(self, probability: float) -> bool:
        """Whether what has this probability comes about, while anything goes wrong at all."""
        return probability > 0 and self._sick and self.random.random() < probability

    def after(self, delay_s: float, event: Callable[[], None]) -> None:
        """Let an event come about so many virtual seconds from now."""
        self._number += 1
        heapq.heappush(self._events, (self.now_s + delay_s, self._number, event))

    def _identifier(self) -> str:
        return f"{self.random.getrandbits(64):016x}"

    # --- what an effect does ----------------------------------------------------------------------

    def send(self, to: Side, message: Message) -> None:
        """Put a message on the network, which does with it what it likes."""
        faults = self._faults
        if isinstance(message, Offer) and not self._scheme.from_stream:
            self.history.offered.append((reported(self._controller), message))
        if self.chance(faults.loss):
            return
        for _ in range(2 if self.chance(faults.repeat) else 1):
            late = self.random.random() * faults.delay_s if self._sick else 0.0
            self.after(late, lambda: self.deliver(to, message))

    def extract(self, side: Side, block: ClosedBlock) -> None:
        """Tell an end of an extracted block some time later, if the process still lives."""
        end = self.ends[side]
        incarnation = end.incarnations

        def tell() -> None:
            if end.incarnations == incarnation and end.endpoint is not None:
                self._perform(end, end.endpoint.extracted(extracted(block)))

        self.after(self.random.random() * self._faults.delay_s, tell)

    def kept(self, save: Save) -> None:
        """Note what a record says of messages that came through."""
        record = save.record
        if isinstance(record, ControllerRecord):
            self.history.delivered.extend(range(self._delivered, record.frame.message))
            self._delivered = record.frame.message
        elif save.received is not None:
            self.history.inbox.append(save.received)

    def traced(self, event: Event) -> None:
        """Note what a side counted."""
        if isinstance(event, CountedTransition):
            at_plant = event.coin != NO_SYMBOL
            self._counted(self.history.plant if at_plant else self.history.controller, event)
        elif isinstance(event, Missed):
            self.history.missed += 1

    def _counted(
        self, known: dict[tuple[str, int], CountedTransition], t: CountedTransition
    ) -> None:
        at = t.session, t.j
        if known.setdefault(at, t) != t:
            self.history.rewritten.append(at)

    # --- starts and deaths ------------------------------------------------------------------------

    def _start(self, side: Side) -> None:
        end = self.ends[side]
        end.incarnations += 1
        end.shell.crash_at()
        end.endpoint = (
            self._new_plant(end.incarnations) if side == "plant" else self._new_controller()
        )
        self._perform(end, end.endpoint.start(self.now_s))

    def _channel(self, way: Direction) -> Channel | None:
        """What messages to a new process pass."""
        scale = 1.0 if self._step_s is None else self._step_s / self.scenario.plant.period_s
        return channel_of(self.scenario, way, scale=scale, seed=self._seed, run=self._run)

    def _new_controller(self) -> ControllerCore:
        self._controller = ControllerCore(
            rules_of(self.scenario),
            self._law.candidates,
            self._queue,
            SeededSymbols(self._seed, CIPHER, run=self._run),
            instance=self._identifier(),
            period_s=self.scenario.plant.period_s,
            loaded=self._queue.load(),
            predict=self._predict,
            nonces=self._nonces,
            channel=self._channel("to_controller"),
        )
        return self._controller

    def _new_plant(self, incarnations: int) -> PlantCore:
        # A plant that died before it saved a step tosses its coin for that step again.
        draws = self._run if incarnations == 1 else self._run + 1000 * incarnations
        # Where outputs are read such a step is made again with the d that it had.
        disturbed = draws if self.scenario.plant.C is None else self._run
        self.plant = open_core(
            self.scenario,
            self._plant_journal,
            SeededSymbols(self._seed, COIN, run=draws),
            Stream(self._seed, DISTURBANCE, width=self._width, run=disturbed),
            self._identifier,
            self.now_s,
            Pacing(self._step_s, self.scenario.link.repeats_per_period, self.now_s),
            own=None if self._own is None else self._own(),
            folder=self._folder,
            sensors=Stream(self._seed, SENSOR, width=self.scenario.readings, run=self._run),
            nonces=self._nonces,
            channel=self._channel("to_plant"),
        )
        return self.plant

    def deliver(self, to: Side, message: Message) -> None:
        """A message arrives; nobody is there while the process is dead."""
        end = self.ends[to]
        if end.endpoint is None:
            return
        kind, payload = type(message), message.wire()
        self._perform(end, end.endpoint.receive(kind, payload, self.now_s))

    def _wake(self, end: SimulatedEnd, at_s: float) -> None:
        if end.endpoint is None or at_s != end.wakes_at:  # overtaken by an earlier one, or dead
            return
        end.wakes_at = inf
        due = end.endpoint.wake_at() <= self.now_s
        self._perform(end, end.endpoint.wake(self.now_s) if due else ())

    def _perform(self, end: SimulatedEnd, effects: Effects) -> None:
        """Carry out what an end wants; it may die over it, or right after it."""
        assert end.endpoint is not None
        asked = iter(effects)
        first = tuple(islice(asked, 1))
        crashing = first != () and self.chance(self._faults.crash)
        end.shell.crash_at(after=self.random.randrange(LONGEST) if crashing else -1)
        with suppress(Crashed):
            perform(chain(first, asked), end.shell.do)
        if crashing:
            self._die(end)
            return
        due = end.endpoint.wake_at()
        if due < end.wakes_at:
            end.wakes_at = due = max(due, self.now_s)
            self.after(due - self.now_s, lambda: self._wake(end, due))

    def _die(self, end: SimulatedEnd) -> None:
        self.history.crashes += 1
        end.endpoint = None
        end.wakes_at = inf
        if self.chance(self._faults.amnesia):
            self.history.amnesias += 1
            end.journal.forget()
            if end.side == "controller":
                self._hand_over()
        self.after(self.random.random() * self._faults.down_s, lambda: self._start(end.side))

    def _hand_over(self) -> None:
        """The operator hands over all messages."""
        for number, payload in enumerate(self._payloads):
            self._queue.enqueue(SendCommand(id=f"{number}", payload=payload))
