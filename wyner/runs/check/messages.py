"""Messages: what the symbols add up to, what each end reported of it, and the queue."""

from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from protocol.link.events import NEW_JOURNAL, PowerFailed, SessionBegan
from protocol.schemes.framing import Deframer
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.journals import JournalState
from wyner.runs.lines import Again, Break, Item, OtherLine, QueuedLine
from wyner.runs.trace import Trace

REPORTS: Final = {"plant": "recovered", "controller": "delivered"}
"""What each side reports of a whole frame."""


def messages(e: Evidence) -> Findings:
    """Frames pass their check and are reported; what was recovered follows the queue."""
    received: list[WholeFrame | None] = []
    for trace in e.ends():
        framing = Framing(trace, e.rules.size)
        framing.read()
        yield from framing.wrong
        if trace.side == "plant":
            received = framing.received
            yield from _same_inbox(trace, e.journals["plant"], received, lost=framing.lost)
    if e.plant is None or e.controller is None or e.plant.gone or e.controller.gone:
        return
    yield from _in_order(e, e.controller, [frame for frame in received if frame is not None])


class WholeFrame(NamedTuple):
    """A frame that an end's symbols add up to; ``payload`` is None where its check failed.

    ``after_loss``: a power failure may have taken the frames before it.
    """

    payload: bytes | None
    session: str
    j: int
    k: int
    after_loss: bool = False


@dataclass(slots=True)
class Framing:
    """An end's symbols put together, and its reports compared with them.

    A report follows the transition that completed its frame, before either is in the journal. So
    where the end was killed in between, both come again; never where the journal was lost. Of a cut
    trace nothing is known until a report or another session says where a frame begins.

    ``received`` has the frames that passed their check, and None where a new journal began.
    """

    trace: Trace
    size: int
    wrong: list[Finding] = field(default_factory=list)
    received: list[WholeFrame | None] = field(default_factory=list)
    due: WholeFrame | None = None
    last: WholeFrame | None = None
    owed: WholeFrame | None = None  # killed before the report; the transition must come again
    deframer: Deframer = field(init=False)
    session: int = -1
    lost: bool = False  # the power failed since the last frame
    unknown: bool = field(init=False)

    def read(self) -> None:
        """Walk the trace."""
        self.deframer, self.unknown = Deframer(self.size), self.trace.gone > 0
        for row, item in self.trace.walk("session", "j", "k", "message", "message_symbol"):
            if item is None:
                self._step(*row)
            elif isinstance(item, OtherLine):
                self._told(item)
            elif isinstance(item, Again):
                again = item.before.session, item.before.j
                if self.last is not None and again == self.last[1:3]:
                    self.due, self.owed = self.last, None
            else:
                if item.ended:
                    self._overdue(self.due)
                self.owed, self.due = self.due or self.owed, None

    def _step(self, session: int, j: int, k: int, message: bool, symbol: int) -> None:
        name = self.trace.sessions[session]
        if self.due is not None or self.owed is not None:
            if self.owed is not None and self.owed.session != name:
                self.owed = None  # the report is lost with the journal
            self._overdue(self.due or self.owed)
        if j < 0:
            return
        if session != self.session:
            self.unknown = self.unknown and self.session < 0
            self.session, self.deframer = session, Deframer(self.size)
        if self.unknown or not message or symbol < 0:
            return
        refused = self.deframer.refused
        payload = self.deframer.push(symbol)
        if payload is None and self.deframer.refused == refused:
            return
        self.due = self.last = WholeFrame(payload, name, j, k, self.lost)
        if payload is None:
            self._fail("a frame fails its check", self.last)
        else:
            self.received.append(self.last)
            self.lost = False

    def _told(self, item: OtherLine) -> None:
        line = item.line
        if isinstance(line, SessionBegan) and line.reason == NEW_JOURNAL:
            self.received.append(None)
        self.lost = self.lost or isinstance(line, PowerFailed)
        if item.event not in ("recovered", "refused", "delivered"):
            return
        due, self.due = self.due, None
        if self.unknown or (item.again and self.last is None):
            self.unknown = False
            return
        if due is None:
            self._fail(f"{item.event} {item.payload!r}, which its symbols do not add up to there")
        elif item.event == "refused":
            self._fail("the plant refused a frame", due)
        elif due.payload != item.payload:
            text = f"{item.event} {item.payload!r}, its symbols add up to {due.payload!r}"
            self._fail(text, due)

    def _overdue(self, whole: WholeFrame | None) -> None:
        if whole is not None:
            self._fail(f"a whole frame, and nothing {REPORTS[self.trace.side]}", whole)
        self.due = self.owed = None

    def _fail(self, text: str, at: WholeFrame | None = None) -> None:
        session, k = ("", -1) if at is None else (at.session, at.k)
        self.wrong.append(Finding("messages", session, k, f"{self.trace.side}'s trace: {text}"))


def _same_inbox(
    plant: Trace,
    journal: JournalState | str | None,
    received: list[WholeFrame | None],
    *,
    lost: bool,
) -> Findings:
    """The plant's journal has received as many messages as its trace, and the same last one."""
    if not isinstance(journal, JournalState) or plant.behind:
        return  # put back from an older copy, it has lost what came since
    since = received[len(received) - received[::-1].index(None) :] if None in received else received
    payloads = [frame.payload for frame in since if frame is not None]
    fewer = plant.gaps and len(payloads) < journal.messages
    if journal.ahead >= 0 and len(payloads) == journal.messages + 1:
        return  # the journal counts it with the step that it has saved
    if len(payloads) != journal.messages and not plant.gone and not fewer:
        text = f"the plant's trace has {len(payloads)} messages since its journal began, "
        yield Finding("messages", "", -1, f"{text}the journal counts {journal.messages}")
    elif payloads and payloads[-1] != journal.last and not lost:
        text = f"the plant's trace ends with message {payloads[-1]!r}, "
        yield Finding("messages", "", -1, f"{text}its journal with {journal.last!r}")


@dataclass(slots=True)
class Queue:
    """The controller's messages, as its trace tells them.

    One that is a process's last line may be in no journal: ``doubtful``, until it is queued
    again. ``lost`` says whether the journal may have been lost since the last message was queued:
    another session was met by another process.

    ``untold`` are messages whose lines a power failure took.
    """

    trace: Trace
    plant: Trace

    told: list[tuple[str, bytes]] = field(default_factory=list)
    delivered: list[bytes] = field(default_factory=list)
    untold: set[bytes] = field(default_factory=set)
    gaps: set[int] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)
    begins: set[int] = field(default_factory=set)
    known: dict[str, bytes] = field(default_factory=dict)
    doubtful: dict[str, int] = field(default_factory=dict)
    void: set[int] = field(default_factory=set)
    restarted: bool = True
    latest: str = ""
    session: int = -1
    k: int = -1
    died: bool = False
    lost: bool = False

    def take(self, row: tuple[Any, ...], item: Item | None) -> None:
        """Take the next row or note of the trace."""
        latest, self.latest = self.latest, ""
        if item is None:  # the session goes on: so does the journal
            self.died = self.died and row[0] != self.session
            self.session, self.k = row
        elif isinstance(item, OtherLine):
            if isinstance(item.line, SessionBegan):
                self.lost = self.lost or self.died
            elif isinstance(item.line, PowerFailed):
                self.lost = True
                self.gaps.add(len(self.told))
            elif isinstance(item.line, QueuedLine):
                self._queued(item.event, item.line.id, item.payload)
        elif isinstance(item, Break):
            self.restarted = self.died = True
            if latest and not item.ended:
                self.doubtful[latest] = len(self.told) - 1

    def _queued(self, event: str, name: str, payload: bytes) -> None:
        if event == "delivered":
            here = self.trace.sessions[self.session] if self.session >= 0 else ""
            if not self.plant.may_lack(here, self.k):  # else its report may be lost there
                self.delivered.append(payload)
            if self.gaps and name not in self.known:
                self.known[name] = payload
                self.untold.add(payload)
            elif self.known.get(name) != payload:
                self.wrong.append(
                    f"message {name} counts as delivered, and was not queued like that"
                )
            return
        self.latest = name
        if name in self.doubtful:
            self.void.add(self.doubtful.pop(name))
        elif name in self.known:
            # a controller that lost its journal is handed its messages again
            if not self.restarted:
                self.wrong.append(f"message {name} was queued twice without a restart")
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


def _in_order(e: Evidence, controller: Trace, received: list[WholeFrame]) -> Findings:
    """The recovered messages are the queued ones, in order, and those that were delivered."""
    assert e.plant is not None
    queue = Queue(controller, e.plant)
    for row, item in controller.walk("session", "k"):
        queue.take(row, item)
    journal = e.journals["controller"]
    waiting = journal.waiting if isinstance(journal, JournalState) else ()
    if queue.gaps:
        queue.untold |= {text for name, text in waiting if (name, text) not in queue.told}
    arrived = {frame.payload for frame in received}
    for payload in queue.delivered:
        if payload not in arrived:
            queue.wrong.append(f"{payload!r} counts as delivered, the plant has not recovered it")
    places, session = {-1}, ""  # of the last that was recovered: messages may be alike
    for frame in received:
        allowed = set().union(*map(queue.following, places))
        if frame.session != session:
            allowed |= places  # received, but the session ended before the controller knew
        session = frame.session
        told = queue.told
        if frame.after_loss:  # others may have been recovered meanwhile
            allowed |= places | set(range(min(places) + 1, len(told)))
        fits = {i for i in allowed if 0 <= i < len(told) and told[i][1] == frame.payload}
        if frame.payload in queue.untold or controller.may_lack(frame.session, frame.k):
            fits |= {g - 1 for g in queue.gaps if g > min(places)}  # queued in what is lost
        if fits:
            places = fits
        else:
            text = f"recovered {frame.payload!r}, which is not the next queued message"
            yield Finding("messages", frame.session, frame.k, text)
    if isinstance(journal, JournalState):
        for message in () if queue.gaps else waiting:
            if message not in queue.told:
                text = f"message {message[0]} is in the controller's journal, not in its trace"
                queue.wrong.append(text)
        newest = queue.newest
        if newest and not controller.behind and journal.newest not in (newest, *queue.doubtful):
            text = f"message {newest} was queued last, the controller's journal has "
            queue.wrong.append(f"{text}{journal.newest or 'none'}")
    for text in queue.wrong:
        yield Finding("messages", "", -1, text)
