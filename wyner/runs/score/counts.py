"""What a plant's trace adds up to, line by line."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from protocol.agreement import NO_SYMBOL


@dataclass(slots=True)
class PlantCounts:
    """Counts of a plant's trace, of the events that count (:meth:`wyner.runs.run.Run.feed`).

    Parameters
    ----------
    steps : int
        Steps that were made, missed ones included, by every journal that the plant had.
    transitions : int
    agreements : int
        Transitions that agreed a key symbol.
    symbol_errors : int
        Agreements on another symbol than the coin.
    message_symbols : int
        Transitions that carried a message symbol.
    recovered : list of (int, bytes)
        Each message that was whole, with the step at which it was.
    """

    steps: int = 0
    transitions: int = 0
    agreements: int = 0
    symbol_errors: int = 0
    message_symbols: int = 0
    recovered: list[tuple[int, bytes]] = field(default_factory=list)
    _last_k: int = -1

    def take(self, event: Mapping[str, Any]) -> None:
        """Take the next event."""
        kind = event["event"]
        if kind == "transition":
            symbol, coin, carried = event["symbol"], event["coin"], event["message_symbol"]
            self._last_k = int(event["k"])
            self.steps += 1
            self.transitions += 1
            self.agreements += symbol != NO_SYMBOL
            self.symbol_errors += symbol not in (NO_SYMBOL, coin)
            self.message_symbols += carried != NO_SYMBOL
        elif kind in ("missed", "interrupted"):
            self.steps += 1
        elif kind == "recovered":
            self.recovered.append((self._last_k, base64.b64decode(event["payload"])))


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
