"""Every short history of both schemes: one key for one symbol, and pipelined twice the rate."""

import itertools
from collections.abc import Sequence
from typing import Any

import pytest

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Scheme, decrypt, encrypt
from protocol.schemes.registry import make_scheme


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
