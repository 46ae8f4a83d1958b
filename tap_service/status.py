"""From what an eavesdropper believes to what is published and kept of it."""

import base64
from collections.abc import Iterator, Mapping
from typing import Any, Final

from pydantic_core import to_json

from protocol.messages import TapStatus
from protocol.messages.adversary import BeliefStatus, TailGuess, UnusedStatus
from protocol.text import printable, readable
from tap_service.eavesdroppers.base import Belief
from tap_service.listening import Listener, Listeners

Report = tuple[TapStatus, dict[str, Any]]
"""What one of them believes: as published, and as kept in ``beliefs.json``."""

SHOWN_TEXT: Final = 2000
"""Characters of a message that a status shows."""

NOTHING_UNUSED: Final = UnusedStatus()


def reports_of(listeners: Listeners, *, behind: int, last: bool) -> Iterator[Report]:
    """What each eavesdropper believes, as it is published and as it is kept.

    They are asked for the message symbols at the ``last`` alone; before they are None, and so they
    are of one who failed. ``behind`` steps they have not heard yet.
    """
    unused = UnusedStatus(**listeners.transcript.unused._asdict())
    for listener in listeners.listeners:
        yield report_of(listeners.session, listener, unused, behind, last=last)


def report_of(
    session: str,
    listener: Listener,
    unused: UnusedStatus = NOTHING_UNUSED,
    behind: int = 0,
    *,
    last: bool,
) -> Report:
    """What one eavesdropper believes; see :func:`reports_of`."""
    belief = listener.belief()
    symbols = listener.message_symbols() if last else None
    keys = belief.keys
    if keys is not None:
        keys = keys.model_copy(update={"newest": ()})  # for the record
    status = TapStatus(
        name=listener.name,
        steps=listener.steps,
        lost=listener.holes,
        behind=behind,
        failed=printable(listener.failed)[:SHOWN_TEXT],
        unused=unused,
        belief=BeliefStatus(
            message=readable(belief.message)[:SHOWN_TEXT],
            confidence=belief.confidence,
            candidates_left=belief.candidates_left,
            solved_k=belief.solved_k,
            bits_left=belief.bits_left,
            given=belief.given,
            A=belief.A,
            B=belief.B,
        ),
        keys=keys,
        tail=tuple(TailGuess(g.k, g.best, max(g.symbol), g.agreed) for g in listener.tail),
    )
    return status, _record(session, status, belief, symbols)


def absent(name: str) -> Report:
    """The report of one who has not said anything yet."""
    status = TapStatus(name=name)
    return status, _record("", status, Belief(), None)


def _record(
    session: str, status: TapStatus, belief: Belief, symbols: list[tuple[int, int]] | None
) -> dict[str, Any]:
    """One belief as it is written to ``beliefs.json``; payloads as base64."""
    return {
        "name": status.name,
        "session": session,
        "steps": status.steps,
        "message": base64.b64encode(belief.message).decode("ascii"),
        "whole": [base64.b64encode(w).decode("ascii") for w in belief.whole],
        "whole_count": belief.whole_count,
        **status.belief.model_dump(exclude={"message"}),
        "symbols": symbols,
        "keys": None if belief.keys is None else belief.keys.model_dump(),
        **facts_of(status),
    }


def facts_of(status: TapStatus) -> dict[str, Any]:
    """What a record says of the tap, and of how the eavesdropper fares in it."""
    return {
        "failed": status.failed,
        "behind": status.behind,
        "unused": status.unused.model_dump(),
    }


def beliefs_json(records: Mapping[str, dict[str, Any]]) -> bytes:
    """The content of ``beliefs.json``: one record an eavesdropper, by name."""
    return to_json(dict(records), inf_nan_mode="strings") + b"\n"
