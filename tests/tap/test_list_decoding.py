"""The list of hypotheses against brute force, and its bounds."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tap_service.inference.list_decoding as beam_module
from protocol.schemes.framing import encode_frame
from protocol.schemes.switched import Switched
from tap_service.inference.counts import OTHER, class_of
from tap_service.inference.english import plausibility
from tap_service.inference.list_decoding import ListDecoding, bytes_of

STEP = tuple[list[float], int]


def decode(steps: list[STEP], t_c: float, t_e: float, size: int) -> list[tuple[int, int]]:
    """The receiver's automaton, plainly, for one pair of thresholds."""
    key, out = -1, []
    for k, (gauges, cipher) in enumerate(steps):
        if key >= 0:
            out.append((k, (cipher - key) % size))
            key = -1
            continue
        inside = [i for i, g in enumerate(gauges) if g <= t_c]
        if len(inside) == 1 and max(gauges) <= t_e:
            key = inside[0]
    return out


def follow(steps: list[STEP], size: int, edge: float | None, cap: int = 100_000) -> ListDecoding:
    decoding = ListDecoding(Switched(size), edge=edge, cap=cap)
    for k, (gauges, cipher) in enumerate(steps):
        decoding.step(k, gauges, cipher)
    return decoding


def decodings(decoding: ListDecoding) -> set[tuple[tuple[int, int], ...]]:
    h, paths = decoding.beam, decoding.paths
    return {tuple(paths.path(int(node))) for node in h.node[: h.n]}


gauge = st.floats(0.01, 4.0).map(lambda v: round(v, 2))


@settings(max_examples=80, deadline=None)
@given(
    st.integers(2, 4).flatmap(
        lambda m: st.lists(
            st.tuples(st.lists(gauge, min_size=m, max_size=m), st.integers(0, m - 1)), max_size=12
        )
    ),
    st.sampled_from([None, 2.0]),
)
def test_the_list_holds_exactly_the_decodings_of_all_thresholds(
    steps: list[STEP], edge: float | None
) -> None:
    size = len(steps[0][0]) if steps else 2
    values = sorted({g for gauges, _ in steps for g in gauges} | {0.0})
    edges = [edge] if edge is not None else [*values, 5.0]
    brute = {
        tuple(decode(steps, t_c, t_e, size))
        for t_c in values
        for t_e in edges
        if edge is None or t_c < edge
    }
    assert decodings(follow(steps, size, edge)) == brute


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32))
def test_rectangles_stay_disjoint_and_true_thresholds_stay_covered(seed: int) -> None:
    rng = random.Random(seed)
    steps = [([rng.uniform(0, 3), rng.uniform(0, 3)], rng.randrange(2)) for _ in range(40)]
    decoding = follow(steps, 2, None)
    t_c, t_e = rng.uniform(0, 2), rng.uniform(0, 4)
    h = decoding.beam
    at = (h.lo[: h.n] <= t_c) & (t_c < h.hi[: h.n])
    at &= (h.edge_lo[: h.n] <= t_e) & (t_e < h.edge_hi[: h.n])
    assert at.sum() == 1
    assert decoding.paths.path(int(h.node[at.argmax()])) == decode(steps, t_c, t_e, 2)


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


@pytest.mark.parametrize("size", [2, 3, 4])
def test_a_frame_is_found_whatever_the_alphabet(size: int) -> None:
    payload = "Größe, 試".encode()
    decoding = follow(message_steps(payload, size, size), size, 3.0, cap=3000)
    assert decoding.whole == [payload]
    lo, hi, *_ = decoding.thresholds()
    assert 0.9 < lo < hi < 1.1


def test_both_thresholds_hidden() -> None:
    decoding = follow(message_steps(b"two unknowns", 2, 9), 2, None, cap=3000)
    assert decoding.whole == [b"two unknowns"]


def test_the_list_is_bounded_and_says_what_it_dropped() -> None:
    rng = random.Random(3)
    decoding = ListDecoding(Switched(2), cap=200)
    for k in range(600):
        decoding.step(k, [rng.uniform(0, 3), rng.uniform(0, 3)], rng.randrange(2))
        assert decoding.hypotheses <= 200
    assert decoding.dropped > 0
    assert decoding.peak >= 200


def test_once_found_the_list_stays_short() -> None:
    decoding = follow(message_steps(b"short", 2, 4, idle=400), 2, 3.0, cap=3000)
    assert decoding.whole == [b"short"]
    assert decoding.hypotheses < 50


@pytest.mark.parametrize("nodes", [4000, 800])
def test_old_symbols_are_let_go_and_the_message_still_comes(
    nodes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(beam_module, "NODES", nodes)
    steps = message_steps(b"let go", 2, 12) + message_steps(b"of the old", 2, 13)
    decoding = ListDecoding(Switched(2), edge=3.0)
    for k, (gauges, cipher) in enumerate(steps):
        decoding.step(k, gauges, cipher)
        assert len(decoding.paths) <= nodes + decoding.hypotheses
    assert decoding.whole[-1] == b"of the old"
    expected = decode(steps, 1.0, 3.0, 2)
    got = decoding.message_symbols()
    assert got[-60:] == expected[-60:]


def test_a_sampled_step_without_doubt_is_a_plain_step() -> None:
    steps = message_steps(b"same", 2, 5)
    plain, sampled = ListDecoding(Switched(2), edge=3.0), ListDecoding(Switched(2), edge=3.0)
    for decoding in (plain, sampled):
        decoding.split_evenly([0.9999, 1.0001])
    for k, (gauges, cipher) in enumerate(steps):
        clear = [g + 0.02 if 0.99 < g < 1.01 else g for g in gauges]
        plain.step(k, clear, cipher)
        sampled.step_sampled(k, np.array([clear]), cipher)
    assert (plain.whole == [b"same"]) == (sampled.whole == [b"same"])


def test_lost_cipher_symbols_are_filled_in_by_check_and_text() -> None:
    payload = b"the water is clear and the valve is open"
    steps = message_steps(payload, 2, 6)
    rng = random.Random(1)
    decoding = ListDecoding(Switched(2), edge=3.0)
    lost = 0
    for k, (gauges, cipher) in enumerate(steps):
        if rng.random() < 0.04:
            lost += 1
            decoding.split_evenly([1.0])
            decoding.step_sampled(k, np.array([gauges]), None)
        else:
            decoding.step(k, gauges, cipher)
    assert lost > 20
    assert decoding.whole == [payload]


def test_a_new_session_keeps_the_thresholds_and_starts_the_frame_again() -> None:
    steps = message_steps(b"again", 2, 8)
    decoding = ListDecoding(Switched(2), edge=3.0)
    for session in ("a", "b"):
        decoding.restart()
        decoding.session = session
        for k, (gauges, cipher) in enumerate(steps):
            decoding.step(k, gauges, cipher)
    assert [at[0] for at, _ in decoding.whole_at] == ["a", "b"]
    assert decoding.whole == [b"again", b"again"]


def test_bytes_of_symbols() -> None:
    assert bytes_of([0, 1, 0, 0, 0, 0, 0, 1, 1], 2) == b"A"
    assert bytes_of([1, 0, 0, 1], 4) == b"A"


def ratio(text: bytes) -> float:
    """Log ratio of a text as English over random bytes."""
    classes = [OTHER, OTHER, *class_of(np.frombuffer(text, dtype=np.uint8)).tolist()]
    threes = zip(classes, classes[1:], classes[2:], strict=False)
    return sum(float(plausibility()[three]) for three in threes)


def test_english_is_more_plausible_than_noise_at_any_length() -> None:
    rng = random.Random(2)
    for text in (b"Bring two buckets", b"hello", b"No rain is expected before Tuesday night."):
        assert ratio(text) > len(text)
        assert ratio(rng.randbytes(len(text))) < 0
    assert ratio(b"") == 0


@pytest.mark.parametrize("size", [3, 5, 6, 25])
def test_a_message_in_blocks_of_several_bytes_is_read(size: int) -> None:
    """Every other transition agrees; she searches t_c and t_e."""
    message = b"The old mill, at nine."
    rng = random.Random(size)
    stream = bytes(5) + encode_frame(message, size) + bytes(5)
    decoding = ListDecoding(Switched(size))
    for j, symbol in enumerate(stream):
        key = rng.randrange(size)
        gauges = [0.6 if r == key else 2.5 + 0.1 * r for r in range(size)]
        decoding.step(2 * j, gauges, rng.randrange(size))
        decoding.step(2 * j + 1, gauges, (symbol + key) % size)
    assert decoding.whole[-1:] == [message]


def test_a_block_larger_than_its_bytes_is_refused() -> None:
    decoding = ListDecoding(Switched(3), edge=9.0)
    before = decoding.confidence()
    for j, symbol in enumerate([1, *[2] * 11]):
        decoding.step(2 * j, [0.5, 2.5, 2.6], 0)
        decoding.step(2 * j + 1, [0.5, 2.5, 2.6], symbol)
    assert before == 1.0
    assert decoding.whole == []
    assert decoding.under_way() == b""
