"""The message's checks: what arrived, what was reported, and that no key served twice."""

from dataclasses import dataclass, field
from typing import Final

from protocol.agreement import NO_SYMBOL
from protocol.link.events import NEW_JOURNAL
from protocol.schemes.framing import Deframer
from wyner.runs.check.base import Check, Counter
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.journals import JournalState
from wyner.runs.check.records import (
    Again,
    Break,
    Item,
    MissedLine,
    OtherLine,
    QueuedLine,
    RecoveredLine,
    Refused,
    SessionLine,
    TracedTransition,
    Walked,
)
from wyner.runs.check.sides import SideReader

REPORTS: Final = {"plant": "recovered", "controller": "delivered"}
"""What each side reports of a whole frame."""


class Prefix(Check):
    """The plant's message symbols are the controller's first ones."""

    name = "prefix"
    source = "proposition 3"
    says = "what was recovered is a prefix of what was sent"
    of = "symbols"
    needs = ("plant", "controller")

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        # of the last pair: the plant has its symbol, the controller has not counted it
        self._lacking: TracedTransition | None = None

    def feed(self, part: Part) -> None:
        for plant, controller in part.pairs:
            r = plant.t if plant is not None and plant.t.role == "message" else None
            s = controller.t if controller is not None and controller.t.role == "message" else None
            t = r or s
            if t is None:
                continue
            lacking, self._lacking = self._lacking, None
            if lacking is not None and lacking.session == t.session:
                text = f"symbol {lacking.p} was recovered, and never sent"
                self.counter.fail(lacking.session, lacking.j, lacking.k, text)
            if r is None:
                text = f"symbol {t.p} was sent, not recovered"
                self.counter.count(False, t.session, t.j, t.k, text)
            elif s is None:
                self._lacking = r
            else:
                same = r.message_symbol == s.message_symbol
                text = f"symbol {r.p}: sent {s.message_symbol}, recovered {r.message_symbol}"
                self.counter.count(same, r.session, r.j, r.k, text)


@dataclass(frozen=True, slots=True)
class WholeFrame:
    """A frame that a side's symbols add up to, and the transition that completed it."""

    payload: bytes | None
    """None where its check failed."""
    at: TracedTransition


@dataclass(slots=True)
class Framing:
    """A side's symbols put together, and its reports compared with them.

    A report follows the transition that completed its frame, before either is in the journal. So
    where the side was killed in between, both come again; never where the journal was lost. Of a
    cut trace nothing is known until a report or another session says where a frame begins.
    """

    side: str
    size: int
    counter: Counter
    cut: bool = False
    session: str = ""
    due: WholeFrame | None = None
    last: WholeFrame | None = None
    owed: WholeFrame | None = None  # killed before the report; the transition must come again
    forgotten: int = 0
    lost: int = 0
    deframer: Deframer = field(init=False)

    def __post_init__(self) -> None:
        self.deframer = Deframer(self.size)

    def feed(self, item: Item) -> WholeFrame | None:
        """Take an item; a frame when it completed one."""
        if isinstance(item, Walked):
            self._goes_on(item.t.session)
            return self._push(item.t)
        if isinstance(item, Again):
            if self.last is not None and item.before is self.last.at and not item.kept:
                self.due, self.owed = self.last, None
        elif isinstance(item, MissedLine):
            self._goes_on(item.session)
        elif isinstance(item, Break):
            if item.ended:
                self._overdue(self.due)
            self.owed, self.due = self.due or self.owed, None
            self.lost = self.forgotten + (self.owed is not None)
        elif isinstance(item.line, RecoveredLine | Refused) or item.line.event == "delivered":
            self._reported(item)
        return None

    def _push(self, t: TracedTransition) -> WholeFrame | None:
        if t.session != self.session:
            self.cut = self.cut and not self.session
            self.session, self.deframer = t.session, Deframer(self.size)
        if self.cut or t.role != "message" or not 0 <= t.message_symbol < self.size:
            return None
        refused = self.deframer.refused
        payload = self.deframer.push(t.message_symbol)
        if payload is None and self.deframer.refused == refused:
            return None
        self.due = self.last = WholeFrame(payload, t)
        return self.due

    def _goes_on(self, session: str) -> None:
        """A step after the last transition: what it completed must have been reported."""
        if self.owed is not None and self.owed.at.session != session:
            self.forgotten, self.owed = self.forgotten + 1, None
        self._overdue(self.due or self.owed)

    def _overdue(self, whole: WholeFrame | None) -> None:
        if whole is not None:
            at, what = whole.at, REPORTS[self.side]
            text = f"{self.side}'s trace: a whole frame, and nothing {what}"
            self.counter.fail(at.session, at.j, at.k, text)
        self.due = self.owed = None

    def _reported(self, item: OtherLine) -> None:
        due, self.due = self.due, None
        if self.cut or (item.again and self.last is None):
            self.cut = False
            return
        refused = isinstance(item.line, Refused)
        what = f"{self.side}'s trace: {item.line.event} {item.payload!r}"
        if due is None:
            text = f"{what}, which its symbols do not add up to there"
            self.counter.fail(self.session, -1, -1, text)
        elif refused:
            self.counter.fail(due.at.session, due.at.j, due.at.k, "the plant refused a frame")
        elif due.payload != item.payload:
            at = due.at
            text = f"{what}, its symbols add up to {due.payload!r}"
            self.counter.fail(at.session, at.j, at.k, text)


class Frames(Check):
    """The symbols add up to whole frames, and to what each side reported."""

    name = "frames"
    source = "rule 7"
    says = "every frame passes its check and is reported"
    of = "frames"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        size = evidence.rules.size
        self._framing = {
            name: Framing(name, size, counter, reader.gone > 0)
            for name, reader in evidence.readers()
        }
        self._received: list[bytes] = []

    def feed(self, part: Part) -> None:
        for name, items in part.sides():
            for item in items:
                if name == "plant" and _new_journal(item):
                    self._received.clear()
                whole = self._framing[name].feed(item)
                if whole is not None:
                    at, text = whole.at, f"{name}'s trace: a frame fails its check"
                    self.counter.count(whole.payload is not None, at.session, at.j, at.k, text)
                    if name == "plant" and whole.payload is not None:
                        self._received.append(whole.payload)

    def finish(self) -> None:
        e = self.evidence
        if e.plant is not None and isinstance(e.plant_journal, JournalState):
            self._same_inbox(e.plant, e.plant_journal)
        if not self.counter.counted and e.cut:
            self.counter.skipped = e.cut
        framing = list(self._framing.values())
        self.counter.note = f"{len(framing[0].deframer.symbols)} symbols of a frame under way"
        if lost := sum(f.lost for f in framing):
            self.counter.note += f"; {lost} reports lost to kills"

    def _same_inbox(self, plant: SideReader, journal: JournalState) -> None:
        """The plant's journal has received as many messages as its trace, and the same last one."""
        if plant.behind:
            return  # put back from an older copy, it has lost what came since
        received = self._received
        if len(received) != journal.messages and not plant.gone:
            text = f"the plant's trace has {len(received)} messages since its journal began, "
            text += f"the journal counts {journal.messages}"
            self.counter.count(False, "", -1, -1, text)
        elif received and received[-1] != journal.last:
            text = f"the plant's trace ends with message {received[-1]!r}, "
            self.counter.count(False, "", -1, -1, f"{text}its journal with {journal.last!r}")


def _new_journal(item: Item) -> bool:
    """Whether the plant begins a new journal."""
    line = item.line if isinstance(item, OtherLine) else None
    return isinstance(line, SessionLine) and line.reason == NEW_JOURNAL


@dataclass(slots=True)
class _Queue:
    """The controller's messages, as its trace tells them.

    One that is a process's last line may be in no journal: ``doubtful``, until it is queued
    again.
    """

    counter: Counter
    told: list[tuple[str, bytes]] = field(default_factory=list)
    begins: set[int] = field(default_factory=set)
    known: dict[str, bytes] = field(default_factory=dict)
    restarted: bool = True
    doubtful: dict[str, int] = field(default_factory=dict)
    void: set[int] = field(default_factory=set)
    latest: str = ""
    session: str = ""
    died: bool = False
    lost: bool = False
    """Whether the journal may have been lost since the last message was queued: another session
    was met by another process.
    """

    def feed(self, item: Item) -> None:
        latest, self.latest = self.latest, ""
        if isinstance(item, Walked):  # the session goes on: so does the journal
            self.died = self.died and item.t.session != self.session
            self.session = item.t.session
        if isinstance(item, OtherLine) and isinstance(item.line, SessionLine):
            self.lost = self.lost or self.died
        if isinstance(item, Break):
            self.restarted = self.died = True
            if latest and not item.ended:
                self.doubtful[latest] = len(self.told) - 1
        elif isinstance(item, OtherLine) and isinstance(item.line, QueuedLine):
            if item.line.event == "sent":
                self._sent(item.line.id, item.payload)
            else:
                self._delivered(item.line.id, item.payload)

    def _sent(self, name: str, payload: bytes) -> None:
        self.latest = name
        if name in self.doubtful:
            self.void.add(self.doubtful.pop(name))
        elif name in self.known:
            # a controller that lost its journal is handed its messages again
            if not self.restarted:
                self.counter.fail("", -1, -1, f"message {name} was queued twice without a restart")
            self.begins.add(len(self.told))
            self.known = {}
        self.restarted = self.died = self.lost = False
        self.known[name] = payload
        self.told.append((name, payload))

    @property
    def newest(self) -> str:
        """The message that the journal must have as its last; empty where that cannot be told."""
        doubtful = self.doubtful.values()
        sure = [i for i in range(len(self.told)) if i not in self.void and i not in doubtful]
        return "" if self.lost or not sure else self.told[sure[-1]][0]

    def following(self, place: int) -> set[int]:
        """Places of the messages that may come after the one at ``place``."""
        found, doubtful = {b for b in self.begins if b > place}, self.doubtful.values()
        place += 1
        while place in self.void or place in doubtful:
            if place in doubtful:
                found.add(place)
            place += 1
        return found | {place}

    def _delivered(self, name: str, payload: bytes) -> None:
        if self.known.get(name) != payload:
            text = f"message {name} counts as delivered, and was not queued like that"
            self.counter.fail("", -1, -1, text)


class Messages(Check):
    """The recovered messages follow the queue."""

    name = "messages"
    source = "rule 7"
    says = "recovered messages are the queued ones, in order"
    of = "messages"
    needs = ("plant", "controller")

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._queue = _Queue(counter)
        controller = evidence.controller
        self._put_back = False if controller is None else bool(controller.behind)
        self._framing = Framing("plant", evidence.rules.size, Counter())
        self._places = {-1}  # of the last that was recovered: messages may be alike
        self._session = ""
        self._reached: set[int] = set()
        self._arrived: set[bytes] = set()

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        gone = [f"the {name}'s trace" for name, reader in evidence.readers() if reader.gone]
        missing = super().skipped(evidence)
        if missing or not gone:
            return missing
        return f"the beginning of {' and of '.join(gone)} is gone"

    def feed(self, part: Part) -> None:
        late = []
        for item in part.controller:
            if isinstance(item, OtherLine) and item.line.event == "delivered":
                late.append(item)
            self._queue.feed(item)
        for item in part.plant:
            whole = self._framing.feed(item)
            if whole is not None and whole.payload is not None:
                self._recovered(whole.at, whole.payload)
        for told in late:
            if told.payload not in self._arrived:
                text = f"{told.payload!r} counts as delivered, the plant has not recovered it"
                self.counter.fail("", -1, -1, text)

    def _recovered(self, at: TracedTransition, payload: bytes) -> None:
        self._arrived.add(payload)
        allowed = set().union(*map(self._queue.following, self._places))
        if at.session != self._session:
            allowed |= self._places  # received, but the session ended before the controller knew
        told = self._queue.told
        fits = {i for i in allowed if 0 <= i < len(told) and told[i][1] == payload}
        text = f"recovered {payload!r}, which is not the next queued message"
        self.counter.count(bool(fits), at.session, at.j, at.k, text)
        if fits:
            self._places = fits
            self._reached.add(min(fits))
        self._session = at.session

    def finish(self) -> None:
        queue, journal = self._queue, self.evidence.controller_journal
        if isinstance(journal, JournalState):
            for name, payload in journal.waiting:
                text = f"message {name} is in the controller's journal, and not in its trace"
                self.counter.count((name, payload) in queue.told, "", -1, -1, text)
            newest = queue.newest
            if newest and not self._put_back and journal.newest not in (newest, *queue.doubtful):
                text = f"message {newest} was queued last, the controller's journal has "
                text += f"{journal.newest or 'none'}"
                self.counter.count(False, "", -1, -1, text)
        queued = len(queue.told) - len(queue.void)
        if not self.counter.counted and queued:
            self.counter.skipped = "no message has arrived"
        self.counter.note = f"{len(self._reached)} of {queued} queued messages arrived"


class OneTimePad(Check):
    """Walk the keys: each is agreed once and used once at most."""

    name = "one-time-pad"
    source = "section 4.2"
    says = "every key symbol serves one message symbol"
    of = "message symbols"

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        if evidence.rules.scheme.from_stream:
            return "digits of the key stream are the pads: see key-stream"
        return super().skipped(evidence)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._sessions: dict[str, str] = {}
        self._unused: dict[str, list[TracedTransition]] = {}

    def feed(self, part: Part) -> None:
        for name, items in part.sides():
            for item in items:
                if isinstance(item, Walked):
                    self._of(name, item.t)

    def _of(self, name: str, t: TracedTransition) -> None:
        if t.session != self._sessions.get(name):
            self._sessions[name], self._unused[name] = t.session, []
        fresh = self._unused[name]
        if t.role == "message":
            own = next((a for a in fresh if a.symbol == t.key), None)
            text = f"{name}'s trace: a message symbol without a key of its own"
            if own is None and fresh:
                agreed = ", ".join(f"{a.symbol} at {a.j}" for a in fresh)
                text = f"{name}'s trace: key {t.key}, unused were {agreed}"
            self.counter.count(own is not None, t.session, t.j, t.k, text)
            if own is None:
                fresh.clear()
            else:
                fresh.remove(own)
        if t.symbol != NO_SYMBOL:
            fresh.append(t)


TRUTH: Final = ("true_x_next", "true_u", "attack_failed")
"""What no journal holds."""


class OneCipher(Check):
    """Every offer made for a transition carries the same cipher symbol."""

    name = "one-cipher"
    source = "rule 3"
    says = "a transition's cipher symbol is decided once"
    of = "offers"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._open: dict[str, int] = {}  # decided after the last transition of a session
        self._again = 0

    def feed(self, part: Part) -> None:
        for name, items in part.sides():
            for item in items:
                if isinstance(item, Again):
                    self._written_twice(name, item)
        for seen in part.seen:
            if seen.topic == "offer" and not self.evidence.rules.scheme.from_stream:
                self._offered(seen)

    def _written_twice(self, name: str, item: Again) -> None:
        before, after = item.before, item.after
        unlike = [
            f
            for f in TracedTransition.__dataclass_fields__
            if f not in TRUTH
            and getattr(before, f) != getattr(after, f)
            and not (item.kept and f == "expected")  # a journal is read without its keys
        ]
        text = f"{name}'s trace: written twice, with another {', '.join(unlike)}"
        self.counter.count(not unlike, after.session, after.j, after.k, text)

    def _offered(self, seen: CapturedMessage) -> None:
        e, cipher = self.evidence, seen.message.get("cipher")
        if not e.steps.knows(seen.session) or e.before(seen) or not isinstance(cipher, int):
            return  # of what is no number another check says so
        k = e.steps.next_applied(seen.session, seen.k)
        self._again += k != seen.k
        step = e.steps.find(seen.session, k)
        expected = self._open.setdefault(seen.session, cipher) if step is None else step.cipher
        j = -1 if step is None else step.j
        text = f"{seen.where}: cipher {cipher}, decided was {expected}"
        self.counter.count(cipher == expected, seen.session, j, seen.k, text)

    def finish(self) -> None:
        if self.evidence.wire is None or self.evidence.plant is None:
            self.counter.note = (
                "without a capture and a plant's trace only what was written twice is compared"
            )
            return
        self.counter.note = (
            f"{self._again} offers that were not applied carried the symbol of the next that was"
        )
