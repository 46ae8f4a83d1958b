"""Both real ends of one loop in one process: lives and deaths, the network's memory, time in hand.

Endpoints and :func:`runtime.perform.perform` are the services'. Nothing happens by itself: a test
says which message arrives, which process dies and over what; or it lets all go well. A
:class:`LinePair` has the plant on a line and journals in memory, and judges what its ends say and
count. A `RecordedPair` has the services' files, for those who need a run.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Literal

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from protocol.agreement import NO_SYMBOL
from protocol.link.effects import Effect, Effects, Extract, Publish, Save, Tell
from protocol.link.events import Event, lines
from protocol.link.records import Side
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Offer
from protocol.secret.blocks import ClosedBlock, ExtractedBlock
from protocol.secret.extractor import extracted
from protocol.secret.stream import Held
from protocol.vectors import Vector
from runtime.journal import ControllerJournal, PlantJournal
from runtime.perform import Crashed, Crashing, CrashPoint, Do, perform
from tests.support.journals import controller_journal, handed_over, plant_journal
from tests.support.line import (
    ActingLine,
    LineDevice,
    LinePlant,
    Reports,
    line_controller,
    line_plant,
)
from tests.support.mail import Mail, mail
from tests.support.once import Onlooker
from tests.support.safety import differing_key
from wyner.simulate.network import reported

Name = Literal["plant", "controller", "rival"]
"""An end; the rival is a second controller on the same loop."""

SIDES: Final[tuple[Side, Side]] = ("plant", "controller")
OTHER: Final[dict[Name, Side]] = {"controller": "plant", "rival": "plant", "plant": "controller"}
HEARS: Final = {"controller": ControllerCore.receives, "plant": PlantCore.receives}
Performer = Callable[[Effects, Do], None]

MEMORY: Final = 12
"""Messages that the network keeps for each side: its memory is long, but not endless."""

QUIET_S: Final = 60.0
"""Virtual seconds without a step after which a loop is stuck."""


class Mortal(Crashing):
    """A process that may also die so many things after an event's turn has come."""

    since: str = ""
    after = 0

    def do(self, effect: Effect) -> None:
        """Die, or carry it out."""
        if isinstance(effect, Tell) and self.since in [x["event"] for x in lines(effect.event)]:
            self.since = ""
            self.crash_at(after=self.after)
        super().do(effect)


@dataclass
class Alive:
    """One end's process.

    ``closed`` blocks wait to be extracted, and ``extracted`` ones for the end, as in a service.
    """

    endpoint: ControllerCore | PlantCore
    shell: Mortal
    files: Any = None
    closed: deque[ClosedBlock] = field(default_factory=deque)
    extracted: deque[ExtractedBlock] = field(default_factory=deque)


class Pair(ABC):
    """Two ends of one loop; a subclass opens them from what their journals hold.

    Attributes
    ----------
    now : float
        Virtual seconds.
    mail : dict of str to list of Mail
        What the network has for each side, in the order in which it was said.
    ends : dict of str to Alive
    lives : dict of str to int
    onlooker : Onlooker
    """

    performer: Performer = staticmethod(perform)

    def __init__(self, rules: Rules) -> None:
        self.rules, self.onlooker = rules, Onlooker(rules)
        self._ciphers: dict[tuple[str, int], int] = {}
        self.now = 0.0
        self.mail: dict[Side, list[Mail]] = {side: [] for side in SIDES}
        self.ends: dict[Name, Alive] = {}
        self.lives: dict[Name, int] = dict.fromkeys(OTHER, 0)
        self._loses = False

    @abstractmethod
    def open(self, side: Name) -> Alive:
        """A new process of an end, as its journal has it; nothing is said yet."""

    def said(self, side: Name, message: Mail) -> None:
        """A message leaves, and is looked at."""
        if message.kind in (Measurement, Offer):
            said = message.kind.model_validate_json(message.payload)
            assert isinstance(said, Measurement | Offer)
            self.onlooker.said(said)
            if isinstance(said, Offer) and not self.rules.scheme.from_stream:
                core: Any = self.ends[side].endpoint
                at = said.session, reported(core)
                first = self._ciphers.setdefault(at, said.cipher)
                assert first == said.cipher, "a transition was offered two cipher symbols"
        self.post(side, message)

    def post(self, side: Name, message: Mail) -> None:
        """The network has it for the other side, if it is for it."""
        if message.kind in HEARS[OTHER[side]]:
            bag = self.mail[OTHER[side]]
            bag.append(message)
            del bag[:-MEMORY]

    # --- lives and deaths -------------------------------------------------------------------------

    def start(self, side: Name) -> None:
        """A life of one end begins."""
        self.lives[side] += 1
        self.ends[side] = self.open(side)
        self.do(side, self.ends[side].endpoint.start)

    def die(self, side: Name) -> None:
        """A process is killed, and comes back at once."""
        if self._loses:
            self._lose_mail()
        self.start(side)

    def _lose_mail(self) -> None:
        for bag in self.mail.values():
            bag.clear()

    def crash_at(
        self, side: Name, before: CrashPoint | None = None, after: int = -1, since: str = ""
    ) -> None:
        """Let a process die, of which something is asked.

        Before the next thing of a kind, ``after`` so many things of any kind, or as many from the
        event ``since`` on, by its name in the trace: 0 is before it is traced, 1 before it is
        saved.
        """
        shell = self.ends[side].shell
        shell.since, shell.after = since, after
        if not since:
            shell.crash_at(before, after)

    @property
    def controller(self) -> ControllerCore:
        """The controller's core."""
        found = self.ends["controller"].endpoint
        assert isinstance(found, ControllerCore)
        return found

    @property
    def plant(self) -> PlantCore:
        """The plant's core."""
        found = self.ends["plant"].endpoint
        assert isinstance(found, PlantCore)
        return found

    # --- what may happen --------------------------------------------------------------------------

    def do(self, side: Name, act: Callable[[float], Effects]) -> None:
        """An end acts; one that dies over it begins anew at once."""
        end = self.ends[side]
        try:
            self.performer(act(self.now), end.shell.do)
        except Crashed:
            self.die(side)

    def hear(self, side: Name, message: Mail) -> None:
        """A message arrives, for the first time or once more."""
        self.do(side, lambda now: self.ends[side].endpoint.receive(*message, now))

    def deliver(self, side: Side, place: int) -> None:
        """A message in the network's memory arrives, and stays in it."""
        if bag := self.mail[side]:
            self.hear(side, bag[place % len(bag)])

    def wake(self, side: Side, seconds: float = 0.05) -> None:
        """Time passes, and an end that is due is woken."""
        self.now += seconds
        if self.ends[side].endpoint.wake_at() <= self.now:
            self.do(side, self.ends[side].endpoint.wake)

    def extract(self, side: Side) -> None:
        """The next block is extracted; its end learns of it later, or never."""
        end = self.ends[side]
        if end.closed:
            end.extracted.append(extracted(end.closed.popleft()))

    def told(self, side: Side) -> None:
        """An end learns of a block that is extracted."""
        end = self.ends[side]
        if end.extracted:
            block = end.extracted.popleft()
            self.do(side, lambda _now: end.endpoint.extracted(block))

    # --- all is well ------------------------------------------------------------------------------

    def next(self, *, extracts: bool = True) -> None:
        """The next thing happens: blocks and mail first, in their order; else time passes."""
        quiet = True
        for side in SIDES:
            if extracts and self.ends[side].closed:
                self.extract(side)
                self.told(side)
            elif self.mail[side]:
                self.hear(side, self.mail[side].pop(0))
            else:
                continue
            quiet = False
        if quiet:
            self._wake_next()

    def _wake_next(self) -> None:
        due = {side: self.ends[side].endpoint.wake_at() for side in SIDES}
        side = min(due, key=lambda s: due[s])
        self.now = max(self.now, due[side])
        self.do(side, self.ends[side].endpoint.wake)

    def well(
        self,
        things: int,
        victim: Side | None = None,
        before: CrashPoint | None = None,
        after: int = -1,
    ) -> None:
        """So many things happen, and all goes well; or ``victim`` dies over one (:meth:`crash_at`).

        What was under way is lost, when this begins and with a process.
        """
        for side in SIDES:
            self.crash_at(side, *((before, after) if side == victim else ()))
        self._lose_mail()
        self._loses = True
        for _ in range(things):
            self.next()
        self._loses = False

    def run(self, over: Callable[[], bool]) -> None:
        """Go on until ``over``; an error where nothing moves any more."""
        moved, at = (0, -1), self.now
        while not over():
            self.next()
            if (
                steps := (self.plant.state.record.session.sessions, self.plant.state.record.link.k)
            ) != moved:
                moved, at = steps, self.now
            assert self.now - at < QUIET_S, "the loop stands still"


# --- the plant on a line --------------------------------------------------------------------------


class _Covers:
    """Cover symbols; a second decision of the same transition's would show."""

    def __init__(self) -> None:
        self._last = 0

    def symbol(self, transition: int, size: int) -> int:
        self._last = (self._last * 5 + 3) % 17
        return self._last % size


class _Ports:
    """What one end does to the world."""

    def __init__(self, world: "LinePair", side: Name, closed: deque[ClosedBlock]) -> None:
        self._world, self._side = world, side
        self._reports = Reports()
        self._closed = closed

    def do(self, effect: Effect) -> None:
        match effect:
            case Save():
                self._reports.look(effect)
                self._world.saved(self._side, effect)
            case Publish(message):
                self._world.said(self._side, mail(message))
            case Tell(event):
                self._world.traced(self._side, event)
            case Extract(block):
                self._closed.append(block)


class LinePair(Pair):
    """The ends of the plant on a line, x+ = x + u + d; what must happen once is looked at.

    Parameters
    ----------
    rules : Rules
    period_s : float, optional
        Between two steps; None for lock-step.
    payloads, rivals : sequence of bytes
        The controller's messages; those of a second one, which is there if they are given.
    acts : bool
        The plant is a device: its step is begun, and read when it ends.

    Attributes
    ----------
    line : LinePlant or ActingLine
        Its coin and d are the next step's.
    counted : dict of str to dict
        The transitions that the plant, and any controller, has counted: by session and number.
    received : list of bytes
        Messages that have arrived, whatever a journal forgets.
    """

    line: LinePlant | ActingLine

    def __init__(
        self,
        rules: Rules,
        period_s: float | None = 0.5,
        payloads: Sequence[bytes] = (),
        *,
        acts: bool = False,
        rivals: Sequence[bytes] | None = None,
    ) -> None:
        super().__init__(rules)
        self.period_s = period_s
        self.names = 0
        self.device = LineDevice() if acts else None
        self.counted: dict[Side, dict[tuple[str, int], CountedTransition]] = {s: {} for s in SIDES}
        self.received: list[bytes] = []
        self._covers = _Covers()
        self._starting = True  # the plant's process counts what the one before it left
        self._payloads: dict[Name, Sequence[bytes]] = {"controller": payloads}
        if rivals is not None:
            self._payloads["rival"] = rivals
        self.journals: dict[Name, ControllerJournal | PlantJournal] = {"plant": plant_journal()}
        for side, some in self._payloads.items():
            self.journals[side] = controller_journal(*some)
        for side in self.journals:
            self.start(side)

    def close(self) -> None:
        """Let go of the journals."""
        for journal in self.journals.values():
            journal.close()

    @property
    def deaths(self) -> int:
        """Lives that are over."""
        return sum(self.lives.values()) - len(self.journals)

    def start(self, side: Name) -> None:
        self._starting = True
        super().start(side)
        self._starting = False

    def forget(self, side: Name) -> None:
        """An end loses its journal, and is there again; a controller is handed its messages."""
        journal = self.journals[side]
        journal.forget()
        if isinstance(journal, ControllerJournal):
            handed_over(journal, self._payloads[side])
        elif self.device is not None:
            self.device.u = None  # what it was told is known to nobody any more
        self.die(side)

    def propose(self, side: Name, x: Vector) -> tuple[Vector, ...]:
        """The candidates of a controller: around the origin, 3 apart, and a rival's 2.5."""
        M, shift = self.rules.size, 1.25 if side == "rival" else 1.5
        return tuple([(-x[0] + (2 * i - M + 1) * shift,) for i in range(M)])

    def name(self) -> str:
        """A new id."""
        self.names += 1
        return f"{self.names:016x}"

    def open(self, side: Name) -> Alive:
        closed = deque[ClosedBlock]()
        shell = Mortal(_Ports(self, side, closed).do)
        end = self._plant(shell) if side == "plant" else self._controller(side)
        return Alive(end, shell, closed=closed)

    def _controller(self, side: Name) -> ControllerCore:
        journal = self.journals[side]
        assert isinstance(journal, ControllerJournal)
        propose = partial(self.propose, side)
        return line_controller(self.rules, propose, journal, self._covers, self.name())

    def _plant(self, shell: Crashing) -> PlantCore:
        journal = self.journals["plant"]
        assert isinstance(journal, PlantJournal)
        common = self.name, self.name(), self.now, self.period_s
        if self.device is not None:
            self.device.passes = shell.passes
        core, self.line = line_plant(self.rules, journal, *common, device=self.device)
        return core

    # --- what is looked at ------------------------------------------------------------------------

    def saved(self, side: Name, save: Save) -> None:
        """An end writes into its journal."""
        self.journals[side].save(save)
        if save.received is not None:
            self.received.append(save.received)

    def traced(self, side: Name, event: Event) -> None:
        """An end traces an event; both count a transition alike, and the plant in one version."""
        self.onlooker.traced(event)
        if side == "plant" and self.device is not None:
            self.device.look(event, alive=not self._starting)
        if not isinstance(event, CountedTransition):
            return
        mine: Side = "plant" if side == "plant" else "controller"
        assert (event.coin == NO_SYMBOL) == (mine == "controller")
        transition = event.shared
        at = transition.session, transition.j
        if mine == "plant":
            assert at[0] == self.plant.state.record.session.id, "counted in another session"
            assert self.counted[mine].get(at, transition) == transition, "counted anew"
        self.counted[mine][at] = transition
        other = self.counted[OTHER[mine]].get(at)
        assert other is None or other == transition, "the ends counted differently"

    def held(self, side: Side) -> Held:
        """The key stream that an end's journal holds."""
        return self.journals[side].load().held

    def agree(self) -> None:
        """What both journals hold of the key stream of one session is the same."""
        mine, theirs = (self.journals[side].load() for side in SIDES)
        if mine.record is None or theirs.record is None:
            return
        if mine.record.session.id != theirs.record.session.id:
            return
        wrong = differing_key(self.rules.size, mine.held, theirs.held)
        assert not wrong, wrong
