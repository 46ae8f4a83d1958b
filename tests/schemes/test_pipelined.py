"""Pipelined: every arrow, every short history, one key for one symbol, and twice the rate."""

import itertools
from collections.abc import Sequence
from typing import Any

import pytest

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Carry, Scheme, decrypt, encrypt
from protocol.schemes.pipelined import Pipelined
from protocol.schemes.registry import make_scheme
from protocol.schemes.switched import INITIAL, MESSAGE, TEST, SwitchedState


@pytest.mark.parametrize("size", [2, 3, 16, 256])
def test_every_arrow(size: int) -> None:
    scheme = make_scheme("pipelined", size)
    for before in (INITIAL, SwitchedState(MESSAGE, 1)):
        assert scheme.tests(before)
        for verdict in range(-1, size):
            after, carry = scheme.advance(before, verdict)
            assert after == SwitchedState(TEST if verdict == NO_SYMBOL else MESSAGE, verdict)
            assert carry == Carry(verdict, before.key)
            assert scheme.pad(before) == carry.pad


@pytest.mark.parametrize(
    ("state", "verdict", "text"),
    [
        (SwitchedState(TEST, 0), NO_SYMBOL, "state: got key 0 in state 1"),
        (SwitchedState(MESSAGE, 2), 0, "state: got key 2, expected 0 to 1"),
        (INITIAL, 2, "verdict: got 2, expected -1 to 1"),
    ],
)
def test_what_is_no_arrow_is_refused(state: SwitchedState, verdict: int, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Pipelined(2).advance(state, verdict)


def both_ends(
    scheme: Scheme[Any], verdicts: Sequence[int], message: Sequence[int]
) -> tuple[list[int], list[tuple[int, int]]]:
    """What the receiver recovers, and the transitions (agreed on, used in) of each key."""
    sender = receiver = scheme.initial
    cipher, unsent = 0, iter(message)
    recovered: list[int] = []
    agreed_at, used = NO_SYMBOL, []
    for j, verdict in enumerate(verdicts):
        sender, ours = scheme.advance(sender, verdict)
        receiver, theirs = scheme.advance(receiver, verdict)
        assert (sender, ours) == (receiver, theirs)
        if theirs.pad != NO_SYMBOL:
            recovered.append(decrypt(cipher, theirs.pad, scheme.alphabet))
            used.append((agreed_at, j))
        if theirs.agreed != NO_SYMBOL:
            agreed_at = j
        pad = scheme.pad(sender)
        cipher = 0 if pad == NO_SYMBOL else encrypt(next(unsent), pad, scheme.alphabet)
    return recovered, used


@pytest.mark.parametrize("name", ["switched", "pipelined"])
def test_every_history_of_eight_transitions(name: str) -> None:
    """In step, a prefix comes out, and each key serves the transition right after its own."""
    scheme = make_scheme(name, 2)
    message = [1, 0, 0, 1, 1, 0, 1, 0]
    for verdicts in itertools.product((NO_SYMBOL, 0, 1), repeat=8):
        recovered, used = both_ends(scheme, verdicts, message)
        assert recovered == message[: len(recovered)]
        assert all(at == agreed + 1 for agreed, at in used)
        assert len({agreed for agreed, _ in used}) == len(used)
        agreements = sum(v != NO_SYMBOL for v in verdicts[:-1])
        if name == "pipelined":
            assert len(recovered) == agreements
        else:
            assert 2 * len(recovered) <= len(verdicts)
