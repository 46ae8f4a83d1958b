"""Words of estimated coins: the code corrects, the hash hides, both ends spend the same keys."""

import random
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import NO_SYMBOL
from protocol.scenario import ScenarioError
from protocol.schemes.bch import BCH
from protocol.schemes.reconciled import CARRY, CHECK_BITS, Reconciled, Reconciled31, shortened
from tests.simulate.beside import through_deaths_and_losses
from tests.support.scenarios import changed
from wyner.api import design
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.link import followed, whole_messages
from wyner.simulate.engine.taps import listen
from wyner.simulate.network import Simulation

CODES: Final = [
    (5, 3, 16, 0b1000111110101111),  # both as the package galois has them
    (6, 6, 30, 0b1101111100110100001110101101100111),
]
KINDS: Final = [Reconciled, Reconciled31]


# --- the code and the hash ------------------------------------------------------------------------


@pytest.mark.parametrize(("m", "t", "k", "generator"), CODES)
def test_a_code_corrects_what_it_must_and_invents_nothing(
    m: int, t: int, k: int, generator: int
) -> None:
    code, draw = BCH(m, t), random.Random(m)
    assert code.generator == generator
    assert code.n - code.check_bits == k
    for errors in range(t + 3):
        for _ in range(100):
            word = draw.getrandbits(code.n)
            wrong = sum(1 << i for i in draw.sample(range(code.n), errors))
            syndrome = code.syndrome(word) ^ code.syndrome(word ^ wrong)
            found = code.errors(syndrome)
            if errors <= t:
                assert found == wrong
            else:
                assert found is None or (found.bit_count() <= t and found != wrong)
                assert found is None or code.syndrome(found) == syndrome


@pytest.mark.parametrize("kind", KINDS)
def test_syndrome_and_hash_are_the_word_in_other_coordinates(kind: type[Reconciled]) -> None:
    """So one who knows nothing of the word knows nothing of its keys, whatever was in clear."""
    scheme = kind(2)
    n, check = scheme.code.n, scheme.code.check_bits
    assert check + CHECK_BITS + scheme.key_bits == n
    images = [
        scheme.code.syndrome(1 << i) | shortened(1 << i, n, n - check) << check for i in range(n)
    ]
    rank = 0
    while images:
        pivot = images.pop()
        if pivot:
            rank += 1
            images = [v ^ pivot if v & (pivot & -pivot) else v for v in images]
    assert rank == n


# --- both ends ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@given(st.data())
def test_up_to_t_errors_both_spend_the_same_keys_and_beyond_the_plant_says_so(
    kind: type[Reconciled], data: st.DataObject
) -> None:
    scheme = kind(2)
    n = scheme.code.n
    draw = random.Random(data.draw(st.integers(0, 2**32)))
    errors = data.draw(st.integers(0, scheme.code.t + 3))
    estimates = [draw.randrange(2) for _ in range(2 * n)]
    wrong = set(draw.sample(range(n), errors))
    controller = plant = scheme.initial
    keys = []
    for i, estimate in enumerate(estimates):
        assert (scheme.clear(controller) == NO_SYMBOL) or scheme.pad(controller) == NO_SYMBOL
        if (shown := scheme.clear(controller)) != NO_SYMBOL:
            plant = scheme.hear(plant, shown)
        controller, carry = scheme.advance(controller, estimate)
        plant, other = scheme.advance(plant, estimate ^ (i in wrong))
        if scheme.differs(plant):
            assert errors > scheme.code.t
            return
        if plant.s == CARRY and plant.held != controller.held:
            # the check of eight bits lets one wrong correction of 256 pass
            assert errors > scheme.code.t
            bits = CHECK_BITS + scheme.key_bits
            checks = [shortened(one.held, n, bits) for one in (plant, controller)]
            assert (checks[0] ^ checks[1]) % (1 << CHECK_BITS) == 0
            return
        assert carry == other
        assert controller.s == plant.s
        keys += [carry.pad] if carry.pad != NO_SYMBOL else []
    assert len(keys) == scheme.key_bits


def test_candidates_that_are_no_bits_are_refused() -> None:
    with pytest.raises(
        ScenarioError, match=r"secrecy.candidates: got 3, expected 2 for reconciled"
    ):
        changed("stochastic", secrecy={"candidates": 3})


# --- the loop -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_the_engine_is_the_two_ends_past_the_first_words(seed: int) -> None:
    system, steps = design("stochastic"), 700
    runs = simulate_runs(system.scenario, system.law, seed=seed, runs=range(1), steps=steps)
    link = transfer(runs, payloads=[b"ok then"])
    ends = Simulation(system.scenario, system.law, seed=seed, payloads=(b"ok then",))
    history = ends.run(steps=steps)
    assert history.inbox == [b"ok then"]
    for (_, k), t in history.plant.items():
        here = (link.agreed, link.pad, link.cipher, link.message_symbol, runs.coin)
        of = (t.symbol, t.key, t.cipher, t.message_symbol, t.coin)
        assert of == tuple(part[k, 0] for part in here)
    for at, t in history.controller.items():
        assert history.plant[at].shared == t.shared


@pytest.mark.parametrize(
    "scheme", ["reconciled", pytest.param("reconciled-31", marks=pytest.mark.long)]
)
def test_words_that_differ_end_the_session_and_the_message_comes_once(scheme: str) -> None:
    law = {"law": "packed", "alphabet": {"spacing": 0.6}}
    system = design(changed("stochastic", secrecy={"scheme": scheme}, control=law))
    text = (b"one", b"two")
    ends = Simulation(system.scenario, system.law, seed=2, payloads=text)
    history = ends.run(steps=20_000, until=lambda: len(ends.history.inbox) == len(text))
    assert history.inbox == list(text)
    assert history.record is not None
    assert history.record.session.sessions > 1
    assert history.record.frame.refused == 0
    runs = simulate_runs(system.scenario, system.law, seed=2, runs=range(1), steps=8000)
    link, ended = transfer(runs, payloads=text), followed(runs, [8.0]).ended
    assert ended is not None
    assert ended.sum() > 1
    assert whole_messages(link.message_symbol[:, 0].tolist(), 2) == list(text)


def test_each_message_comes_once_through_deaths_and_losses() -> None:
    system = design(changed("stochastic", secrecy={"scheme": "reconciled-31"}))
    assert len(list(through_deaths_and_losses(system.scenario, system.law))) == 4


def test_eve_with_the_same_model_reads_it_and_the_papers_does_not() -> None:
    system, text = design("stochastic"), b"We sail at dawn."
    runs = simulate_runs(
        system.scenario, system.law, seed=3, runs=range(1), steps=1200, record=True
    )
    link = transfer(runs, payloads=[text])
    names = ["set-membership", "nearest-centre", "oracle"]
    blind, *same = listen(runs, link, names, 0)
    for one in same:
        assert one.right == one.agreements > 300
        assert one.read == one.delivered == 1
    assert 0.4 < blind.right / blind.agreements < 0.6
    assert blind.read == 0
