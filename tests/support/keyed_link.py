"""Both real ends with real key stores, an unreliable network, a reaper, and two key servers.

Nothing happens by itself: whoever holds the world says which message arrives, which process dies
and over what, and what must hold is checked as it goes.
"""

from collections.abc import Callable
from typing import Literal

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from protocol.agreement import NO_SYMBOL
from protocol.defence.base import Defence
from protocol.link import guarded
from protocol.link.events import Alarm, Event, Forged
from protocol.link.guard import ANEW
from protocol.link.guarded import Guarded
from protocol.link.peer import Actions, Notice, Peer, Write
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement, Message, Offer, Status
from protocol.secret.blocks import BlockResult
from protocol.secret.records import Key, TooFewKeys, UnknownKeys
from protocol.secret.tasks import Done, GuardTask, Task
from runtime.keys import coins, guards
from runtime.keys.key_maker import KeyMaker, work
from runtime.keys.store import KeyStore
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal
from runtime.perform import Crashed, CrashingPorts, CrashPoint, perform
from runtime.perform import Ports as AnyPorts
from tests.support.copies import Copies
from tests.support.giving import agree, deliver, deliver_named
from tests.support.line_ends import Reports, line_controller, line_plant
from tests.support.mail import mail
from tests.support.twin_journals import TwinControllerJournal, TwinPlantJournal

Side = Literal["controller", "plant"]
SIDES: tuple[Side, Side] = ("controller", "plant")
OTHER: dict[Side, Side] = {"controller": "plant", "plant": "controller"}
Performer = Callable[[Actions, Peer, AnyPorts], None]

MEMORY = 12
"""Messages that the network keeps for each side."""


class Zeros:
    def symbol(self, transition: int, size: int) -> int:
        return transition % size


class Ports:
    def __init__(self, world: "World", side: Side) -> None:
        self.world, self.side = world, side
        self.reports = Reports()

    def write(self, write: Write) -> None:
        self.reports.look(write)
        self.world.journals[self.side].write(write)

    def publish(self, message: Message) -> None:
        self.world.published(self.side, *mail(message))

    def submit_key_task(self, task: Task) -> None:
        self.world.tasks[self.side].append(task)

    def trace(self, event: Event) -> None:
        self.world.traced(self.side, event)

    def log_notice(self, notice: Notice) -> None:
        pass

    def health(self, status: Status) -> None:
        pass


class World:
    """Two ends of one loop.

    Parameters
    ----------
    rules : Rules
        With a schedule.
    performer : callable
        :func:`runtime.perform.perform`, or a wrong one.
    period_s : float
        Between two steps.
    on_disk : bool
        Journals have twins on disk.
    guard : Defence, optional
        What guards the messages.
    """

    steps: int | None = None
    """The plant's last step, if any."""

    def __init__(
        self,
        rules: Rules,
        performer: Performer = perform,
        period_s: float = 0.5,
        *,
        on_disk: bool = False,
        guard: Defence | None = None,
    ) -> None:
        self.rules = rules
        self.guard = guard
        self.period_s = period_s
        self.performer = performer
        self.now = 0.0
        self.names = 0
        self.deaths = 0
        self.stores = {side: KeyStore(None, side) for side in SIDES}
        self.journals: dict[Side, MemoryControllerJournal | MemoryPlantJournal] = {
            "controller": TwinControllerJournal() if on_disk else MemoryControllerJournal(),
            "plant": TwinPlantJournal() if on_disk else MemoryPlantJournal(),
        }
        self.ports = {side: CrashingPorts(Ports(self, side)) for side in SIDES}
        self.bag: dict[Side, list[tuple[type[Message], bytes]]] = {s: [] for s in SIDES}
        self.tasks: dict[Side, list[Task]] = {side: [] for side in SIDES}
        self.done: dict[Side, list[Done]] = {side: [] for side in SIDES}
        self.ends: dict[Side, Peer] = {}
        self.key_makers: dict[Side, KeyMaker] = {}
        self.copies = Copies()
        self.counted: dict[Side, dict[tuple[str, int], CountedTransition]] = {s: {} for s in SIDES}
        self.given: list[Key] = []
        self.coins: dict[tuple[str, int], tuple[str, int]] = {}
        """Digits that coins came from, by key and number, with session and step."""
        self.watched: set[tuple[str, int]] = set()
        self.slots: dict[tuple[Side, str, str], bytes] = {}
        """What was sent under each slot of a key, without what a copy has anew."""
        self.tampers = False
        self.forged = 0
        for side in SIDES:
            self.start(side)

    def close(self) -> None:
        for kept in (*self.stores.values(), *self.journals.values()):
            kept.close()

    def name(self) -> str:
        self.names += 1
        return f"{self.names:016x}"

    # --- lives and deaths -------------------------------------------------------------------------

    def start(self, side: Side) -> None:
        self.tasks[side].clear()
        self.done[side].clear()
        self.key_makers[side] = KeyMaker(self.stores[side])
        end = self.controller() if side == "controller" else self.plant()
        self.ends[side] = end if self.guard is None else self.guarded(side, end, self.guard)
        self.carry_out(side, self.ends[side].start(self.now))

    def controller(self) -> ControllerCore:
        journal = self.journals["controller"]
        assert isinstance(journal, MemoryControllerJournal)
        return line_controller(
            self.rules,
            lambda x: ((-x[0] - 1.5,), (-x[0] + 1.5,)),
            journal,
            Zeros(),
            self.name(),
            coin_keys=self.coin_keys("controller", journal.load()),
        )

    def plant(self) -> PlantCore:
        journal = self.journals["plant"]
        assert isinstance(journal, MemoryPlantJournal)
        endpoint, _ = line_plant(
            self.rules,
            journal,
            self.name,
            self.name(),
            self.now,
            self.period_s,
            coin_keys=self.coin_keys("plant", journal.load()),
            steps=self.steps,
        )
        return endpoint

    def coin_keys(
        self, side: Side, record: SenderRecord | ReceiverRecord | None
    ) -> tuple[Key, ...]:
        """Keys that a process that begins finds in its store, for the coin of its session."""
        if record is None or not self.rules.keyed:
            return ()
        return coins.held(self.stores[side], record.session)

    def guarded(self, side: Side, end: ControllerCore | PlantCore, guard: Defence) -> Guarded:
        """The end with its messages guarded by the keys that its store holds."""
        record = self.journals[side].load()
        keys = None
        if record is not None and record.session is not None:
            sends = side == "plant" or guard.tags
            words = (guard.session_words, guard.step_words) if sends else (0, 0)
            begins = record.k + guarded.MARGIN
            task = GuardTask(record.session, end.instance, record.k, begins, *words)
            keys = guards.serve(self.stores[side], task)
        session = None if keys is None else keys.session
        return Guarded(end, side, guard, end.instance, end.end_session, session, keys)

    def carry_out(self, side: Side, actions: Actions) -> None:
        try:
            self.performer(actions, self.ends[side], self.ports[side])
        except Crashed:
            self.die(side)

    def crash_at(self, side: Side, before: CrashPoint | None, after: int = -1) -> None:
        self.ports[side].crash_at(before, after)

    def die(self, side: Side) -> None:
        self.deaths += 1
        self.ports[side].crash_at()
        self.start(side)

    # --- what may happen --------------------------------------------------------------------------

    def deliver(self, side: Side, place: int) -> None:
        """A message in the network's memory arrives, for the first time or once more."""
        bag = self.bag[side]
        if bag:
            kind, payload = bag[place % len(bag)]
            if kind in self.ends[side].hears:
                self.carry_out(side, self.ends[side].receive(kind, payload, self.now))

    def wake(self, side: Side) -> None:
        self.now += 0.05
        if self.ends[side].wake_at() <= self.now:
            self.carry_out(side, self.ends[side].wake(self.now))

    def keeps(self, side: Side) -> None:
        """The keeper does its next task; its process learns of it later, or never."""
        if self.tasks[side]:
            self.done[side].append(work(self.key_makers[side], self.tasks[side].pop(0)))

    def told(self, side: Side) -> None:
        if self.done[side]:
            self.carry_out(side, self.ends[side].key_task_done(self.done[side].pop(0), self.now))

    def asks(self) -> None:
        """Each end asks the other which keys may be given, and is answered."""
        agree(*self.stores.values())

    def serve(self, side: Side) -> None:
        """A key server gives a key, and its partner finds the same one by its id."""
        try:
            (key,) = deliver(self.stores[side], 1, side, partner=self.stores[OTHER[side]])
        except TooFewKeys:
            return
        assert key not in self.given, "a key was given twice"
        assert key.key_id not in {name for name, _ in self.coins}, "a coin came from it"
        self.given.append(key)
        try:
            (same,) = deliver_named(
                self.stores[OTHER[side]], [key.key_id], partner=self.stores[side]
            )
        except UnknownKeys:
            raise AssertionError("a key was given that the partner does not have") from None
        assert same == key, "the two ends gave different keys under one id"

    def well(
        self, rounds: int, victim: Side | None = None, before: CrashPoint | None = None
    ) -> None:
        """Everybody hears everything at once; or ``victim`` dies, and what was under way is lost.

        What was under way at the beginning is lost, too.
        """
        for side in SIDES:
            self.ports[side].crash_at(before if side == victim else None)
            self.bag[side].clear()
        deaths = self.deaths
        for n in range(rounds):
            if (self.rules.keyed or self.guard) and n % 8 == 7:
                self.asks()
            if deaths != self.deaths:
                deaths = self.deaths
                for side in SIDES:
                    self.bag[side].clear()
            for side in SIDES:
                self.wake(side)
                while self.bag[side] and deaths == self.deaths:
                    kind, payload = self.bag[side].pop(0)
                    if kind in self.ends[side].hears:
                        self.carry_out(side, self.ends[side].receive(kind, payload, self.now))
                self.keeps(side)
                self.told(side)

    # --- what must hold ---------------------------------------------------------------------------

    def published(self, side: Side, kind: type[Message], payload: bytes) -> None:
        bag = self.bag[OTHER[side]]
        bag.append((kind, payload))
        del bag[:-MEMORY]
        if kind in (Measurement, Offer):
            message = kind.model_validate_json(payload)
            assert isinstance(message, Measurement | Offer)
            self.copies.left(message)
            if message.guard and not message.guard.endswith("/"):  # a farewell is the same in all
                at = side, message.session, message.guard
                said = ANEW.sub(b"", payload, 1)
                assert self.slots.setdefault(at, said) == said, "a slot served two messages"

    def traced(self, side: Side, event: Event) -> None:
        if isinstance(event, BlockResult):
            assert event.what == "confirmed", "the ends hold different blocks"
        assert not isinstance(event, Alarm), "an honest step made an alarm"
        self.forged += isinstance(event, Forged)
        assert self.tampers or not self.forged, "an honest message was refused"
        if isinstance(event, CountedTransition):
            self.coin_was(side, event)
            transition = event.shared
            at = transition.session, transition.j
            self.counted[side][at] = transition
            other = self.counted[OTHER[side]].get(at)
            assert other is None or other == transition, "the ends counted differently"

    def coin_was(self, side: Side, t: CountedTransition) -> None:
        """A keyed coin is of the digit of its step alone; who watches it expects that one."""
        if side == "controller":
            if t.expected != NO_SYMBOL:
                self.watched.add((t.session, t.k))
            return
        if t.coin_key:
            digit = t.coin_key, t.k - t.coin_from
            at = t.session, t.k
            assert self.coins.setdefault(digit, at) == at, "a digit served two steps"

    def agree(self) -> None:
        """Ids come in one order at both ends."""
        mine, theirs = ([name for name, _ in self.stores[side].ids()] for side in SIDES)
        shared = set(mine) & set(theirs)
        assert [n for n in mine if n in shared] == [n for n in theirs if n in shared]
