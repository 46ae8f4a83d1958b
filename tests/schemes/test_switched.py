"""The paper's scheme is Figs. 5 and 6 and nothing else; both ends keep in step; a pad hides."""

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Carry, Scheme, decrypt, encrypt
from protocol.schemes.pipelined import Pipelined
from protocol.schemes.registry import make_scheme
from protocol.schemes.switched import INITIAL, MESSAGE, TEST, Switched, SwitchedState
from protocol.schemes.table import advance_many

AGREED, NOT_AGREED = "agreed", "not agreed"


class Row(NamedTuple):
    """An arrow of Fig. 6: both automata go from ``state`` to ``following``."""

    state: int
    event: str
    following: int
    keeps: bool
    carries: bool


FIGURE_6 = (
    Row(TEST, AGREED, MESSAGE, keeps=True, carries=False),
    Row(TEST, NOT_AGREED, TEST, keeps=False, carries=False),
    Row(MESSAGE, AGREED, TEST, keeps=False, carries=True),
    Row(MESSAGE, NOT_AGREED, TEST, keeps=False, carries=True),
)

sizes = st.integers(2, 16)


@pytest.mark.parametrize("row", FIGURE_6)
@pytest.mark.parametrize("size", [2, 3, 16, 256])
def test_every_arrow_of_the_figure(row: Row, size: int) -> None:
    scheme = Switched(size)
    before = SwitchedState(row.state, 1 if row.state == MESSAGE else NO_SYMBOL)
    verdicts = range(size) if row.event == AGREED else [NO_SYMBOL]
    for verdict in verdicts:
        after, carry = scheme.advance(before, verdict)
        assert after.s == row.following
        assert after.key == (verdict if row.keeps else NO_SYMBOL)
        assert carry == Carry(after.key, 1 if row.carries else NO_SYMBOL)
        assert scheme.pad(before) == carry.pad


@pytest.mark.parametrize(
    ("state", "verdict", "text"),
    [
        (SwitchedState(0, NO_SYMBOL), NO_SYMBOL, "state: got 0, expected 1 or 2"),
        (SwitchedState(3, 0), NO_SYMBOL, "state: got 3, expected 1 or 2"),
        (SwitchedState(TEST, 0), NO_SYMBOL, "state: got key 0 in state 1, expected none"),
        (SwitchedState(MESSAGE, NO_SYMBOL), 0, "state: got key -1, expected 0 to 1 in state 2"),
        (SwitchedState(MESSAGE, 2), NO_SYMBOL, "state: got key 2, expected 0 to 1 in state 2"),
        (INITIAL, 2, "verdict: got 2, expected -1 to 1"),
        (INITIAL, -2, "verdict: got -2, expected -1 to 1"),
    ],
)
def test_what_is_not_in_the_figure_is_refused(
    state: SwitchedState, verdict: int, text: str
) -> None:
    for scheme in (Switched(2), Pipelined(2)):
        with pytest.raises(ValueError, match=f"^{text}$"):
            scheme.advance(state, verdict)


@given(sizes.flatmap(lambda m: st.tuples(st.just(m), st.integers(0, m - 1), st.integers(0, m - 1))))
def test_a_symbol_comes_back_under_its_key(case: tuple[int, int, int]) -> None:
    size, symbol, key = case
    assert decrypt(encrypt(symbol, key, size), key, size) == symbol


@given(sizes, st.integers(0, 15))
def test_a_uniform_key_hides_the_symbol(size: int, symbol: int) -> None:
    """Shannon: over all keys every cipher symbol comes up once, whatever the message."""
    ciphers = Counter(encrypt(symbol % size, key, size) for key in range(size))
    assert ciphers == Counter(range(size))


def test_the_largest_symbols_of_a_byte_are_kept_apart_from_none() -> None:
    """Keys from 64 on have the bit below the sign set."""
    verdicts = np.array([[126], [5], [64], [NO_SYMBOL], [3], [4]], dtype=np.int8)
    many = advance_many(Switched(127), verdicts)
    assert many.agreed[:, 0].tolist() == [126, NO_SYMBOL, 64, NO_SYMBOL, 3, NO_SYMBOL]
    assert many.pad[:, 0].tolist() == [NO_SYMBOL, 126, NO_SYMBOL, 64, NO_SYMBOL, 3]


# --- every short history --------------------------------------------------------------------------


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
