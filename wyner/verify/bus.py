"""The field bus's clauses: nothing secret, and nothing that tells the two states apart."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, Final

from pydantic import ValidationError

from protocol.messages import Measurement, Offer
from wyner.verify.clause import Tally, need
from wyner.verify.evidence import Evidence, Seen

PUBLIC: Final[dict[str, frozenset[str]]] = {
    "measurement": frozenset(
        {"v", "session", "k", "x", "applied_k", "x_after"}
        | {"copy_number", "nonce", "applied_copy", "block", "tag"}
    ),
    "offer": frozenset(
        {"v", "session", "k", "candidates", "cipher"}
        | {"copy_number", "nonce", "heard", "block", "tag"}
    ),
}
"""The field bus's messages and all their fields, written out here so that adding one to the message
types is noticed."""

_MODELS: Final[dict[str, type[Measurement] | type[Offer]]] = {
    "measurement": Measurement,
    "offer": Offer,
}


def same_answer(e: Evidence, tally: Tally) -> None:
    """A measurement and an offer of one number never change (rules 1 and 2)."""
    if not need(tally, capture=e.wire):
        return
    assert e.wire is not None
    if e.wire.blurred:
        tally.skipped = "the tap saw numbers blurred, by its own settings"
        return
    first: dict[tuple[str, str, int], Seen] = {}
    repeated = {"measurement": 0, "offer": 0}
    for seen in e.wire.seen:
        at = (seen.topic, seen.session, seen.k)
        earlier = first.setdefault(at, seen)
        if earlier is not seen and seen.topic in repeated:
            repeated[seen.topic] += 1
        text = f"{seen.where}: {seen.topic} {seen.k} differs from the first of that number"
        tally.count(earlier.raw == seen.raw, seen.session, -1, seen.k, text)
    tally.note = f"{repeated['measurement']} measurements and {repeated['offer']} offers repeated"


def wire(e: Evidence, tally: Tally) -> None:
    """The captured numbers are the plant's own."""
    if not need(tally, capture=e.wire, plant_trace=e.plant):
        return
    assert e.wire is not None
    assert e.plant is not None
    if e.wire.blurred:
        tally.skipped = "the tap saw numbers blurred, by its own settings"
        return
    by_k = {(t.session, t.k): t for t in e.plant.transitions}
    for seen in e.wire.seen:
        m = seen.message
        t = by_k.get((seen.session, seen.k))
        if t is not None:
            mine: Mapping[str, Any] = (
                {"x": t.x}
                if seen.topic == "measurement"
                else {"candidates": t.candidates, "cipher": t.cipher}
            )
            unlike = [n for n, v in mine.items() if _tuples(m.get(n)) != v]
            text = f"{seen.where}: {', '.join(unlike)} unlike the plant's trace"
            tally.count(not unlike, seen.session, t.j, t.k, text)
        applied = by_k.get((seen.session, m.get("applied_k", -1)))
        if applied is not None and _tuples(m.get("x_after")) != applied.x_next:
            text = f"{seen.where}: x_after is not where the applied offer led"
            tally.fail(seen.session, applied.j, applied.k, text)


def _tuples(value: object) -> object:
    if isinstance(value, list):
        return tuple(_tuples(v) for v in value)
    return value


def public_fields(e: Evidence, tally: Tally) -> None:
    """Only the two public messages, with exactly their public fields."""
    if not need(tally, capture=e.wire):
        return
    assert e.wire is not None
    for problem in e.wire.strange:
        text = f"{problem.where}: neither Measurement nor Offer ({problem.text})"
        tally.count(False, "", -1, -1, text)
    size, m, n = e.rules.size, e.rules.inputs, e.rules.states
    for seen in e.wire.seen:
        where = (seen.session, -1, seen.k)
        allowed = PUBLIC.get(seen.topic)
        if allowed is None:
            tally.count(False, *where, f"{seen.where}: on {seen.topic!r}")
            continue
        content = seen.message
        fields = frozenset(content)
        text = f"{seen.where}: {seen.topic} with {_unlike(fields, allowed)}"
        if not tally.count(fields == allowed, *where, text):
            continue
        try:
            message = _MODELS[seen.topic].model_validate(content)
        except ValidationError as error:
            at = ".".join(str(p) for p in error.errors(include_url=False)[0]["loc"])
            tally.fail(*where, f"{seen.where}: {seen.topic}.{at} is not as expected")
            continue
        if isinstance(message, Measurement):
            fits = len(message.x) == n and len(message.x_after) == (message.applied_k >= 0) * n
        else:
            fits = len(message.candidates) == size and message.cipher < size
            fits = fits and all(len(u) == m for u in message.candidates)
        if not fits:
            tally.fail(*where, f"{seen.where}: {seen.topic} is not of this plant's shape")
    tally.note = f"{e.wire.torn} torn lines"


def _unlike(fields: frozenset[str], allowed: frozenset[str]) -> str:
    extra, lacking = sorted(fields - allowed), sorted(allowed - fields)
    words = [f"the extra field {name}" for name in extra] + [f"no {name}" for name in lacking]
    return ", ".join(words)


@dataclass(slots=True)
class _Looks:
    """What messages of one kind looked like in one automaton state."""

    shapes: dict[object, Seen] = field(default_factory=dict)
    sizes: list[int] = field(default_factory=list)


def _shape(value: object) -> object:
    """Names, lengths and kinds of number, without the numbers."""
    if isinstance(value, dict):
        return tuple((name, _shape(v)) for name, v in value.items())
    if isinstance(value, list):
        return tuple(_shape(v) for v in value)
    return "number" if isinstance(value, int | float) else type(value).__name__


def same_shape(e: Evidence, tally: Tally) -> None:
    """Fields, lengths and kinds of number do not depend on the automaton state."""
    if not need(tally, capture=e.wire, plant_trace=e.plant):
        return
    assert e.wire is not None
    assert e.plant is not None
    roles = {(t.session, t.k): t for t in e.plant.transitions}
    looks: dict[tuple[str, str], _Looks] = {}
    for seen in e.wire.seen:
        t = roles.get((seen.session, seen.k))
        if t is None:
            continue
        content = seen.message
        if content.get("applied_k") == -1:
            continue  # a session's first measurement has no x_after yet, in state 1 always
        look = looks.setdefault((seen.topic, t.role), _Looks())
        look.shapes.setdefault(_shape(content), seen)
        look.sizes.append(len(seen.raw))
        tally.counted += 1
    notes = []
    for topic in PUBLIC:
        test, message = looks.get((topic, "test")), looks.get((topic, "message"))
        if test is None or message is None:
            continue
        for shape, seen in message.shapes.items():
            if shape not in test.shapes:
                text = f"{seen.where}: {topic} looks like this in state 2 only"
                tally.fail(seen.session, roles[seen.session, seen.k].j, seen.k, text)
        for shape, seen in test.shapes.items():
            if shape not in message.shapes:
                text = f"{seen.where}: {topic} looks like this in state 1 only"
                tally.fail(seen.session, roles[seen.session, seen.k].j, seen.k, text)
        notes.append(f"{topic} {fmean(test.sizes):.1f} and {fmean(message.sizes):.1f} bytes")
    tally.note = f"mean in states 1 and 2: {'; '.join(notes)}" if notes else ""
