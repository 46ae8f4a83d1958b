"""Messages: what the symbols add up to, what each end reported of it, and the queue."""

from typing import Final, NamedTuple

from protocol.link.events import NEW_JOURNAL, PowerFailed, SessionBegan
from protocol.schemes.framing import Deframer
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.journals import JournalState
from wyner.runs.lines import Again, Break, OtherLine, QueuedLine
from wyner.runs.trace import Trace

REPORTS: Final = {"plant": "recovered", "controller": "delivered"}
"""What each side reports of a whole frame."""


def messages(e: Evidence) -> Findings:
    """Frames pass their check and are reported; what was recovered follows the queue."""
    framings = {trace.side: Framing(trace, e.rules.size) for trace in e.ends()}
    for framing in framings.values():
        yield from framing.wrong
    plant, journal = framings.get("plant"), e.journals["plant"]
    if plant is None:
        return
    if isinstance(journal, JournalState) and (text := _unlike_inbox(plant, journal)):
        yield Finding("messages", "", -1, text)
    if e.controller is not None and not (plant.trace.gone or e.controller.gone):
        yield from _in_order(e, Queue(e.controller), plant.received)


class WholeFrame(NamedTuple):
    """A frame that an end's symbols add up to; ``payload`` is None where its check failed.

    ``after_loss``: a power failure may have taken the frames before it.
    """

    payload: bytes | None
    session: str
    j: int
    k: int
    after_loss: bool


class Framing:
    """An end's symbols put together, and its reports compared with them.

    A report follows the transition that completed its frame, before either is in the journal. So
    where the end was killed in between, both come again; never where the journal was lost. Of a cut
    trace nothing is known until a report or another session says where a frame begins.

    Attributes
    ----------
    received : list of WholeFrame
        Those that passed their check.
    begun : int
        How many of them came before the end's journal began.
    lost : bool
        Whether the power failed since the last of them.
    """

    def __init__(self, trace: Trace, size: int) -> None:
        self.trace, self._size = trace, size
        self.wrong: list[Finding] = []
        self.received: list[WholeFrame] = []
        self.begun, self.lost = 0, False
        self._deframer, self._session, self._unknown = Deframer(size), -1, trace.gone > 0
        self._due: WholeFrame | None = None  # its report comes next
        self._last: WholeFrame | None = None
        self._killed = False  # since it was whole: its transition comes again
        for row, item in trace.walk("session", "j", "k", "message", "message_symbol"):
            if item is None:
                self._step(*row)
            elif isinstance(item, OtherLine):
                self._told(item)
            elif isinstance(item, Again):
                self._again(item.after.session, item.after.j)
            elif item.ended:
                self._overdue(sure=not self._killed)
            else:
                self._killed = True

    def _again(self, session: str, j: int) -> None:
        if self._last is not None and (self._last.session, self._last.j) == (session, j):
            self._due, self._killed = self._last, False

    def _step(self, session: int, j: int, k: int, message: bool, symbol: int) -> None:
        name = self.trace.sessions[session]
        goes_on = self._due is not None and self._due.session == name  # else it was lost, as may be
        self._overdue(sure=goes_on or not self._killed)
        if j < 0:
            return
        if session != self._session:
            self._unknown = self._unknown and self._session < 0
            self._session, self._deframer = session, Deframer(self._size)
        if self._unknown or not message or symbol < 0:
            return
        refused = self._deframer.refused
        payload = self._deframer.push(symbol)
        if payload is None and self._deframer.refused == refused:
            return
        self._due = self._last = WholeFrame(payload, name, j, k, self.lost)
        self._killed = False
        if payload is None:
            self._fail("a frame fails its check", self._last)
        else:
            self.received.append(self._last)
            self.lost = False

    def _told(self, item: OtherLine) -> None:
        if isinstance(item.line, SessionBegan) and item.line.reason == NEW_JOURNAL:
            self.begun = len(self.received)
        self.lost = self.lost or isinstance(item.line, PowerFailed)
        if item.event not in ("recovered", "refused", "delivered"):
            return
        due, self._due = None if self._killed else self._due, None
        if self._unknown or (item.again and self._last is None):
            self._unknown = False
        elif due is None:
            self._fail(f"{item.event} {item.payload!r}, which its symbols do not add up to there")
        elif item.event == "refused":
            self._fail("the plant refused a frame", due)
        elif due.payload != item.payload:
            text = f"{item.event} {item.payload!r}, its symbols add up to {due.payload!r}"
            self._fail(text, due)

    def _overdue(self, *, sure: bool) -> None:
        if self._due is not None and sure:
            self._fail(f"a whole frame, and nothing {REPORTS[self.trace.side]}", self._due)
        self._due = None

    def _fail(self, text: str, at: WholeFrame | None = None) -> None:
        session, k = ("", -1) if at is None else (at.session, at.k)
        self.wrong.append(Finding("messages", session, k, f"{self.trace.side}'s trace: {text}"))


def _unlike_inbox(plant: Framing, journal: JournalState) -> str:
    """In what the plant's journal has received other messages than its trace; empty: in nothing."""
    since, trace, counted = plant.received[plant.begun :], plant.trace, journal.messages
    if trace.behind:
        return ""  # put back from an older copy, it has lost what came since
    if journal.ahead >= 0 and len(since) == counted + 1:
        return ""  # the journal counts it with the step that it has saved
    if len(since) != counted and not trace.gone and not (trace.gaps and len(since) < counted):
        text = f"the plant's trace has {len(since)} messages since its journal began"
        return f"{text}, the journal counts {counted}"
    if since and since[-1].payload != journal.last and not plant.lost:
        text = f"the plant's trace ends with message {since[-1].payload!r}"
        return f"{text}, its journal with {journal.last!r}"
    return ""


class Queue:
    """The controller's messages, as its trace tells them.

    Attributes
    ----------
    told : list of (str, bytes)
        Identifier and text of each, in the order in which they were queued.
    untold : set of bytes
        Messages whose lines a power failure took.
    gaps, begins, void : set of int
        Places in ``told``: before which lines may be lost; at which a new journal began; and of
        messages that no journal had, so that they were queued again.
    doubtful : dict of int
        Places of messages that a killed process told last: they may be in no journal.
    wrong : list of str
    """

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        self.told: list[tuple[str, bytes]] = []
        self.untold: set[bytes] = set()
        self.gaps, self.begins, self.void = set[int](), set[int](), set[int]()
        self.doubtful: dict[str, int] = {}
        self.wrong: list[str] = []
        self._known: dict[str, bytes] = {}
        self._restarted, self._died = True, False  # since the last was queued; since the last step
        self._lost = False  # maybe the journal, since the last was queued
        session, latest = -1, ""
        for row, item in trace.walk("session"):
            line, newest = item.line if isinstance(item, OtherLine) else item, ""
            if line is None:  # the session goes on: so does the journal
                self._died = self._died and row[0] != session
                (session,) = row
            elif isinstance(line, Break):
                self._restarted = self._died = True
                if latest and not line.ended:
                    self.doubtful[latest] = len(self.told) - 1
            elif isinstance(line, SessionBegan):  # met by another process
                self._lost = self._lost or self._died
            elif isinstance(line, PowerFailed):
                self._lost = True
                self.gaps.add(len(self.told))
            elif isinstance(item, OtherLine) and isinstance(line, QueuedLine):
                if item.event == "delivered":
                    self._delivered(line.id, item.payload)
                else:
                    newest = line.id
                    self._sent(line.id, item.payload)
            latest = newest

    def _delivered(self, name: str, payload: bytes) -> None:
        if self.gaps and name not in self._known:
            self._known[name] = payload
            self.untold.add(payload)
        elif self._known.get(name) != payload:
            self.wrong.append(f"message {name} counts as delivered, and was not queued like that")

    def _sent(self, name: str, payload: bytes) -> None:
        if name in self.doubtful:
            self.void.add(self.doubtful.pop(name))
        elif name in self._known:  # a controller that lost its journal is handed them again
            if not self._restarted:
                self.wrong.append(f"message {name} was queued twice without a restart")
            self.begins.add(len(self.told))
            self._known = {}
        self._restarted = self._died = self._lost = False
        self._known[name] = payload
        self.told.append((name, payload))

    @property
    def newest(self) -> str:
        """The message that the journal must have as its last; empty where that cannot be told."""
        unsure = self.void.union(self.doubtful.values())
        sure = [name for at, (name, _) in enumerate(self.told) if at not in unsure]
        return "" if self._lost or not sure else sure[-1]

    def following(self, place: int) -> set[int]:
        """Places of the messages that may come after the one at ``place``."""
        found, doubtful = {b for b in self.begins if b > place}, self.doubtful.values()
        for at in range(place + 1, len(self.told)):
            if at not in self.void:
                found.add(at)
                if at not in doubtful:
                    break
        return found


def _in_order(e: Evidence, queue: Queue, received: list[WholeFrame]) -> Findings:
    """The recovered messages are the queued ones, in order."""
    told, trace, wrong, journal = queue.told, queue.trace, queue.wrong, e.journals["controller"]
    waiting = journal.waiting if isinstance(journal, JournalState) else ()
    untold = [message for message in waiting if message not in told]
    if queue.gaps:
        queue.untold.update(text for _, text in untold)
    else:
        text = "is in the controller's journal, not in its trace"
        wrong += [f"message {name} {text}" for name, _ in untold]
    places, session = {-1}, ""  # of the last that was recovered: messages may be alike
    for frame in received:
        allowed = set().union(*map(queue.following, places))
        if frame.after_loss:  # others may have been recovered meanwhile
            allowed |= set(range(min(places) + 1, len(told)))
        if frame.after_loss or frame.session != session:
            allowed |= places  # received, but the session ended before the controller knew
        session = frame.session
        fits = {i for i in allowed if i >= 0 and told[i][1] == frame.payload}
        if frame.payload in queue.untold or trace.may_lack(frame.session, frame.k):
            fits |= {g - 1 for g in queue.gaps if g > min(places)}  # queued in what is lost
        if not fits:
            text = f"recovered {frame.payload!r}, which is not the next queued message"
            yield Finding("messages", frame.session, frame.k, text)
        places = fits or places
    if isinstance(journal, JournalState) and queue.newest and not trace.behind:
        last = journal.newest
        if last != queue.newest and last not in queue.doubtful:
            text = f"message {queue.newest} was queued last"
            wrong.append(f"{text}, the controller's journal has {last or 'none'}")
    for text in wrong:
        yield Finding("messages", "", -1, text)
