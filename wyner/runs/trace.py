"""One end's trace in columns, read once from its first line to its last.

A row is a step: a transition, or at the plant one that was missed. A million of them take about
110 bytes each where the state has two numbers and the alphabet two symbols. What a kill leaves is
resolved here (:mod:`wyner.runs.resolve`); the few other lines are kept as they are, each with the
number of rows that came before it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import ValidationError

from protocol.link.events import MET, REASONS, RESUMED, PowerFailed, SessionBegan
from protocol.link.records import Side
from protocol.link.session import Rules
from runtime.recording import (
    CONTINUED,
    END,
    HEADER,
    REPORTS,
    TRACE_FORMAT,
    number_of,
    parts_of,
)
from wyner.runs.lines import (
    EVENTS,
    TRANSITION,
    Again,
    AttackLine,
    Break,
    EventLine,
    Item,
    MissedLine,
    OtherLine,
    Shape,
    TracedTransition,
    payload_of,
    read_line,
    read_transition,
    wrong,
)
from wyner.runs.marks import HEADS, Problem, Segments
from wyner.runs.resolve import Counts, Resolver

Rows = np.ndarray[Any, np.dtype[np.void]]
Indices = np.ndarray[Any, np.dtype[np.int64]]

AT_ONCE: Final = 4096
"""Rows that are looked at at a time."""

FILED: Final = 1024
"""Lines that are held until they become rows."""

HEADER_FIELDS: Final = frozenset(
    ("event", "part", "oldest", "format", "version", "vantage", "scenario", "fingerprint", "loop")
)


def _is_transition(raw: bytes) -> bool:
    return raw.startswith(b'{"event":"transition",') and raw.endswith(b"}")


class Note(NamedTuple):
    """What is no row of a trace, and how many rows came before it."""

    at: int
    item: Item


def columns(side: Side, rules: Rules, *, truth: bool) -> np.dtype[np.void]:
    """The columns of one end's trace.

    ``session`` is a number in :attr:`Trace.sessions`. Of a missed step ``j`` is -1. Where the key
    stream is used ``block`` and ``at`` are a position in it, -1 and 0 where there is none. Truth
    that nobody told is not a number.
    """
    n, m, size, hidden = Shape.of(rules)
    symbol = np.min_scalar_type(-size)
    chosen = "coin" if side == "plant" else "expected"
    fields: list[Any] = [("kind", "i1"), ("session", "i4"), ("j", "i4"), ("k", "i4")]
    fields += [("x", "f8", (n,)), ("candidates", "f8", (size, m)), ("x_next", "f8", (n,))]
    fields += [("gauges", "f8", (size,)), ("p", "i4"), ("s", "i4"), ("counts", "i1")]
    fields += [(name, symbol) for name in ("cipher", "symbol", "key", "message_symbol", chosen)]
    fields += [("message", "?"), ("keyed", "?")]
    if rules.digits:
        fields += [("block", "i4"), ("at", "i4")]
    if side == "plant":
        fields.append(("u", "f8", (m,)))
    if truth:
        fields += [("true_x", "f8", (hidden or n,)), ("true_u", "f8", (m,))]
    if rules.predicted:
        fields.append(("predictions", "f8", (size, n)))
    if hidden:
        fields.append(("box", "f8", (2, hidden)))
    return np.dtype(fields)


class Trace:
    """One end's trace.

    Where its oldest parts are gone it is *cut*: what stands before its first transition that left
    the automaton in its initial state is read, and is no row, since nobody can tell what the scheme
    makes of it.

    Parameters
    ----------
    side : {"plant", "controller"}
    path : Path
        The trace's first part.
    rules : Rules
    noisy : bool
        Whether the plant's sensors are, so that its trace tells the state as well.

    Attributes
    ----------
    rows : structured array
    sessions : list of str
    notes : list of Note
        Other lines, what was written twice, and where a process was over.
    problems : list of Problem
        Lines that cannot be so.
    readable : int
        Rows before the first of them.
    parts : list of Segments
        Each part's marks.
    header : dict
        The first part's.
    gone : int
        Parts that are gone, the oldest.
    cut : TracedTransition, optional
        The transition after which a cut trace is given out, once it was found.
    last : TracedTransition, optional
    attack : AttackLine, optional
        The attack on the plant.
    failed : str
        Why the attack was over before the run, as the last step says that tells it.
    of_last : int
        Transitions that its last process has traced.
    overwritten, behind : int
        Lines that were written again after a kill, and by an end that was put back.
    untraced : tuple of (str, int), optional
        Session and step of the transition that its journal holds, and a kill kept from the trace.
    gaps : set of int
        Rows before which lines may be lost: the machine lost its power there, and the end was not
        written. What the journal had still to count of the session that this ended is no row.
    """

    def __init__(
        self,
        side: Side,
        path: Path,
        rules: Rules,
        *,
        noisy: bool = False,
    ) -> None:
        self.side = side
        self.sessions: list[str] = []
        self.notes: list[Note] = []
        self.parts: list[Segments] = []
        self.header: dict[str, Any] = {}
        self.problems: list[Problem] = []
        self.readable, self._sure, self.failed = -1, 0, ""
        self.overwritten = self.behind = self.of_last = 0
        self.last: TracedTransition | None = None
        self.last_missed: MissedLine | None = None
        self.transitions: dict[str, int] = {}
        self.announced: set[str] = set()
        self.attack: AttackLine | None = None
        self.cut: TracedTransition | None = None
        self.untraced: tuple[str, int] | None = None
        self.gaps: set[int] = set()
        self._lost: set[str] = set()
        self._newest: dict[str, int] = {}
        self._mending, self._marked = False, 0
        paths = parts_of(path)
        self.gone = number_of(paths[0]) if paths else 0
        self._rules, self._shape, self._noisy = rules, Shape.of(rules), noisy
        self._seeking = self.gone > 0
        self._part, self._kept = path, 0
        self._session: str | None = None
        self._resolver = Resolver()
        self._announce, self._killed = side == "plant" and not self._seeking, False
        self._held: MissedLine | None = None
        self._dtype: np.dtype[np.void] | None = None
        self.rows: Rows = np.zeros(0, np.dtype([("kind", "i1")]))
        self._numbers = dict[str, int]()
        self._batch: list[TracedTransition | MissedLine] = []
        self._count = 0
        self._labelled: bool | None = None
        for one in paths:
            self._read(one)
        if self.gone > self._kept:
            text = f"it begins with part {self.gone}, the writer had kept part {self._kept} as well"
            self.parts[0].problem(1, text)
        self._flush()
        self._note(Break(self.ended))
        self._file()
        if self.readable < 0:
            self.readable, self._sure = len(self.rows), len(self.notes)

    @property
    def marks(self) -> Segments:
        """The marks of its last part."""
        return self.parts[-1]

    @property
    def ended(self) -> bool:
        """Whether the writer ended the trace by itself."""
        return bool(self.parts) and self.marks.ended and self.marks.next is None

    def chunks(self, only: int | None = None) -> Iterator[Rows]:
        """The rows, some at a time; ``only`` those of one kind."""
        for first in range(0, len(self.rows), AT_ONCE):
            rows = self.rows[first : first + AT_ONCE]
            yield rows if only is None else rows[rows["kind"] == only]

    def walk(self, *names: str) -> Iterator[tuple[tuple[Any, ...], Item | None]]:
        """All that it holds, in order: a row, as a tuple of these columns, or else a note."""
        at, notes = 0, iter(self.notes)
        note = next(notes, None)
        for rows in self.chunks():
            for row in zip(*(rows[name].tolist() for name in names), strict=True):
                while note is not None and note.at <= at:
                    yield (), note.item
                    note = next(notes, None)
                yield row, None
                at += 1
        while note is not None:
            yield (), note.item
            note = next(notes, None)

    def where(self, row: Any) -> tuple[str, int]:
        """Session and step of a row."""
        return self.sessions[row["session"]], int(row["k"])

    def told(self, *events: str) -> Iterator[OtherLine]:
        """The other lines that count, of these events."""
        for _, item in self.noted(*events):
            yield item

    def noted(self, *events: str) -> Iterator[tuple[int, OtherLine]]:
        """The same, each with the number of rows before it."""
        for at, item in self.notes[: self._sure]:
            if isinstance(item, OtherLine) and not item.again and item.event in events:
                yield at, item

    @property
    def steps(self) -> Rows:
        """The rows that its end has traced, up to the first line that cannot be so."""
        return self.rows[: self.readable]

    @property
    def unread(self) -> str:
        """Why it cannot be read from some line on; empty where it can."""
        if not self.header:
            return f"{self._part.name}: line 1: expected a header of format {TRACE_FORMAT!r}"
        where, text = self.problems[0] if self.problems else ("", "")
        return f"{where}: a line is not as expected: {text}" if where else ""

    def newest_k(self, at: int) -> int:
        """The step of the last transition among the first ``at`` rows; -1 where there is none."""
        for row in self.rows[:at][::-1]:
            if row["kind"] == TRANSITION:
                return int(row["k"])
        return -1

    def may_lack(self, session: str, k: int) -> bool:
        """Whether a kill or a power failure explains that it does not have step k: its end is lost.

        The session is one that a power failure ended, and k is beyond what is left of it; or the
        lines that named the session are lost as well.
        """
        if self.untraced is not None and session == self.untraced[0] and k >= self.untraced[1]:
            return True
        if session in self._lost:
            return k > self._newest.get(session, -1)
        return bool(self.gaps) and session not in self.announced and session not in self._newest

    def let_go(self) -> None:
        """Give the room of all rows back; only the rest is asked for from now on."""
        self.rows = self.rows[:0].copy()

    # --- reading ----------------------------------------------------------------------------------

    def _read(self, path: Path) -> None:
        marks = Segments(path.name)
        if self.parts and self.marks.next != number_of(path):
            marks.problem(1, f"{path.name} follows, and no end mark leads there")
        self.parts.append(marks)
        self._part = path
        for number, raw, value in marks.read(path, _is_transition):
            if value is None:
                self._transition(number, raw)
            else:
                self._line(number, raw, value)

    def _problem(self, number: int, text: str) -> None:
        self.problems.append(Problem(f"{self._part.name} line {number}", text))
        if self.readable < 0:
            self.readable, self._sure = self._count, len(self.notes)

    def _line(self, number: int, raw: bytes, value: dict[str, Any]) -> None:
        kind = value.get("event")
        if kind in (HEADER, CONTINUED, END):
            self._mark(number, value)
            return
        events = EVENTS[self.side]
        if kind == "transition":
            self._transition(number, raw)
        elif not isinstance(kind, str) or kind not in events:
            self._problem(number, f"event: got {kind!r}, expected one of {', '.join(events)}")
        else:
            try:
                self._other(number, kind, read_line(raw, value))
            except ValidationError as error:
                self._problem(number, f"{kind}: {wrong(error)}")
            except ValueError as error:
                self._problem(number, f"{kind}: {error}")

    def _mark(self, number: int, value: dict[str, Any]) -> None:
        self._marked, ended = number, self.marks.followed
        if value["event"] == HEADER:
            self._headed(number, value)
        elif value["event"] == CONTINUED:
            self._note(Break(ended))
            self._resolver.restart()
            self._mending = False
            self._announce, self.of_last, self._killed = self.side == "plant", 0, not ended

    def _other(self, number: int, event: str, line: EventLine | MissedLine) -> None:
        if isinstance(line, MissedLine):
            if unlike := self._shape.unlike_missed(line) or self._unlabelled(line):
                raise ValueError(unlike)
            self._missed(number, line)
            return
        if isinstance(line, PowerFailed):
            self._power_failed(number)
            return
        if self._mending and event not in ("session", "attack", "sent"):
            return
        told = OtherLine(event, line, payload_of(line))
        if event in REPORTS:
            counts = self._resolver.report()
            if counts is Counts.BEHIND:
                self.behind += 1
                return
            told = told._replace(again=counts is Counts.AGAIN)
            self.overwritten += told.again
        if isinstance(line, AttackLine):
            self.attack = line
        if isinstance(line, SessionBegan):
            self._began(number, line)
        elif self._announce:
            self._unannounced(number)
        if not self._seeking:
            self._note(told)

    def _power_failed(self, number: int) -> None:
        """The lines before this process's may be lost, unless the last of them is an end mark."""
        if number != self._marked + 1 or self.of_last:
            self._problem(number, "power_failed: expected where a process begins")
        elif self._killed and not self._seeking:
            self._flush()
            self._mending = True
            self.gaps.add(self._count)
            if self._session is not None:
                self._lost.add(self._session)
            self._note(OtherLine("power_failed", PowerFailed(), b""))

    def _note(self, item: Item) -> None:
        self.notes.append(Note(self._count, item))

    def _headed(self, number: int, header: dict[str, Any]) -> None:
        """A part's header: of this recording, and with this part's numbers."""
        part, oldest = number_of(self._part), header.get("oldest", 0)
        first = self.header or header
        expected = {**first, "part": part, "oldest": oldest, **HEADS}
        for name in sorted(expected.keys() | header.keys()):
            got, due = header.get(name, 0), expected.get(name, 0)
            if got != due:
                short = isinstance(got, int | str) and isinstance(due, int | str)
                said = f"got {got!r}, expected {due!r}" if short else "not as the first part's"
                self._problem(number, f"{name}: {said}")
        if strange := sorted(header.keys() - HEADER_FIELDS):
            self._problem(number, f"{strange[0]}: not in a trace's header")
        if not isinstance(oldest, int) or not 0 <= oldest <= part:
            self._problem(number, f"oldest: got {oldest!r}, expected 0 to {part}")
            oldest = 0
        self.header, self._kept = first, oldest

    def _began(self, number: int, line: SessionBegan) -> None:
        if not self._announce and line.session is not None and line.session == self._session:
            self._problem(number, "session: announced already")
        if line.reason not in REASONS[self.side]:
            self._problem(number, f"reason: got {line.reason!r}, expected one that there is")
        elif unlike := self._unlike(line):
            self._problem(number, f"reason: got {line.reason!r}, {unlike}")
        self._announce = False
        self._session = line.session
        if self._mending and line.reason == RESUMED and line.session is not None:
            self._lost.add(line.session)
        self._mending = self._mending and line.reason == RESUMED
        self._resolver.session(line.session)
        if line.session is not None:
            self.announced.add(line.session)

    def _unlike(self, line: SessionBegan) -> str:
        """What of a session's line cannot be for its reason."""
        if self.side == "controller":
            return "" if (line.reason == MET) == (line.session is not None) else "of no session"
        known = line.session in self.announced or line.session in self.transitions
        if line.reason == RESUMED:
            untold = self._killed and self._announce  # saved, and killed before it was traced
            return "" if known or untold or self._seeking else "and the session is a new one"
        return "and the session was there before" if known else ""

    def _unannounced(self, number: int) -> None:
        self._problem(number, "a plant that begins must name its session first")
        self._announce = False

    def _belongs(self, number: int, session: str) -> None:
        if self._announce:
            self._unannounced(number)
        elif session != self._session and not (self._seeking and self._session is None):
            self._problem(number, f"session: got {session!r}, announced was {self._session!r}")
        self._session = session

    def _unlabelled(self, step: TracedTransition | MissedLine) -> str:
        """A truth where none is told; empty where all is well."""
        told = step.true_x_next is not None and not self._truth
        return "a truth, and no attack on the plant" if told else ""

    @property
    def _truth(self) -> bool:
        """Whether its steps tell the truth beside what is said, which its beginning decides."""
        if self._labelled is not None:
            return self._labelled
        attacked = self.attack is not None and self.attack.at != "bus"
        return self.side == "plant" and (self._noisy or attacked)

    def _transition(self, number: int, raw: bytes) -> None:
        try:
            t: TracedTransition = read_transition(raw)
        except ValidationError as error:
            self._problem(number, f"transition: {wrong(error)}")
            return
        unlike = self._shape.unlike(t, plant=self.side == "plant") or self._unlabelled(t)
        if not unlike and bool(t.digits) > bool(self._rules.digits):
            unlike = "digits: expected none, as the key stream is not used"
        if not unlike and (t.predictions or self._rules.predicted):
            unlike = self._rules.malformed_predictions(t.predictions).removeprefix("offer.")
        if unlike:
            self._problem(number, f"transition: {unlike}")
            return
        if self._mending:
            return
        self._belongs(number, t.session)
        if self._seeking:
            self._seek(t)
            return
        last, restarted = self.last, self._resolver.restarted
        counts = self._resolver.transition(t.session, t.j, t.k)
        if counts is Counts.BEHIND:
            self.behind += 1
            return
        if counts is Counts.AGAIN:
            assert last is not None
            if not restarted:
                self._problem(number, f"transition {t.j} was written before, without a restart")
            else:
                self.overwritten += 1
                self._held = None  # a step missed after it, and never saved: it is made again
            self._note(Again(last, t))
            return
        self._flush(t.session, t.k, restarted=restarted)
        self.of_last += 1
        self.last = t
        self.transitions[t.session] = self.transitions.get(t.session, 0) + 1
        self._append(t)

    def _seek(self, t: TracedTransition) -> None:
        self.last = t
        self._resolver.begin_after(t.session, t.j, t.k)
        self.transitions[t.session] = t.j + 1
        if t.s == self._rules.scheme.initial[0]:
            self.cut, self._seeking = t, False

    def _missed(self, number: int, step: MissedLine) -> None:
        if self._mending:
            return
        self._belongs(number, step.session)
        if self._seeking:
            self.last_missed = step
            return
        restarted = self._resolver.restarted
        if self._resolver.missed(step.session, step.k) is Counts.BEHIND:
            self.behind += 1
            return
        self._flush(step.session, step.k, restarted=restarted)
        self._held = self.last_missed = step

    def _flush(self, session: str = "", k: int = -1, *, restarted: bool = False) -> None:
        """File a missed step that waited, unless a restart made step k another one."""
        held, self._held = self._held, None
        if held is None:
            return
        if restarted and (held.session, held.k) == (session, k):
            self.overwritten += 1
            return
        self._append(held)

    # --- filing -----------------------------------------------------------------------------------

    def _append(self, step: TracedTransition | MissedLine) -> None:
        self._count += 1
        self._newest[step.session] = step.k
        self._labelled = self._truth
        self.failed = step.attack_failed or self.failed
        self._batch.append(step)
        if len(self._batch) >= FILED:
            self._file()

    def _file(self) -> None:
        """Put the steps that wait into rows, which take no more room than they need."""
        if self._dtype is None:
            self._dtype = columns(self.side, self._rules, truth=self._truth)
            self.rows = np.zeros(0, self._dtype)
        before, steps = len(self.rows), self._batch
        if not steps:
            return
        self.rows.resize(before + len(steps), refcheck=False)
        rows = self.rows[before:]
        for name, (kind, *_) in (self._dtype.fields or {}).items():
            attribute, missing = _ATTRIBUTES.get(name, name), -1 if name in _NUMBERS else 0
            values: list[Any] = [getattr(step, attribute, missing) for step in steps]
            if name == "session":
                values = [
                    self._numbers.setdefault(session, len(self._numbers)) for session in values
                ]
            elif kind.shape:
                unknown = np.full(kind.shape, np.nan).tolist()
                values = [value or unknown for value in values]
            rows[name] = values
        self.sessions = list(self._numbers)
        self._batch.clear()


_ATTRIBUTES: Final = {"true_x": "true_x_next"}
"""What a column is called in a line, where it is called otherwise."""

_NUMBERS: Final = frozenset({"j", "cipher", "symbol", "key", "message_symbol", "block"})
"""Columns that are -1 in a step without a counted offer; others are 0 or not a number there."""


class Places:
    """Where the rows of a trace stand, by session and step or transition.

    Parameters
    ----------
    trace : Trace
    rows : structured array, optional
        Its :attr:`Trace.steps` by default.
    by : {"k", "j"}, optional
        Whether they are numbered by step, or by transition.
    """

    def __init__(self, trace: Trace, rows: Rows | None = None, by: Literal["k", "j"] = "k") -> None:
        rows = trace.steps if rows is None else rows
        self._sessions = {name: i for i, name in enumerate(trace.sessions)}
        keys = rows["session"].astype(np.int64)
        keys <<= 32
        keys |= rows[by]
        self._order = np.argsort(keys, kind="stable").astype(np.int32)
        self._keys = keys[self._order]

    def session(self, name: str) -> int:
        """A session's number; -1 of one that the trace does not have."""
        return self._sessions.get(name, -1)

    def all_of(self, sessions: Indices | int, numbers: Indices) -> Indices:
        """The row of each number, its session given as one, too; -1 where there is none."""
        if not len(self._keys):
            return np.full(len(numbers), -1)
        keys = np.int64(sessions) << 32 | np.maximum(numbers, 0)
        at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        there = (self._keys[at] == keys) & (np.int64(sessions) >= 0) & (numbers >= 0)
        return np.where(there, self._order[at], -1)

    def of(self, session: str, k: int) -> int:
        """The row of a step; -1 where there is none."""
        number = self.session(session)
        if number < 0 or k < 0:
            return -1
        at = int(np.searchsorted(self._keys, key := number << 32 | k))
        return int(self._order[at]) if at < len(self._keys) and self._keys[at] == key else -1
