"""Every decoding that hidden thresholds leave possible, against brute force, and read as frames."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.schemes.framing import encode_frame
from protocol.schemes.switched import Switched
from tap_service.capture.transcript import Transition
from tap_service.inference.expectation import expected
from tap_service.inference.list_decoding import ANY_EDGE, Heard, ListDecoding, parsed
from tap_service.inference.message_reader import Message
from tap_service.inference.verdicts import Inferred, InferredStep, Interval

STEP = tuple[list[float], int | None]


def decode(steps: list[STEP], t_c: float, t_e: float, size: int) -> tuple[int, ...]:
    """The receiver's automaton, plainly, for one pair of thresholds; -1 for no symbol."""
    key, out = -1, []
    for gauges, cipher in steps:
        if key >= 0:
            out.append(0 if cipher is None else (cipher - key) % size)
            key = -1
            continue
        out.append(-1)
        inside = [i for i, g in enumerate(gauges) if g <= t_c]
        if len(inside) == 1 and max(gauges) <= t_e:
            key = inside[0]
    return tuple(out)


def inferred(steps: list[STEP], among: Interval, session: str = "s", begin: int = 0) -> Inferred:
    return Inferred(
        [
            InferredStep(
                Transition(session, k, (0.0,), None, cipher, (0.0,), start=k == 0),
                np.array([gauges]),
            )
            for k, (gauges, cipher) in enumerate(steps, begin)
        ],
        among,
    )


def lists(size: int) -> ListDecoding:
    return ListDecoding(Switched(size), expected, certain=False)


def read(
    steps: list[STEP], size: int, among: Interval = (0.0, 3.0), edges: Interval = (3.0, 3.0)
) -> list[Message]:
    return lists(size).read(inferred(steps, among), {}, edges)


def message_steps(payload: bytes, size: int, seed: int, idle: int = 30) -> list[STEP]:
    """Steps whose true thresholds are t_c = 1, t_e = 3, that carry idle symbols and a frame."""
    rng = random.Random(seed)
    symbols = [0] * idle + list(encode_frame(payload, size)) + [0] * idle
    steps: list[STEP] = []
    key = -1
    while symbols:
        gauges = [rng.uniform(0, 3.2) for _ in range(size)]
        gauges[rng.randrange(size)] = rng.uniform(0, 0.9)
        cipher = rng.randrange(size)
        if key >= 0:
            cipher, key = (symbols.pop(0) + key) % size, -1
        else:
            inside = [i for i, g in enumerate(gauges) if g <= 1]
            if len(inside) == 1 and max(gauges) <= 3:
                key = inside[0]
        steps.append((gauges, cipher))
    return steps


gauge = st.floats(0.01, 4.0).map(lambda v: round(v, 2))


@settings(max_examples=60, deadline=None)
@given(
    st.integers(2, 4).flatmap(
        lambda m: st.lists(
            st.tuples(st.lists(gauge, min_size=m, max_size=m), st.integers(0, m - 1)),
            min_size=1,
            max_size=12,
        )
    ),
    st.booleans(),
)
def test_the_list_holds_exactly_the_decodings_of_all_thresholds(
    steps: list[STEP], hidden: bool
) -> None:
    size, decoding = len(steps[0][0]), lists(len(steps[0][0]))
    values = sorted({g for gauges, _ in steps for g in gauges} | {0.0})
    edges = ANY_EDGE if hidden else (2.0, 2.0)
    brute = {
        decode(steps, t_c, t_e, size) for t_c in values for t_e in (values if hidden else [2.0])
    }
    heard = Heard.of(inferred(steps, (0.0, np.inf)).steps, size)
    t_c, t_e = decoding.thresholds(heard, (0.0, np.inf), edges)
    rows, which, pairs = decoding.decoded(heard, t_c, t_e, decoding.entry)
    assert {tuple(row.tolist()) for row in rows} == brute
    assert len(rows) == len(brute)
    for row, (low, edge) in zip(which.tolist(), pairs.tolist(), strict=True):
        assert tuple(rows[row].tolist()) == decode(steps, low, edge, size)


@pytest.mark.parametrize("size", [2, 3, 4, 6])
def test_a_frame_is_found_whatever_the_alphabet(size: int) -> None:
    payload = "Größe, 試".encode()
    decoding = lists(size)
    found = decoding.read(inferred(message_steps(payload, size, size), (0.0, 3.0)), {}, (3.0, 3.0))
    assert [(m.payload, m.probability, m.bits_left) for m in found] == [(payload, 1.0, 0.0)]
    low, high = decoding.among
    assert 0.8 < low <= 1.0 < high < 1.2


def test_both_thresholds_hidden() -> None:
    steps = message_steps(b"two unknowns", 2, 9)
    (found,) = read(steps, 2, (0.5, 2.0), ANY_EDGE)
    assert found.payload == b"two unknowns"


def test_a_message_under_way_is_known_as_far_as_it_goes() -> None:
    steps = message_steps(b"the water is clear", 2, 6)
    (found,) = read(steps[: int(len(steps) * 0.6)], 2)
    assert not found.whole
    assert b"the water is clear".startswith(found.payload)
    assert len(found.payload) > 4
    assert found.bits_left > 8
    assert found.due_k > found.k


def test_a_new_session_starts_the_frame_again() -> None:
    steps = message_steps(b"again", 2, 8)
    first, second = inferred(steps, (0.0, 3.0), "a"), inferred(steps, (0.0, 3.0), "b")
    both = Inferred([*first.steps, *second.steps], (0.0, 3.0))
    found = lists(2).read(both, {}, (3.0, 3.0))
    assert [(m.session, m.payload) for m in found] == [("a", b"again"), ("b", b"again")]
    found = lists(2).read(both, {"a": len(steps)}, (3.0, 3.0))
    assert [m.session for m in found] == ["b"]


def test_what_is_let_go_of_a_message_under_way_is_kept() -> None:
    payload = b"let go of the old"
    steps = inferred(message_steps(payload, 2, 12), (0.0, 3.0)).steps
    half = len(steps) // 2
    decoding = lists(2)
    decoding.read(Inferred(steps[: half + 20], (0.0, 3.0)), {}, (3.0, 3.0))
    decoding.let_go(steps[:half])
    (found,) = decoding.read(Inferred(steps[half:], (0.0, 3.0)), {}, (3.0, 3.0))
    assert (found.payload, found.whole) == (payload, True)


def test_frames_are_read_one_after_the_other_and_refused_ones_passed_over() -> None:
    one, two = encode_frame(b"one", 2), encode_frame(b"two", 2)
    broken = bytes([*one[:-1], 1 - one[-1]])
    found = parsed(bytes(5) + one + bytes(3) + broken + two + bytes(2), 2)
    assert found.whole == [(5 + len(one), b"one"), (8 + 3 * len(one), b"two")]
    assert (found.text, found.missing) == (b"", 0)
    assert found.score < parsed(bytes(5) + one + bytes(3) + two + bytes(2), 2).score
    part = parsed(bytes(5) + one[:-40], 2)
    assert (part.text, part.missing, part.begun) == (b"on", 40, 5)


def test_a_block_larger_than_its_bytes_is_refused() -> None:
    assert parsed(bytes([1, *[2] * 11]), 3).whole == []
    assert parsed(bytes([1, *[2] * 11]), 3).text == b""
