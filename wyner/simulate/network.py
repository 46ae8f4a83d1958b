"""All cores in one process: virtual clock, seeded faulty network, processes that die.

The classes driven here are the ones the services run: :class:`protocol.link.sender.Sender`,
:class:`plant_service.plant.Plant` and :class:`protocol.link.pacing.Pacing`. Only time, network and
disk are make-believe, and every choice of theirs comes from one seed, so that a failure replays.
"""

import heapq
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from plant_service.plant import Move, Plant, Step, first_record
from protocol.link.pacing import Pacing
from protocol.link.receiver import ReceiverRecord
from protocol.link.sender import Sender, SenderEffects, SenderRecord
from protocol.link.session import SILENCE_S, Transition, rules_of
from protocol.messages import ControllerHello, Measurement, Message, Offer, PlantHello
from protocol.scenario import Scenario
from protocol.schemes.switched import MESSAGE
from protocol.streams import CIPHER, COIN, DISTURBANCE, SeededSymbols, Stream

HELLO_S: Final = 0.1
Vector = tuple[float, ...]


class Law(Protocol):
    """What the simulation needs of a control law."""

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The M candidate inputs at ``x``."""


@dataclass(frozen=True, slots=True)
class Faults:
    """How bad the world is, in probabilities a message or an event, and seconds.

    Parameters
    ----------
    loss, repeat : float
        Probability that a message vanishes, or arrives twice.
    delay_s : float
        Each arrival is late by a uniform time up to this, so messages overtake one another.
    crash : float
        Probability that a process dies while it handles an event: before it has saved what came of
        it, after that but before it has sent anything, before it has counted it, or after all.
    amnesia : float
        Probability that a process that died comes back without its journal.
    down_s : float
        A dead process comes back after a uniform time up to this.
    until_s : float
        From here on the network and the processes are well (for liveness).
    """

    loss: float = 0.0
    repeat: float = 0.0
    delay_s: float = 0.0
    crash: float = 0.0
    amnesia: float = 0.0
    down_s: float = 0.3
    until_s: float = float("inf")


@dataclass
class History:
    """What happened, as both ends saw it.

    ``offered`` has each offer ever sent, after the transition it was meant for and the sender's s.
    """

    plant: dict[tuple[str, int], Transition] = field(default_factory=dict)
    controller: dict[tuple[str, int], Transition] = field(default_factory=dict)
    coins: dict[tuple[str, int], int] = field(default_factory=dict)
    offered: list[tuple[int, int, Offer]] = field(default_factory=list)
    inbox: list[bytes] = field(default_factory=list)
    delivered: list[int] = field(default_factory=list)
    missed: int = 0
    crashes: int = 0
    amnesias: int = 0
    seconds: float = 0.0
    record: ReceiverRecord | None = None


class Fate(NamedTuple):
    """What a process still does of an event, in this order, and whether it outlives it."""

    saves: bool
    sends: bool
    counts: bool
    lives: bool


LIVES: Final = Fate(True, True, True, True)
DEATHS: Final = [Fate(done > 0, done > 1, done > 2, False) for done in range(4)]


class _Outbox:
    """Messages to deliver, on a disk that the simulation never loses."""

    def __init__(self, payloads: tuple[bytes, ...]) -> None:
        self._payloads = payloads

    def payload(self, number: int) -> bytes | None:
        return self._payloads[number] if number < len(self._payloads) else None


class Simulation:
    """One plant and one controller on a network of given faults.

    Parameters
    ----------
    scenario : Scenario
    law : Law
        As :func:`controller_service.laws.paper.make_law` gives it.
    seed : int
        Of the plant's and the controller's draws (streams of run ``run``) and of the faults.
    payloads : tuple of bytes
        Messages to deliver, in order.
    faults : Faults, optional
        None: nothing goes wrong.
    step_s : float, optional
        A deadline each step, in virtual seconds; None for lock-step.
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
    ) -> None:
        self.history = History()
        self.now_s = 0.0
        self._scenario = scenario
        self._law = law
        self._seed, self._run = seed, run
        self._faults = faults or Faults()
        self._step_s = step_s
        self._random = random.Random(seed)
        self._rules = rules_of(scenario)
        self._outbox = _Outbox(payloads)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._number = 0
        self._plant_life = self._controller_life = 0
        self._controller_disk: tuple[SenderRecord | None, tuple[Measurement, Offer] | None]
        self._controller_disk = (None, None)
        self._plant_disk: tuple[ReceiverRecord, str, Move | None] | None = None
        self._start_controller()
        self._start_plant()

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
        self.history.record = self._plant.receiver.record
        return self.history

    @property
    def k(self) -> int:
        """The plant's step."""
        return self._plant.receiver.record.k

    @property
    def _sick(self) -> bool:
        return self.now_s < self._faults.until_s

    def _chance(self, probability: float) -> bool:
        return probability > 0 and self._sick and self._random.random() < probability

    def _at(self, delay_s: float, event: Callable[[], None]) -> None:
        self._number += 1
        heapq.heappush(self._events, (self.now_s + delay_s, self._number, event))

    def _send(self, message: Message) -> None:
        faults = self._faults
        if self._chance(faults.loss):
            return
        for _ in range(2 if self._chance(faults.repeat) else 1):
            late = self._random.random() * faults.delay_s if self._sick else 0.0
            self._at(late, lambda: self._deliver(message))

    def _deliver(self, message: Message) -> None:
        if isinstance(message, Measurement | PlantHello):
            if self._controller_alive:
                self._controller_hears(message)
        elif self._plant_alive:
            assert isinstance(message, Offer | ControllerHello)
            self._plant_hears(message)

    def _fate(self) -> Fate:
        """How far a process gets with an event."""
        if not self._chance(self._faults.crash):
            return LIVES
        self.history.crashes += 1
        return self._random.choice(DEATHS)

    def _forgets(self) -> bool:
        forgets = self._chance(self._faults.amnesia)
        self.history.amnesias += forgets
        return forgets

    def _identifier(self) -> str:
        return f"{self._random.getrandbits(64):016x}"

    # --- the controller ---------------------------------------------------------------------------

    def _start_controller(self) -> None:
        self._controller_alive = True
        self._controller_life += 1
        self._sender = Sender(
            self._rules,
            self._law.candidates,
            self._outbox,
            SeededSymbols(self._seed, CIPHER, run=self._run),
            self._identifier(),
            *self._controller_disk,
        )
        if self._sender.unsettled:
            self._controller_saves(self._sender.settle())
        self._send(self._sender.greeting())

    def _controller_dies(self) -> None:
        self._controller_alive = False
        if self._forgets():
            self._controller_disk = (None, None)
        self._at(self._random.random() * self._faults.down_s, self._start_controller)

    def _controller_hears(self, message: Measurement | PlantHello) -> None:
        fate = self._fate()
        if isinstance(message, Measurement):
            effects = self._sender.measured(message)
        else:
            effects = self._sender.heard_plant(message)
        if effects.append:
            assert isinstance(message, Measurement)
            assert effects.offer is not None
            if fate.saves:
                self._controller_disk = (self._sender.record, (message, effects.offer))
            settled = self._sender.settle()
            if fate.counts:
                self._controller_saves(settled)
        elif fate.saves:
            self._controller_saves(effects)
        if fate.sends:
            self._controller_sends(effects)
        if not fate.lives:
            self._controller_dies()

    def _controller_saves(self, effects: SenderEffects) -> None:
        if effects.transition is not None:
            t = effects.transition
            self.history.controller[t.session, t.j] = t
        if effects.delivered is not None:
            self.history.delivered.append(effects.delivered)
        if effects.save:
            self._controller_disk = (self._sender.record, None)

    def _controller_sends(self, effects: SenderEffects) -> None:
        if effects.offer is not None:
            record = self._sender.record
            self.history.offered.append((record.transitions, record.s, effects.offer))
            self._send(effects.offer)
        if effects.reply is not None:
            self._send(effects.reply)
        if effects.greet:
            self._send(self._sender.greeting())

    # --- the plant --------------------------------------------------------------------------------

    def _start_plant(self) -> None:
        self._plant_alive = True
        self._plant_life += 1
        if self._plant_disk is None:
            self._plant_disk = (first_record(self._scenario, self._identifier()), "", None)
        record, chunks, move = self._plant_disk
        # A plant that died before it saved a step tosses its coin for that step again.
        luck = self._run if self._plant_life == 1 else self._run + 1000 * self._plant_life
        self._plant = Plant(
            self._scenario,
            self._identifier(),
            SeededSymbols(self._seed, COIN, run=luck),
            Stream(self._seed, DISTURBANCE, width=self._scenario.n, run=luck),
            record,
            chunks,
        )
        if move is not None:
            self._plant_counts(self._plant.count(move))
        self._moved = self.k > 0
        self._pacing = Pacing(self._step_s, self._scenario.link.repeats_per_period, self.now_s)
        self._hello_at = self._answered_at = self.now_s
        self._plant_wakes(self._plant_life)

    def _plant_dies(self) -> None:
        self._plant_alive = False
        if self._forgets():
            self._plant_disk = None
        self._at(self._random.random() * self._faults.down_s, self._start_plant)

    def _plant_wakes(self, life: int) -> None:
        """What the service's loop does between two arrivals."""
        if not self._plant_alive or life != self._plant_life:
            return
        receiver = self._plant.receiver
        if self._pacing.waiting:
            self._answered_at = self.now_s
        silent = self.now_s - self._answered_at >= SILENCE_S
        if silent:
            receiver.look_around()
        if (silent or not receiver.accepted) and self.now_s >= self._hello_at:
            self._hello_at = self.now_s + HELLO_S
            self._send(receiver.hello())
        running = self._moved or receiver.accepted
        if self._pacing.tick(self.now_s, running=running) == "missed":
            self._plant.miss()
            self.history.missed += 1
            self._moved = True
            self._plant_saves()
        if receiver.accepted and self._pacing.measurement_due(self.now_s):
            self._send(receiver.measurement())
        wait_s = self._pacing.wait_s(self.now_s, measuring=receiver.accepted, longest_s=HELLO_S)
        self._at(max(wait_s, 1e-6), lambda: self._plant_wakes(life))

    def _plant_hears(self, message: Offer | ControllerHello) -> None:
        receiver = self._plant.receiver
        fate = self._fate()
        if isinstance(message, ControllerHello):
            outcome = receiver.heard_controller(message, self._identifier())
            if message.instance == receiver.controller:
                self._answered_at = self.now_s
            if outcome in ("greet", "ended") and fate.saves:
                self._plant_saves(drop_chunks=outcome == "ended")
            if outcome in ("greet", "ended", "rival") and fate.sends:
                self._send(receiver.hello())
        else:
            self._plant_is_offered(message, fate)
        if not fate.lives:
            self._plant_dies()

    def _plant_is_offered(self, offer: Offer, fate: Fate) -> None:
        what = self._plant.receiver.check(offer)
        if what != "foreign":
            self._answered_at = self.now_s
        if what == "current" and not self._pacing.waiting:
            self._plant_applies(offer, fate)

    def _plant_applies(self, offer: Offer, fate: Fate) -> None:
        receiver = self._plant.receiver
        move = self._plant.move(offer)
        if fate.saves:
            assert self._plant_disk is not None
            self._plant_disk = (receiver.record, self._plant_disk[1], move)
            self._moved = True
            self._pacing.applied()
        if fate.sends and self._step_s is None and receiver.accepted:
            self._pacing.measurement_due(self.now_s)
            self._send(receiver.moved(move.x_next))
        if fate.counts:
            self._plant_counts(self._plant.count(move))

    def _plant_counts(self, step: Step) -> None:
        assert step.effects is not None
        assert step.coin is not None
        transition, frame = step.effects.transition, step.effects.frame
        self.history.plant[transition.session, transition.j] = transition
        self.history.coins[transition.session, transition.j] = step.coin
        if frame is not None and frame.intact:
            self.history.inbox.append(frame.payload)
        if step.effects.chunk or frame is not None:
            self._plant_saves(step.effects.chunk, drop_chunks=frame is not None)

    def _plant_saves(self, chunk: str = "", *, drop_chunks: bool = False) -> None:
        assert self._plant_disk is not None
        chunks = "" if drop_chunks else self._plant_disk[1]
        self._plant_disk = (self._plant.receiver.record, chunks + chunk, None)


def simulate(
    scenario: Scenario,
    law: Law,
    *,
    seed: int,
    steps: int,
    payload: bytes = b"",
    faults: Faults | None = None,
    run: int = 0,
) -> History:
    """Simulate ``steps`` steps in lock-step, and let the last transition be counted."""
    payloads = (payload,) if payload else ()
    simulation = Simulation(scenario, law, seed=seed, payloads=payloads, faults=faults, run=run)
    simulation.run(steps=steps)
    last = len(simulation.history.plant)
    return simulation.run(until=lambda: len(simulation.history.controller) >= last)


def violations(history: History, payloads: tuple[bytes, ...]) -> Iterator[str]:
    """What of the safety property does not hold, a line each.

    What the plant has recovered is a prefix of what was sent; both automata agree on every
    transition both have counted; no key symbol is used for two message symbols.
    """
    for at, mine in history.plant.items():
        theirs = history.controller.get(at)
        if theirs is not None and _counted(mine) != _counted(theirs):
            yield f"transition {at}: plant {_counted(mine)}, controller {_counted(theirs)}"
    for session in {s for s, _ in history.controller}:
        counted = sorted(j for s, j in history.controller if s == session)
        if counted != list(range(len(counted))):
            yield f"session {session}: the controller counted {counted[:5]}..., with a gap"
    ciphers: dict[tuple[str, int], int] = {}
    for j, s, offer in history.offered:
        first = ciphers.setdefault((offer.session, j), offer.cipher)
        if first != offer.cipher and s == MESSAGE:
            yield f"transition {offer.session}/{j}: cipher {first} and then {offer.cipher}"
    yield from _out_of_order(history.inbox, payloads, again=history.amnesias > 0)


def _counted(t: Transition) -> tuple[object, ...]:
    return (
        *(t.k, t.x, t.candidates, t.cipher, t.x_next, t.role),
        *(t.symbol, t.key, t.message_symbol, t.p, t.s),
    )


def _out_of_order(inbox: list[bytes], payloads: tuple[bytes, ...], *, again: bool) -> Iterator[str]:
    """Messages must arrive in order, once each; where a journal was lost one may come again."""
    place = 0
    for payload in inbox:
        if place < len(payloads) and payload == payloads[place]:
            place += 1
        elif not (again and payload in payloads[:place]):
            yield f"message {payload!r} arrived, expected {payloads[place : place + 1]!r}"
            return
