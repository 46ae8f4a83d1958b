"""What a plant's trace adds up to, line by line, in a few bytes a step."""

import base64
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from protocol.agreement import NO_SYMBOL
from protocol.link.events import NEW_JOURNAL


class StepCount:
    """Counts the plant's steps in its trace: each once, whichever journal it was kept in.

    A process that dies may trace its last two steps once more. One that lost its journal, or got
    an older copy of it, begins again at a number that was there before: time has gone on.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last = -1

    def take(self, event: Mapping[str, Any]) -> None:
        """Take the next line."""
        if event["event"] == "session" and event["reason"] == NEW_JOURNAL:
            self._last = -1
        elif event["event"] in ("transition", "missed", "interrupted"):
            k = event["k"]
            if k > self._last or k < self._last - 1:
                self.count += 1
                self._last = k


@dataclass(slots=True)
class PlantCounts:
    """Counts of a plant's trace; what a killed plant wrote a second time counts once.

    Parameters
    ----------
    recovered : list of (int, bytes)
        Each message that was whole, with the step at which it was.
    """

    recovered: list[tuple[int, bytes]] = field(default_factory=list)
    _made: StepCount = field(default_factory=StepCount)
    _last_k: int = -1
    _rows: dict[str, "_Rows"] = field(default_factory=dict)

    def take(self, event: Mapping[str, Any]) -> None:
        """Take the next line."""
        kind = event["event"]
        self._made.take(event)
        if kind == "transition":
            self._last_k = int(event["k"])
            rows = self._rows.setdefault(str(event["session"]), _Rows())
            wrong = event["symbol"] not in (NO_SYMBOL, event["coin"])
            rows.put(
                int(event["j"]),
                1
                | (event["symbol"] != NO_SYMBOL) << 1
                | wrong << 2
                | (event["message_symbol"] != NO_SYMBOL) << 3,
            )
        elif kind == "recovered":
            self.recovered.append((self._last_k, base64.b64decode(event["payload"])))

    @property
    def steps(self) -> int:
        """Steps that were made, missed ones included, by every journal that the plant had."""
        return self._made.count

    @property
    def missed(self) -> int:
        """Steps without a counted offer."""
        return self.steps - self.transitions

    @property
    def transitions(self) -> int:
        """Transitions."""
        return self._with(1)

    @property
    def agreements(self) -> int:
        """Transitions that agreed a key symbol."""
        return self._with(2)

    @property
    def symbol_errors(self) -> int:
        """Agreements on another symbol than the coin."""
        return self._with(4)

    @property
    def message_symbols(self) -> int:
        """Transitions that carried a message symbol."""
        return self._with(8)

    def _with(self, bit: int) -> int:
        return sum(rows.with_bit(bit) for rows in self._rows.values())


class _Rows:
    """What became of a session's transitions, by number: a byte each, in which bits are set."""

    def __init__(self) -> None:
        self._bits = array("B")

    def put(self, j: int, bits: int) -> None:
        if j >= len(self._bits):
            self._bits.extend(bytes(j + 1 - len(self._bits)))
        self._bits[j] = bits

    def with_bit(self, bit: int) -> int:
        return sum(self._bits.count(value) for value in range(16) if value & bit)


def exchanged(sent: list[bytes], recovered: list[tuple[int, bytes]]) -> list[tuple[bytes, int]]:
    """Each message that was sent, in order, with the step at which the plant had it; -1 never.

    What came a second time, after a journal was lost, is the same message.
    """
    place = 0
    found = [(payload, -1) for payload in sent]
    for k, payload in recovered:
        at = next((i for i in range(place, len(sent)) if sent[i] == payload), None)
        if at is not None:
            found[at] = (payload, k)
            place = at + 1
    return found
