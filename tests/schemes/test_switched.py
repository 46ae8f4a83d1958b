"""The automata: complete tables, both ends in step, one key for one symbol."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import NO_SYMBOL
from protocol.schemes.switched import (
    AGREED,
    INITIAL,
    MESSAGE,
    NOT_AGREED,
    RECEIVER,
    SENDER,
    TEST,
    Row,
    State,
    advance_receiver,
    advance_sender,
    decrypt,
    encrypt,
)

sizes = st.integers(2, 16)


@pytest.mark.parametrize("table", [SENDER, RECEIVER], ids=["sender", "receiver"])
def test_every_state_answers_every_event_once(table: tuple[Row, ...]) -> None:
    arrows = Counter((row.state, row.event) for row in table)
    assert arrows == Counter(
        {(state, event): 1 for state in (TEST, MESSAGE) for event in (AGREED, NOT_AGREED)}
    )
    assert {row.next_state for row in table} == {TEST, MESSAGE}


@pytest.mark.parametrize(
    ("advance", "table"),
    [
        (advance_sender, SENDER),
        (lambda state, symbol, size: advance_receiver(state, symbol, 0, size)[0], RECEIVER),
    ],
    ids=["sender", "receiver"],
)
def test_the_step_functions_follow_the_tables(advance, table) -> None:  # type: ignore[no-untyped-def]
    for row in table:
        before = State(row.state, 1 if row.state == MESSAGE else NO_SYMBOL)
        symbol = 2 if row.event == AGREED else NO_SYMBOL
        after = advance(before, symbol, 3)
        assert after.s == row.next_state
        assert after.key == (symbol if row.next_state == MESSAGE else NO_SYMBOL)


@pytest.mark.parametrize(
    ("state", "symbol", "cipher"),
    [
        (State(0, NO_SYMBOL), NO_SYMBOL, 0),  # no such state
        (State(3, 0), NO_SYMBOL, 0),
        (State(TEST, 0), NO_SYMBOL, 0),  # a key where there is none
        (State(MESSAGE, NO_SYMBOL), NO_SYMBOL, 0),  # no key where there must be one
        (State(MESSAGE, 2), NO_SYMBOL, 0),  # a key outside the alphabet
        (INITIAL, 2, 0),
        (INITIAL, -2, 0),
    ],
)
def test_what_is_not_in_the_table_is_refused(state: State, symbol: int, cipher: int) -> None:
    with pytest.raises(ValueError, match="got"):
        advance_sender(state, symbol, 2)
    with pytest.raises(ValueError, match="got"):
        advance_receiver(state, symbol, cipher, 2)


@pytest.mark.parametrize("cipher", [-1, 2, 255])
def test_a_cipher_outside_the_alphabet_is_refused(cipher: int) -> None:
    for state in (INITIAL, State(MESSAGE, 1)):
        with pytest.raises(ValueError, match="cipher"):
            advance_receiver(state, NO_SYMBOL, cipher, 2)


@given(sizes.flatmap(lambda m: st.tuples(st.just(m), st.integers(0, m - 1), st.integers(0, m - 1))))
def test_a_symbol_comes_back_under_its_key(case: tuple[int, int, int]) -> None:
    size, symbol, key = case
    assert decrypt(encrypt(symbol, key, size), key, size) == symbol


def test_two_symbols_are_exclusive_or() -> None:
    for a in (0, 1):
        for b in (0, 1):
            assert encrypt(a, b, 2) == a ^ b == decrypt(a, b, 2)


@given(sizes, st.integers(0, 15))
def test_a_uniform_key_hides_the_symbol(size: int, symbol: int) -> None:
    """Shannon: over all keys every cipher symbol comes up once, whatever the message."""
    ciphers = Counter(encrypt(symbol % size, key, size) for key in range(size))
    assert ciphers == Counter(range(size))


transcripts = sizes.flatmap(
    lambda size: st.tuples(
        st.just(size),
        st.lists(st.integers(0, size - 1), max_size=60),  # the message
        st.lists(  # each transition's test result and random symbol
            st.tuples(st.integers(-1, size - 1), st.integers(0, size - 1)), max_size=200
        ),
    )
)


@given(transcripts)
def test_both_ends_keep_in_step(
    case: tuple[int, list[int], list[tuple[int, int]]],
) -> None:
    size, message, results = case
    sender = receiver = INITIAL
    cipher = results[0][1] if results else 0
    unsent = iter([*message, *(0 for _ in results)])
    recovered: list[int] = []
    used: list[int] = []
    agreed: list[int] = []
    for j, (symbol, _) in enumerate(results):
        assert sender == receiver
        if sender.s == MESSAGE:
            used.append(j)
        sender = advance_sender(sender, symbol, size)
        receiver, got = advance_receiver(receiver, symbol, cipher, size)
        if got != NO_SYMBOL:
            recovered.append(got)
        if sender.s == MESSAGE:
            agreed.append(j)
            cipher = encrypt(next(unsent), sender.key, size)
        else:
            cipher = results[j][1]
    assert recovered == [*message, *(0 for _ in results)][: len(recovered)]
    assert used == [j + 1 for j in agreed if j + 1 < len(results)]  # one key, the next symbol
    assert 2 * len(recovered) <= len(results)  # the paper's ceiling: a symbol in two steps


def test_a_message_transition_is_not_tested() -> None:
    for symbol in (NO_SYMBOL, 0, 1):
        assert advance_sender(State(MESSAGE, 1), symbol, 2) == INITIAL
        assert advance_receiver(State(MESSAGE, 1), symbol, 0, 2) == (INITIAL, 1)
