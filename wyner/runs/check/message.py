"""The message's clauses: what arrived, what was reported, and that no key served twice."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from protocol.agreement import NO_SYMBOL
from protocol.schemes.framing import Deframer, Frame
from wyner.runs.check.clause import Judging, Tally, need
from wyner.runs.check.evidence import Evidence
from wyner.runs.check.journals import Kept
from wyner.runs.check.records import (
    Again,
    Break,
    Item,
    MissedLine,
    QueuedLine,
    RecoveredLine,
    Refused,
    Told,
    TracedTransition,
    Walked,
)

REPORTS: Final = {"plant": "recovered", "controller": "delivered"}
"""What each side reports of a whole frame."""


def prefix(e: Evidence, tally: Tally) -> Judging:
    """The plant's message symbols are the controller's first ones."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    lacking: TracedTransition | None = (
        None  # the plant has its symbol, the controller has not counted it
    )
    while (part := (yield)) is not None:
        for plant, controller in part.pairs:
            r = plant.t if plant is not None and plant.t.role == "message" else None
            s = controller.t if controller is not None and controller.t.role == "message" else None
            if r is None and s is None:
                continue
            t = r or s
            assert t is not None
            if lacking is not None and lacking.session == t.session:
                text = f"symbol {lacking.p} was recovered, and never sent"
                tally.fail(lacking.session, lacking.j, lacking.k, text)
            lacking = None
            if r is None:
                tally.count(False, t.session, t.j, t.k, f"symbol {t.p} was sent, not recovered")
            elif s is None:
                lacking = r
            else:
                same = r.message_symbol == s.message_symbol
                text = f"symbol {r.p}: sent {s.message_symbol}, recovered {r.message_symbol}"
                tally.count(same, r.session, r.j, r.k, text)


@dataclass(frozen=True, slots=True)
class Whole:
    """A frame that a side's symbols add up to, and the transition that completed it."""

    frame: Frame
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
    tally: Tally
    cut: bool = False
    session: str = ""
    due: Whole | None = None
    last: Whole | None = None
    owed: Whole | None = None  # killed before the report; the transition must come again
    forgotten: int = 0
    lost: int = 0
    deframer: Deframer = field(init=False)

    def __post_init__(self) -> None:
        self.deframer = Deframer(self.size)

    def feed(self, item: Item) -> Whole | None:
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

    def _push(self, t: TracedTransition) -> Whole | None:
        if t.session != self.session:
            self.cut = self.cut and not self.session
            self.session, self.deframer = t.session, Deframer(self.size)
        if self.cut or t.role != "message" or not 0 <= t.message_symbol < self.size:
            return None
        frame = self.deframer.push(t.message_symbol)
        if frame is None:
            return None
        self.due = self.last = Whole(frame, t)
        return self.due

    def _goes_on(self, session: str) -> None:
        """A step after the last transition: what it completed must have been reported."""
        if self.owed is not None and self.owed.at.session != session:
            self.forgotten, self.owed = self.forgotten + 1, None
        self._overdue(self.due or self.owed)

    def _overdue(self, whole: Whole | None) -> None:
        if whole is not None:
            at, what = whole.at, REPORTS[self.side]
            text = f"{self.side}'s trace: a whole frame, and nothing {what}"
            self.tally.fail(at.session, at.j, at.k, text)
        self.due = self.owed = None

    def _reported(self, item: Told) -> None:
        due, self.due = self.due, None
        if self.cut or (item.again and self.last is None):
            self.cut = False
            return
        refused = isinstance(item.line, Refused)
        what = f"{self.side}'s trace: {item.line.event} {item.payload!r}"
        if due is None:
            text = f"{what}, which its symbols do not add up to there"
            self.tally.fail(self.session, -1, -1, text)
        elif refused:
            self.tally.fail(due.at.session, due.at.j, due.at.k, "the plant refused a frame")
        elif due.frame.payload != item.payload:
            at = due.at
            text = f"{what}, its symbols add up to {due.frame.payload!r}"
            self.tally.fail(at.session, at.j, at.k, text)


def frames(e: Evidence, tally: Tally) -> Judging:
    """The symbols add up to whole frames, and to what each side reported."""
    framing = {name: Framing(name, e.rules.size, tally, r.gone > 0) for name, r in e.readers()}
    received: list[bytes] = []
    while (part := (yield)) is not None:
        for name, items in part.sides():
            for item in items:
                whole = framing[name].feed(item)
                if whole is not None:
                    at, text = whole.at, f"{name}'s trace: a frame fails its check"
                    tally.count(whole.frame.intact, at.session, at.j, at.k, text)
                    if name == "plant" and whole.frame.intact:
                        received.append(whole.frame.payload)
    if e.plant is not None and isinstance(e.plant_journal, Kept):
        _same_inbox(e, e.plant_journal, received, tally)
    if not tally.counted and e.cut:
        tally.skipped = e.cut
    notes = [f"{len(f.deframer.symbols)} symbols of a frame under way" for f in framing.values()]
    tally.note = notes[0]
    if lost := sum(f.lost for f in framing.values()):
        tally.note += f"; {lost} reports lost to kills"


def _same_inbox(e: Evidence, journal: Kept, received: Sequence[bytes], tally: Tally) -> None:
    """What the plant's journal received are the last frames of its trace."""
    if e.plant is not None and e.plant.behind:
        return  # put back from an older copy, it has lost what came since
    kept = [payload for _, payload in journal.messages]
    if e.plant is not None and e.plant.from_journal and len(received) > len(kept):
        received = received[:-1]  # of the step that is in the journal and not yet counted
    if e.plant is not None and e.plant.gone:
        kept = kept[max(len(kept) - len(received), 0) :]
    if kept and list(received[-len(kept) :]) != kept:
        text = f"the plant's journal has received {len(kept)} messages that its trace has not"
        tally.count(False, "", -1, -1, text)


@dataclass(slots=True)
class _Queue:
    """The controller's messages, as its trace tells them.

    One that is a life's last word may be in no journal: ``doubtful``, until it is queued again.
    """

    tally: Tally
    told: list[tuple[str, bytes]] = field(default_factory=list)
    begins: set[int] = field(default_factory=set)
    known: dict[str, bytes] = field(default_factory=dict)
    restarted: bool = True
    doubtful: dict[str, int] = field(default_factory=dict)
    void: set[int] = field(default_factory=set)
    latest: str = ""

    def feed(self, item: Item) -> None:
        latest, self.latest = self.latest, ""
        if isinstance(item, Break):
            self.restarted = True
            if latest and not item.ended:
                self.doubtful[latest] = len(self.told) - 1
        elif isinstance(item, Told) and isinstance(item.line, QueuedLine):
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
                self.tally.fail("", -1, -1, f"message {name} was queued twice without a restart")
            self.begins.add(len(self.told))
            self.known = {}
        self.restarted = False
        self.known[name] = payload
        self.told.append((name, payload))

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
            self.tally.fail("", -1, -1, text)


def messages(e: Evidence, tally: Tally) -> Judging:
    """The recovered messages follow the queue."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    if gone := [f"the {name}'s trace" for name, reader in e.readers() if reader.gone]:
        tally.skipped = f"the beginning of {' and of '.join(gone)} is gone"
        return
    queue = _Queue(tally)
    framing = Framing("plant", e.rules.size, Tally())
    places, session = {-1}, ""  # of the last that was recovered: messages may be alike
    reached: set[int] = set()
    arrived: set[bytes] = set()
    while (part := (yield)) is not None:
        late = []
        for item in part.controller:
            if isinstance(item, Told) and item.line.event == "delivered":
                late.append(item)
            queue.feed(item)
        for item in part.plant:
            whole = framing.feed(item)
            if whole is None or not whole.frame.intact:
                continue
            at, payload = whole.at, whole.frame.payload
            arrived.add(payload)
            allowed = set().union(*map(queue.following, places))
            if at.session != session:
                allowed |= places  # received, but the session ended before the controller knew
            told = queue.told
            fits = {i for i in allowed if 0 <= i < len(told) and told[i][1] == payload}
            text = f"recovered {payload!r}, which is not the next queued message"
            tally.count(bool(fits), at.session, at.j, at.k, text)
            if fits:
                places = fits
                reached.add(min(fits))
            session = at.session
        for item in late:
            if item.payload not in arrived:
                text = f"{item.payload!r} counts as delivered, the plant has not recovered it"
                tally.fail("", -1, -1, text)
    if isinstance(e.controller_journal, Kept):
        told = queue.told
        for name, payload in e.controller_journal.messages:
            text = f"message {name} is in the controller's journal, and not in its trace"
            tally.count((name, payload) in told, "", -1, -1, text)
    queued = len(queue.told) - len(queue.void)
    if not tally.counted and queued:
        tally.skipped = "no message has arrived"
    tally.note = f"{len(reached)} of {queued} queued messages arrived"


def one_time_pad(_e: Evidence, tally: Tally) -> Judging:
    """Walk the keys: each is agreed once and used once at most."""
    sessions: dict[str, str] = {}
    unused: dict[str, list[TracedTransition]] = {}
    while (part := (yield)) is not None:
        for name, items in part.sides():
            for item in items:
                if not isinstance(item, Walked):
                    continue
                t = item.t
                if t.session != sessions.get(name):
                    sessions[name], unused[name] = t.session, []
                fresh = unused[name]
                if t.role == "message":
                    own = next((a for a in fresh if a.symbol == t.key), None)
                    text = f"{name}'s trace: a message symbol without a key of its own"
                    if own is None and fresh:
                        agreed = ", ".join(f"{a.symbol} at {a.j}" for a in fresh)
                        text = f"{name}'s trace: key {t.key}, unused were {agreed}"
                    tally.count(own is not None, t.session, t.j, t.k, text)
                    if own is None:
                        fresh.clear()
                    else:
                        fresh.remove(own)
                if t.symbol != NO_SYMBOL:
                    fresh.append(t)


TRUTH: Final = ("true_x_next", "true_u", "attack_failed")
"""What no journal holds."""


def one_cipher(e: Evidence, tally: Tally) -> Judging:
    """Every offer made for a transition carries the same cipher symbol."""
    open_: dict[str, int] = {}  # decided after the last transition of a session
    again = 0
    while (part := (yield)) is not None:
        for name, items in part.sides():
            for item in items:
                if isinstance(item, Again):
                    before, after = item.before, item.after
                    unlike = [
                        f
                        for f in TracedTransition.__dataclass_fields__
                        if f not in TRUTH and getattr(before, f) != getattr(after, f)
                    ]
                    text = f"{name}'s trace: written twice, with another {', '.join(unlike)}"
                    tally.count(not unlike, after.session, after.j, after.k, text)
        for seen in part.seen:
            if seen.topic != "offer" or not e.steps.knows(seen.session) or e.before(seen):
                continue
            cipher = seen.message.get("cipher")
            if not isinstance(cipher, int):
                continue  # another clause says so
            k = e.steps.next_applied(seen.session, seen.k)
            again += k != seen.k
            step = e.steps.find(seen.session, k)
            expected = open_.setdefault(seen.session, cipher) if step is None else step.cipher
            j = -1 if step is None else step.j
            text = f"{seen.where}: cipher {cipher}, decided was {expected}"
            tally.count(cipher == expected, seen.session, j, seen.k, text)
    if e.wire is None or e.plant is None:
        tally.note = "without a capture and a plant's trace only what was written twice is compared"
        return
    tally.note = f"{again} offers that were not applied carried the symbol of the next that was"
