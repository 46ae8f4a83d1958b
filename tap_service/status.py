"""From what an eavesdropper believes to what is published and kept of it."""

import base64
from collections.abc import Iterator, Mapping
from typing import Any, Final

from pydantic_core import to_json

from protocol.messages import TapStatus
from protocol.text import printable, readable
from tap_service.eavesdroppers.base import Belief, KeysHeld
from tap_service.listening import Listener, Listeners

Report = tuple[TapStatus, dict[str, Any]]
"""What one of them believes: as published, and as kept in ``beliefs.json``."""

SHOWN_TEXT: Final = 2000
"""Characters of a message that a status shows."""

UNUSED: Final = ("foreign", "late", "jumped", "dropped", "malformed", "restarts")
"""What a status counts of all that the tap heard and could not use."""

NO_COUNTS: Final = dict.fromkeys(("seq", "t_ns", "mirrored", "dropped", "behind", "malformed"), 0)
"""The counts that a status must have."""


def reports_of(listeners: Listeners, *, behind: int, last: bool) -> Iterator[Report]:
    """What each eavesdropper believes, as it is published and as it is kept.

    They are asked for the message symbols at the ``last`` alone; before they are None, and so they
    are of one who failed. ``behind`` steps they have not heard yet.
    """
    counts = {"behind": behind, **listeners.transcript.unused._asdict()}
    for listener in listeners.listeners:
        yield report_of(listeners.session, listener, NO_COUNTS | counts, last=last)


def report_of(
    session: str, listener: Listener, counts: Mapping[str, int] = NO_COUNTS, *, last: bool
) -> Report:
    """What one eavesdropper believes; see :func:`reports_of`."""
    belief = listener.belief()
    symbols = listener.message_symbols() if last else None
    tail = list(listener.tail)
    status = TapStatus(
        name=listener.name,
        steps=listener.steps,
        lost=listener.holes,
        message=readable(belief.message)[:SHOWN_TEXT],
        confidence=belief.confidence,
        candidates_left=belief.candidates_left,
        solved_k=belief.solved_k,
        bits_left=belief.bits_left,
        given=belief.given,
        failed=printable(listener.failed)[:SHOWN_TEXT],
        A=belief.A,
        B=belief.B,
        **_of_keys(belief.keys),
        tail_k=tuple(g.k for g in tail),
        tail_symbol=tuple(g.best for g in tail),
        tail_probability=tuple(max(g.symbol) for g in tail),
        tail_agreed=tuple(g.agreed for g in tail),
        **counts,
    )
    return status, _record(session, status, belief, symbols)


def absent(name: str) -> Report:
    """The report of one who has not said anything yet."""
    belief = Belief()
    status = TapStatus(
        name=name,
        steps=0,
        lost=0,
        message="",
        confidence=0.0,
        candidates_left=0,
        solved_k=-1,
        **NO_COUNTS,
    )
    return status, _record("", status, belief, None)


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
        "confidence": belief.confidence,
        "candidates_left": belief.candidates_left,
        "solved_k": belief.solved_k,
        "bits_left": belief.bits_left,
        "given": belief.given,
        "symbols": symbols,
        "A": belief.A,
        "B": belief.B,
        "keys": None if belief.keys is None else belief.keys.model_dump(),
        **facts_of(status),
    }


def facts_of(status: TapStatus) -> dict[str, Any]:
    """What a record says of the tap, and of how the eavesdropper fares in it."""
    return {
        "failed": status.failed,
        "behind": status.behind,
        "unused": {name: getattr(status, name) for name in UNUSED},
    }


def _of_keys(keys: KeysHeld | None) -> dict[str, Any]:
    """The status's fields of keys, of one who attacks them."""
    if keys is None:
        return {}
    return {
        "key_blocks": keys.blocks,
        "key_bits_held": keys.bits,
        "copies": keys.copies,
        "copies_missed": keys.missed,
        "missed_at_most": keys.at_most,
        "missed_direction": keys.direction,
        "copies_absent": keys.absent,
        "key_steps_unplaced": keys.unplaced,
        "claim_refuted": keys.refuted,
        "misses_in_bursts": keys.bursts,
    }


def beliefs_json(records: Mapping[str, dict[str, Any]]) -> bytes:
    """The content of ``beliefs.json``: one record an eavesdropper, by name."""
    return to_json(dict(records), inf_nan_mode="strings") + b"\n"
