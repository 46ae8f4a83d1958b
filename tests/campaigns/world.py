"""Both real endpoints with their journals and the one shell, as a state that can be copied.

The network remembers the last messages of each direction, and delivers any of them, in any order,
again and again, or never: that is loss, repetition, delay and reordering at once. A process dies
before it writes, publishes or traces, or after all, and comes back with its journal or without.
"""

import copyreg
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Final, NamedTuple

from controller_service.endpoint import ControllerEndpoint
from plant_service.endpoint import PlantEndpoint
from protocol.link.endpoint import Actions, Notice, Outgoing
from protocol.link.events import Applied, Event, FrameRefused
from protocol.link.perform import CrashPoint, Killed, Mortal, perform
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Offer
from protocol.runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal
from protocol.schemes.pipelined import Pipelined
from protocol.schemes.switched import Switched
from tests.support.line_ends import LinePlant, ToldPorts, line_controller, line_plant
from tests.support.line_plant import line_rules

REMEMBERED: Final = 2
"""Messages of each direction that the network may still deliver."""

SHIFT: Final = 1.5
PAYLOADS: Final = (b"a",)
SILENCE_S: Final = 2.5
DEATHS: Final[tuple[CrashPoint, ...]] = ("writing", "publishing", "tracing")
SCHEMES: Final = ("switched", "pipelined")


@cache
def rules_of(scheme: str) -> Rules:
    """The rules of a scheme: with coin 0 a disturbance of 0.3 agrees, with coin 1 it does not."""
    made = Switched(2) if scheme == "switched" else Pipelined(2)
    return line_rules(alpha=3.0, largest_input=1e9, fingerprint="f" * 64, scheme=made)


def _named(rules: Rules) -> tuple[object, tuple[str]]:
    return rules_of, (rules.scheme.name,)


copyreg.pickle(Rules, _named)  # type: ignore[arg-type]  # shared, and not copied with every state


def propose(x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    """Two candidates about the origin."""
    return (-x[0] - SHIFT,), (-x[0] + SHIFT,)


def quiet(_notice: Notice) -> None:
    """Nobody reads the log."""


class Doing(NamedTuple):
    """Something that may happen next.

    ``what`` is ``plant hears``, ``controller hears`` (message ``number`` of those remembered, the
    newest 0), ``plant wakes``, ``plant dies`` or ``controller dies``; ``dies`` says before what the
    process dies over it, ``forgets`` that it comes back without its journal.
    """

    what: str
    number: int = 0
    coin: int = 0
    dies: CrashPoint | None = None
    forgets: bool = False

    @property
    def faults(self) -> int:
        """How much of the budget of deaths it takes."""
        return int(self.dies is not None or self.what.endswith("dies"))

    def __str__(self) -> str:
        """In words, for a counterexample."""
        words = self.what
        if "hears" in self.what:
            words += f" message {-1 - self.number}"
        if self.what == "plant hears":
            words += f", coin {self.coin}"
        if self.dies is not None:
            words += f", and dies before {self.dies}"
        return words + (", and forgets" if self.forgets else "")


class Broken(AssertionError):
    """A safety property does not hold."""


@dataclass
class World:
    """The whole system.

    Parameters
    ----------
    scheme : str
        ``switched`` or ``pipelined``.
    step_s : float, optional
        A deadline each step, so that steps are missed; None for lock-step.
    """

    scheme: str
    step_s: float | None = None
    names: int = 0
    now: float = 0.0
    drawn: int = 0
    faults: int = 0
    forgot: bool = False
    to_plant: list[Outgoing] = field(default_factory=list)
    to_controller: list[Outgoing] = field(default_factory=list)
    sent: dict[tuple[str, int], CountedTransition] = field(default_factory=dict)
    got: dict[tuple[str, int], CountedTransition] = field(default_factory=dict)
    ciphers: dict[tuple[str, int], int] = field(default_factory=dict)
    received: list[bytes] = field(default_factory=list)
    answered: dict[tuple[str, int], Outgoing] = field(default_factory=dict)
    plant: PlantEndpoint = field(init=False)
    line: LinePlant = field(init=False)
    controller: ControllerEndpoint = field(init=False)

    def __post_init__(self) -> None:
        self.controller_journal = MemoryControllerJournal(*PAYLOADS)
        self.plant_journal = MemoryPlantJournal()
        self.controller_ports = Mortal(
            ToldPorts(self.controller_journal, self._controller_said, self._counted, quiet)
        )
        self.plant_ports = Mortal(
            ToldPorts(self.plant_journal, self._plant_said, self._counted, quiet)
        )
        self._start_controller()
        self._start_plant()

    # --- what the endpoints ask for ---------------------------------------------------------------

    def symbol(self, _transition: int, size: int) -> int:
        """A cover symbol that differs from the last: a second decision would show."""
        self.drawn += 1
        return self.drawn % size

    def name(self) -> str:
        """A new id."""
        self.names += 1
        return f"{self.names:016x}"

    def _controller_said(self, message: Outgoing) -> None:
        self._remember(self.to_plant, message)
        if message.kind is Offer:
            offer = Offer.model_validate_json(message.payload)
            self._same_answer(message, offer.session, offer.k)
            record = self.controller.sender.record
            # while an answer is not settled the record is the one before it
            j = record.transitions + (1 if self._counts(offer) else 0)
            first = self.ciphers.setdefault((offer.session, j), offer.cipher)
            if first != offer.cipher:
                raise Broken(f"transition {j} was offered ciphers {first} and {offer.cipher}")

    def _counts(self, offer: Offer) -> bool:
        sender = self.controller.sender
        answer = sender._answer
        return answer is not None and answer.offer == offer and answer.counted is not None

    def _plant_said(self, message: Outgoing) -> None:
        self._remember(self.to_controller, message)
        if message.kind is Measurement:
            measurement = Measurement.model_validate_json(message.payload)
            self._same_answer(message, measurement.session, measurement.k)

    def _same_answer(self, message: Outgoing, session: str, k: int) -> None:
        if self.forgot:
            return
        first = self.answered.setdefault((f"{message.kind.topic} {session}", k), message)
        if first != message:
            raise Broken(f"{message.kind.topic} {k} was sent in two versions")

    def _remember(self, where: list[Outgoing], message: Outgoing) -> None:
        if message in where:
            where.remove(message)
        where.append(message)
        del where[:-REMEMBERED]

    def _counted(self, event: Event) -> None:
        if isinstance(event, FrameRefused):
            raise Broken("a frame was refused")
        mine = event.transition if isinstance(event, Applied) else event
        if not isinstance(mine, CountedTransition):
            return
        ours, theirs = (
            (self.got, self.sent) if isinstance(event, Applied) else (self.sent, self.got)
        )
        at = (mine.session, mine.j)
        if ours.setdefault(at, mine) != mine:
            raise Broken(f"transition {mine.j} was counted twice, in two versions")
        if theirs.get(at, mine) != mine:
            raise Broken(f"transition {mine.j}: the two ends counted it differently")
        if at[1] and (mine.session, mine.j - 1) not in ours:
            raise Broken(f"transition {mine.j} was counted, and the one before was not")

    # --- lives ------------------------------------------------------------------------------------

    def _start_controller(self) -> None:
        self.controller = line_controller(
            rules_of(self.scheme), propose, self.controller_journal, self, self.name()
        )
        self._perform(self.controller_ports, self.controller, self.controller.start(self.now))

    def _start_plant(self) -> None:
        self.plant, self.line = line_plant(
            rules_of(self.scheme), self.plant_journal, self.name, self.name(), self.now, self.step_s
        )
        self._perform(self.plant_ports, self.plant, self.plant.start(self.now))

    def _perform(
        self,
        ports: Mortal,
        endpoint: ControllerEndpoint | PlantEndpoint,
        actions: Actions,
        dies: CrashPoint | None = None,
    ) -> bool:
        """Carry out; False when the process died over it."""
        before = len(self.plant_journal.inbox())
        ports.doom(before=dies)
        try:
            perform(actions, endpoint, ports)
        except Killed:
            return False
        finally:
            ports.doom()
            self.received += self.plant_journal.inbox()[before:]
        return dies is None

    # --- what may happen --------------------------------------------------------------------------

    def choices(self, deaths: int) -> Iterator[Doing]:
        """All that may happen next, with so many deaths at most altogether."""
        fates: tuple[CrashPoint | None, ...] = (None, *DEATHS) if self.faults < deaths else (None,)
        for number in range(len(self.to_plant)):
            offer = self.to_plant[-1 - number].kind is Offer
            for coin in (0, 1) if offer else (0,):
                for dies in fates if offer else fates[:1]:
                    yield Doing("plant hears", number, coin, dies)
        for number in range(len(self.to_controller)):
            for dies in fates:
                yield Doing("controller hears", number, 0, dies)
        yield Doing("plant wakes")
        if self.faults < deaths:
            for what in ("plant dies", "controller dies"):
                yield Doing(what)
                yield Doing(what, forgets=True)

    def do(self, doing: Doing) -> None:
        """Let it happen.

        Raises
        ------
        Broken
            When a safety property does not hold any more.
        """
        self.faults += doing.faults
        if doing.what == "plant hears":
            message = self.to_plant[-1 - doing.number]
            self.line.coin, self.line.d = doing.coin, 0.3
            actions = self.plant.receive(*message, self.now)
            if not self._perform(self.plant_ports, self.plant, actions, doing.dies):
                self._start_plant()
        elif doing.what == "controller hears":
            message = self.to_controller[-1 - doing.number]
            actions = self.controller.receive(*message, self.now)
            if not self._perform(self.controller_ports, self.controller, actions, doing.dies):
                self._start_controller()
        elif doing.what == "plant wakes":
            self.now = max(self.now, min(self.plant.wake_at(), self.now + SILENCE_S))
            self._perform(self.plant_ports, self.plant, self.plant.wake(self.now))
        else:
            self._die(doing)
        self._in_order()

    def _die(self, doing: Doing) -> None:
        self.forgot |= doing.forgets
        if doing.what == "plant dies":
            if doing.forgets:
                self.plant_journal.forget()
            self._start_plant()
            return
        if doing.forgets:
            self.controller_journal.forget()
        self._start_controller()

    def _in_order(self) -> None:
        place = 0
        for payload in self.received:
            if place < len(PAYLOADS) and payload == PAYLOADS[place]:
                place += 1
            elif not self.forgot:
                raise Broken(f"{payload!r} arrived again")

    # --- when all is well -------------------------------------------------------------------------

    def goes_on(self, events: int = 400) -> bool:
        """Whether a message symbol comes through once nothing is lost and nobody dies.

        The world is used up by it.
        """
        self.to_plant.clear()
        self.to_controller.clear()
        carried = self._carried()
        return self._all_is_well(lambda: self._carried() > carried, events)

    def warm_up(self) -> None:
        """Let both ends meet and count two transitions, before anything goes wrong."""
        assert self._all_is_well(lambda: len(self.sent) >= 2, 400)

    def _all_is_well(self, over: Callable[[], bool], events: int) -> bool:
        offers = 0
        for _ in range(events):
            if self.to_plant:
                message = self.to_plant.pop(0)
                offers += message.kind is Offer
                self.line.coin, self.line.d = offers % 2, 0.3
                self._perform(self.plant_ports, self.plant, self.plant.receive(*message, self.now))
            elif self.to_controller:
                message = self.to_controller.pop(0)
                self._perform(
                    self.controller_ports,
                    self.controller,
                    self.controller.receive(*message, self.now),
                )
            else:
                self.do(Doing("plant wakes"))
            if over():
                return True
        return False

    def _carried(self) -> int:
        return sum(t.role == "message" for t in self.got.values())

    # --- states -----------------------------------------------------------------------------------

    def key(self) -> int:
        """A 64-bit hash of all that what comes next depends on, and of what was counted."""
        sender, receiver = self.controller.sender, self.plant.plant.receiver
        met = receiver._met
        ours, theirs = self.controller_journal, self.plant_journal
        return hash(
            (
                *(sender.record, sender._plant, sender._elsewhere, sender._stale, sender.instance),
                *(ours._record, ours._append),
                *(receiver.record, receiver._anyone, receiver._known, receiver.instance),
                *(met.controller, met.accepted, theirs._record, theirs._append, theirs._chunks),
                *(bytes(receiver.deframer.symbols), round(self.plant.wake_at() - self.now, 3)),
                *(tuple(self.to_plant), tuple(self.to_controller)),
                *(self.faults, self.forgot, len(self.received), self.drawn % 2),
                *(frozenset(self.sent), frozenset(self.got), frozenset(self.ciphers.items())),
            )
        )

    def packed(self) -> bytes:
        """The world as bytes, to be gone on from more than once."""
        return pickle.dumps(self, pickle.HIGHEST_PROTOCOL)


def unpacked(packed: bytes) -> World:
    """A world as it was packed."""
    world: World = pickle.loads(packed)
    return world
