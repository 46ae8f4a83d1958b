"""Lives of a file of JSON lines: its marks compared with the lines between them."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from runtime.recording import (
    CONTINUED,
    END,
    HEADER,
    TRACE_FORMAT,
    TRACE_VERSION,
    decode,
    raw_lines,
)

HEADS: Final = {"format": TRACE_FORMAT, "version": TRACE_VERSION}


class Problem(NamedTuple):
    """A line that cannot be what it says it is, or stands where it cannot."""

    where: str
    text: str


class Line(NamedTuple):
    """A line of a recording; ``value`` is None where it was not decoded."""

    number: int
    raw: bytes
    value: dict[str, Any] | None


def _unknown(_raw: bytes) -> bool:
    return False


class Segments:
    """The lives of one file, known once :meth:`read` has gone through it.

    Attributes
    ----------
    problems : list of Problem
        What does not fit.
    ended : bool
        Whether the writer ended it by itself.
    next : object
        The part that its end mark says will follow.
    followed : bool
        Whether the writer before its last one ended it by itself.
    torn : int
        Lines cut short by a kill.
    """

    def __init__(self, name: str) -> None:
        self.problems: list[Problem] = []
        self.ended = False
        self.next: Any = None
        self.followed = False
        self.torn = 0
        self._lives = 0
        self._name = name
        self._begin()

    def _begin(self) -> None:
        self._count = 0
        self._digest = hashlib.sha256()
        self._malformed = 0

    def read(self, path: Path, known: Callable[[bytes], bool] = _unknown) -> Iterator[Line]:
        """Its lines, marks among them, without those that hold no JSON object.

        What is ``known`` to be a whole line of the writer's, and no mark, is not decoded.
        """
        newline = True
        for number, raw, finished in raw_lines(path):
            newline = finished
            if known(raw):
                self._line(number, raw)
                yield Line(number, raw, None)
                continue
            value = decode(raw)
            if value is None:
                self._not_torn()
                self._malformed = number  # torn by a kill, if it is its writer's last
                continue
            if value.get("event") in (HEADER, CONTINUED, END):
                self._mark(number, raw, value)
            else:
                self._line(number, raw)
            yield Line(number, raw, value)
        if newline:
            self._not_torn()
        else:
            self.ended = False
        self._close()

    def _line(self, number: int, raw: bytes) -> None:
        """A line that is no mark."""
        if self.ended:
            self.problem(number, "a line after the end mark")
            self.ended = False
        self._headless(number)
        self._not_torn()
        self._count += 1
        self._digest.update(raw)
        self._digest.update(b"\n")

    def _not_torn(self) -> None:
        """More follows: a line before it that holds no JSON object was not torn by a kill."""
        if self._malformed:
            self.problem(self._malformed, "not a JSON object")
            self._malformed = 0

    def _mark(self, number: int, raw: bytes, value: dict[str, Any]) -> None:
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
        elif self._lives:
            self.problem(number, "a second header")
        if self._lives:
            self._close()
        self._lives += 1
        self._begin()
        self.followed = self.ended and self.next is None
        self.ended, self.next = False, None
        self._line(number, raw)

    def _close(self) -> None:
        self.torn += bool(self._malformed)

    def _headless(self, number: int) -> None:
        if not self._lives:
            self.problem(number, f"expected a header of format {TRACE_FORMAT!r}")
            self._lives = 1

    def problem(self, number: int, text: str) -> None:
        """Note that line ``number`` cannot be so."""
        self.problems.append(Problem(f"{self._name} line {number}", text))
