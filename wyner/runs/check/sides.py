"""One end's trace, read once from its beginning to its end, with what its journal adds."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError
from pydantic_core import to_json

from protocol.box_observer import Box, Estimate
from protocol.link.session import Rules
from runtime.recording import (
    CONTINUED,
    END,
    HEADER,
    REPORTS,
    TRACE_FORMAT,
    TRACE_VERSION,
    decode,
    number_of,
    parts_of,
    raw_lines,
)
from wyner.runs.check.journals import JournalState
from wyner.runs.check.records import (
    KINDS,
    Again,
    AttackLine,
    Break,
    Item,
    MissedLine,
    OtherLine,
    Problem,
    SessionLine,
    Shape,
    TracedTransition,
    Walked,
    payload_of,
    wrong,
)
from wyner.runs.resolve import Counts, Resolver

HEADS: Final = {"format": TRACE_FORMAT, "version": TRACE_VERSION}

_TRANSITION: Final = b'{"event":"transition",'


class Segments:
    """Lives of a file of JSON lines: their marks compared with the lines between them.

    Feed every line to :meth:`mark` or :meth:`line`; what does not fit is among ``problems``.
    """

    def __init__(self, name: str) -> None:
        self.problems: list[Problem] = []
        self.ended = False
        self.next: Any = None
        self.newline = True
        self.incarnations = 0
        self.unended = 0
        self.torn = 0
        self._name = name
        self._begin()

    def _begin(self) -> None:
        self._count = 0
        self._digest = hashlib.sha256()
        self._malformed = 0
        self._open = True

    def line(self, number: int, raw: bytes) -> None:
        """A line that is no mark."""
        if self.ended:
            self.problem(number, "a line after the end mark")
            self.ended = False
        self._headless(number)
        self._not_torn()
        self._count += 1
        self._digest.update(raw)
        self._digest.update(b"\n")

    def malformed(self, number: int) -> None:
        """A line that holds no JSON object: torn by a kill, if it is its writer's last."""
        self._not_torn()
        self._malformed = number

    def _not_torn(self) -> None:
        """More follows: a line before it that holds no JSON object was not torn by a kill."""
        if self._malformed:
            self.problem(self._malformed, "not a JSON object")
            self._malformed = 0

    def mark(self, number: int, raw: bytes, value: dict[str, Any]) -> None:
        """A header, an end mark, or the mark of a writer that came back."""
        kind = value["event"]
        if kind == END:
            self._not_torn()
            if self.ended:
                self.problem(number, "a second end mark")
            elif not isinstance(value.get("next", 0), int):
                self.problem(number, "next: expected the number of a part")
            elif value.get("lines") != self._count:
                text = f"the end mark counts {value.get('lines')} lines, there are {self._count}"
                self.problem(number, text)
            elif value.get("sha256") != self._digest.hexdigest():
                self.problem(number, "the lines before the end mark are not those it was made of")
            self.ended, self.next = True, value.get("next")
            return
        if kind != HEADER:
            self._headless(number)
        elif self.incarnations:
            self.problem(number, "a second header")
        if self.incarnations:
            self._close()
        self.incarnations += 1
        self._begin()
        self.ended, self.next = False, None
        self.line(number, raw)

    def _close(self) -> None:
        self.torn += bool(self._malformed)
        self.unended += not self.ended

    def _headless(self, number: int) -> None:
        if not self.incarnations:
            self.problem(number, f"expected a header of format {TRACE_FORMAT!r}")
            self.incarnations = 1

    def finish(self) -> None:
        """The file is over; ``newline`` says whether its last line was finished."""
        if self.newline:
            self._not_torn()
        self._close()

    def problem(self, number: int, text: str) -> None:
        """Note that line ``number`` cannot be so."""
        self.problems.append(Problem(f"{self._name} line {number}", text))


class SideReader:
    """One end's trace as a stream of items.

    Where its oldest parts are gone it is *cut*: what stands before its first transition that left
    the automaton in its initial state is read, and not given out, since nobody can tell what the
    scheme makes of it.

    Parameters
    ----------
    side : str
        ``plant`` or ``controller``.
    path : Path
        The trace's first part.
    rules : Rules
    journal : JournalState, optional
        The transition that it holds beyond the trace is the last item.

    Attributes
    ----------
    gone : int
        Parts that are gone, the oldest.
    of_last : int
        Transitions that its last incarnation has traced.
    attack : AttackLine, optional
        The attack on the plant, as its trace has named it.
    cut : TracedTransition, optional
        The transition after which a cut trace is given out, once it was found.
    """

    def __init__(self, side: str, path: Path, rules: Rules, journal: JournalState | None) -> None:
        self.side = side
        self.parts: list[Segments] = []
        self.header: dict[str, Any] = {}
        self.problems: list[Problem] = []
        self.overwritten = 0
        self.last: TracedTransition | None = None
        self.last_missed: MissedLine | None = None
        self.transitions: dict[str, int] = {}
        self.announced: set[str] = set()
        self.from_journal = False
        self.attack: AttackLine | None = None
        self._paths = parts_of(path)
        self.gone = number_of(self._paths[0])
        self.cut: TracedTransition | None = None
        self._seeking = self.gone > 0
        self._part = self._paths[0]
        self._rules = rules
        self._shape = Shape.of(rules)
        self._journal = journal
        self._kinds = KINDS[side]
        self._kept = 0  # the oldest part that was kept, as the newest header says
        self._session: str | None = None
        self._state: Any = None
        self._estimate: Estimate | None = None  # of the last transition, where outputs are read
        self._estimate_known = not self._seeking
        self._resolver = Resolver()
        self._announce = side == "plant" and not self._seeking
        self._held: MissedLine | None = None
        self.behind = 0
        self.of_last = 0

    @property
    def marks(self) -> Segments:
        """The marks of the part that is being read, or was read last."""
        return self.parts[-1]

    @property
    def ended(self) -> bool:
        """Whether the writer ended the trace by itself."""
        return self.marks.ended and self.marks.next is None

    def __iter__(self) -> Iterator[Item]:
        for path in self._paths:
            marks = Segments(path.name)
            if self.parts and self.marks.next != number_of(path):
                self.marks.problem(1, f"{path.name} follows, and no end mark leads there")
            self.parts.append(marks)
            self._part = path
            for number, raw, finished in raw_lines(path):
                marks.newline = finished
                yield from self._line(number, raw)
            marks.finish()
        if self.gone > self._kept:
            text = f"it begins with part {self.gone}, the writer had kept part {self._kept} as well"
            self.parts[0].problem(1, text)
        pending = None if self._journal is None else self._journal.pending
        if pending is not None:
            self._resolver.restart()
            yield from self._transition(0, to_json(pending))
        yield from self._flush()
        yield Break(self.ended)

    def problem(self, number: int, text: str) -> None:
        """Note that line ``number`` cannot be so."""
        where = f"{self._part.name} line {number}" if number else "the step in the journal"
        self.problems.append(Problem(where, text))

    def _line(self, number: int, raw: bytes) -> Iterator[Item]:
        if raw.startswith(_TRANSITION) and raw.endswith(b"}"):
            self.marks.line(number, raw)
            yield from self._transition(number, raw)
            return
        value = decode(raw)
        if value is None:
            self.marks.malformed(number)
            return
        kind = value.get("event")
        if kind in (HEADER, CONTINUED, END):
            ended = self.ended
            self.marks.mark(number, raw, value)
            if kind == HEADER:
                self._headed(number, value)
            elif kind == CONTINUED:
                yield Break(ended)
                self._resolver.restart()
                self._announce, self.of_last = self.side == "plant", 0
            return
        self.marks.line(number, raw)
        if kind == "transition":
            yield from self._transition(number, raw)
            return
        adapter = self._kinds.get(kind) if isinstance(kind, str) else None
        if adapter is None:
            self.problem(number, f"event: got {kind!r}, expected one of {', '.join(self._kinds)}")
            return
        try:
            line = adapter.validate_json(raw)
            if isinstance(line, MissedLine):
                if unlike := self._shape.unlike_missed(line):
                    raise ValueError(unlike)
                yield from self._missed(number, line)
                return
            told = OtherLine(line, payload_of(line))
            if kind in REPORTS:
                counts = self._resolver.report()
                if counts is Counts.BEHIND:
                    self.behind += 1
                    return
                again = counts is Counts.AGAIN
                told = told._replace(again=again)
                self.overwritten += again
        except ValidationError as error:
            self.problem(number, f"{kind}: {wrong(error)}")
            return
        except ValueError as error:
            self.problem(number, f"{kind}: {error}")
            return
        if isinstance(line, AttackLine):
            self.attack = line
        if isinstance(line, SessionLine):
            self._began(number, line)
        elif self._announce:
            self._unannounced(number)
        if not self._seeking:
            yield told

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
                self.problem(number, f"{name}: {said}")
        if not isinstance(oldest, int) or not 0 <= oldest <= part:
            self.problem(number, f"oldest: got {oldest!r}, expected 0 to {part}")
            oldest = 0
        self.header, self._kept = first, oldest

    def _began(self, number: int, line: SessionLine) -> None:
        if not self._announce and line.session is not None and line.session == self._session:
            self.problem(number, "session: announced already")
        self._announce = False
        self._session = line.session
        self._resolver.session(line.session)
        if line.session is not None:
            self.announced.add(line.session)

    def _unannounced(self, number: int) -> None:
        self.problem(number, "a plant that begins must name its session first")
        self._announce = False

    def _belongs(self, number: int, session: str) -> None:
        if self._announce:
            self._unannounced(number)
        elif session != self._session and not (self._seeking and self._session is None):
            self.problem(number, f"session: got {session!r}, announced was {self._session!r}")
        self._session = session

    def _transition(self, number: int, raw: bytes) -> Iterator[Item]:
        try:
            t: TracedTransition = self._kinds["transition"].validate_json(raw)
        except ValidationError as error:
            self.problem(number, f"transition: {wrong(error)}")
            return
        unlike = self._shape.unlike(t, plant=self.side == "plant")
        if unlike := unlike or self._rules.malformed_predictions(t.predictions).removeprefix(
            "offer."
        ):
            self.problem(number, f"transition: {unlike}")
            return
        if number:
            self._belongs(number, t.session)
        if self._seeking:
            self._seek(t)
            return
        last, restarted = self.last, self._resolver.restarted
        counts = self._resolver.transition(t.session, t.j, t.k, saved=not number)
        if counts is Counts.BEHIND:
            self.behind += 1
            return
        if counts is Counts.AGAIN:
            assert last is not None
            if not restarted:
                self.problem(number, f"transition {t.j} was written before, without a restart")
            elif number:
                self.overwritten += 1
                self._held = None  # a step missed after it, and never saved: it is made again
            yield Again(last, t, not number)
            return
        yield from self._flush(t.session, t.k, restarted=restarted)
        self.from_journal = not number
        self.of_last += bool(number)
        self.last = t
        rules = self._rules
        if t.session not in self.transitions:
            self._state = rules.scheme.initial
        self.transitions[t.session] = self.transitions.get(t.session, 0) + 1
        box = None if t.box is None else Box(*t.box)
        if rules.outputs is not None and self._estimate_known:
            assert box is not None
            estimate, missed = None, 0
            if last is not None and last.session == t.session:
                estimate, missed = self._estimate, t.k - last.k - 1
            if (expected := rules.outputs.box(estimate, missed, t.x)) != box:
                self.problem(number, f"box: got {t.box}, both ends have {tuple(expected)}")
                box = expected
        verdict = rules.judge(t.x, t.candidates, t.predictions, t.x_next, box)
        self._estimate, self._estimate_known = verdict.estimate, True
        self._state, carry = rules.scheme.advance(self._state, verdict.symbol)
        yield Walked(t, verdict, carry, self._state[0])

    def _seek(self, t: TracedTransition) -> None:
        self.last = t
        self._resolver.begin_after(t.session, t.j, t.k)
        self.transitions[t.session] = t.j + 1
        if t.s == self._rules.scheme.initial[0]:
            self.cut, self._state, self._seeking = t, self._rules.scheme.initial, False

    def _missed(self, number: int, step: MissedLine) -> Iterator[Item]:
        self._belongs(number, step.session)
        if self._seeking:
            self.last_missed = step
            return
        restarted = self._resolver.restarted
        if self._resolver.missed(step.session, step.k) is Counts.BEHIND:
            self.behind += 1
            return
        yield from self._flush(step.session, step.k, restarted=restarted)
        self._held = self.last_missed = step

    def _flush(self, session: str = "", k: int = -1, *, restarted: bool = False) -> Iterator[Item]:
        """A missed step that waited, unless a restart made step k another one."""
        held, self._held = self._held, None
        if held is None:
            return
        if restarted and (held.session, held.k) == (session, k):
            self.overwritten += 1
            return
        yield held
