"""What must hold of a simulated link under every schedule."""

from collections.abc import Iterator
from typing import Final

from protocol.secret.stream import Held, KeyStream, Position
from wyner.simulate.network import History

BEYOND: Final = Position(1 << 62, 0)


def violations(history: History, payloads: tuple[bytes, ...]) -> Iterator[str]:
    """What of the safety property does not hold, a line each.

    What the plant has recovered is a prefix of what was sent; both ends agree on every
    transition both have counted; no key symbol is used for two message symbols.
    """
    for at in history.rewritten:
        yield f"transition {at}: one side counted it in two versions"
    for at, mine in history.plant.items():
        theirs = history.controller.get(at)
        if theirs is not None and mine.shared != theirs.shared:
            yield f"transition {at}: plant {mine.shared}, controller {theirs.shared}"
    for session in {s for s, _ in history.controller}:
        counted = sorted(j for s, j in history.controller if s == session)
        if counted != list(range(len(counted))):
            yield f"session {session}: the controller counted {counted[:5]}..., with a gap"
    ciphers: dict[tuple[str, int], int] = {}
    for j, offer in history.offered:
        first = ciphers.setdefault((offer.session, j), offer.cipher)
        if first != offer.cipher:
            yield f"transition {offer.session}/{j}: cipher {first} and then {offer.cipher}"
    yield from out_of_order(history.inbox, payloads, again=history.amnesias > 0)


def out_of_order(inbox: list[bytes], payloads: tuple[bytes, ...], *, again: bool) -> Iterator[str]:
    """Messages must arrive in order, once each; where a journal was lost one may come again."""
    place = 0
    for payload in inbox:
        if place < len(payloads) and payload == payloads[place]:
            place += 1
        elif not (again and payload in payloads[:place]):
            yield f"message {payload!r} arrived, expected {payloads[place : place + 1]!r}"
            return


def first_held(held: Held) -> Position:
    """Position of the first digit that a journal holds; beyond all where it holds none."""
    if held.part.digits:
        return held.part.begins
    return Position(*held.keys[0][:2]) if held.keys else BEYOND


def differing_key(size: int, mine: Held, theirs: Held) -> str:
    """Where keys are not the same at both ends of a session; empty: they are.

    One end may hold less than the other.
    """
    for one, other in ((mine, theirs), (theirs, mine)):
        part = one.part
        digits = KeyStream(size, other).at(part.begins, len(part.digits))
        if digits is not None and bytes(digits) != part.digits:
            return f"digits of block {part.block} differ between the two ends"
    there = {keys.block: keys.keys for keys in theirs.keys}
    for block, _, keys in mine.keys:
        both = min(len(keys), len(there.get(block, b"")))
        if both and keys[-both:] != there[block][-both:]:
            return f"keys of block {block} differ between the two ends"
    return ""
