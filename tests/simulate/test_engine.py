"""The engine is the same system: every number of every step, against the scalar functions."""

import pytest

from protocol.agreement import NO_SYMBOL
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import Belief, Eavesdropper, Guess
from tests.support.recorded_pair import law_of
from tests.support.scenarios import changed
from wyner.simulate.engine import (
    SimulationError,
    chunks,
    follow,
    simulate_runs,
    transfer,
)
from wyner.simulate.engine.link import carries
from wyner.simulate.engine.taps import listen

ALPHAS = [1.0, 1.5, 3.0, 4.5, 8.0]


# --- the loop ------------------------------------------------------------------------------------


def test_a_run_is_the_same_alone_in_company_and_in_any_chunk() -> None:
    scenario, law = law_of("sustained")
    together = list(chunks(scenario, law, seed=2, runs=range(100, 130), steps=80, chunk=13))
    assert [c.runs for c in together] == [range(100, 113), range(113, 126), range(126, 130)]
    alone = simulate_runs(scenario, law, seed=2, runs=range(127, 128), steps=80)
    assert (together[2].largest[:, 1] == alone.largest[:, 0]).all()
    assert together[2].state_cost[1] == alone.state_cost[0]


def test_a_state_outside_every_set_ends_the_simulation_with_its_step() -> None:
    base, law = law_of("sustained")
    scenario = changed("sustained", plant={"initial_state": (1e6, 0.0)})
    with pytest.raises(SimulationError, match=r"runs 0 to 1, step 0: .*outside T_250"):
        simulate_runs(scenario, law, seed=1, runs=range(2), steps=5)
    with pytest.raises(ValueError, match="at least one of each"):
        simulate_runs(base, law, seed=1, runs=range(0), steps=5)


# --- the link ------------------------------------------------------------------------------------


def test_what_is_counted_is_what_is_transferred_keys_that_are_not_the_coin_among_it() -> None:
    spec = {"kind": "gaussian", "half_widths": [0.2, 0.2]}
    scenario = changed("sustained", plant={"disturbance": spec})
    runs = simulate_runs(scenario, law_of("sustained")[1], seed=6, runs=range(4), steps=600)
    counts = follow(runs, ALPHAS)
    tested = carries(runs, ALPHAS).tested
    for i, alpha in enumerate(ALPHAS):
        link = transfer(runs, alpha, symbols=[1, 0, 1])
        gained = link.agreed != NO_SYMBOL
        assert (counts.agreements[i] == gained.sum(axis=0)).all()
        assert (counts.message_symbols[i] == (link.pad != NO_SYMBOL).sum(axis=0)).all()
        assert (counts.mistaken[i] == (gained & (link.agreed != runs.coin)).sum(axis=0)).all()
        assert (counts.tested[i] == tested[:, i].sum(axis=0)).all()
        assert (tested[:, i] == (link.pad == NO_SYMBOL)).all()
    assert (counts.mistaken[-1] > 0).all()
    first = link.message_symbol[:, 0]
    assert first[first != NO_SYMBOL][:4].tolist() == [1, 0, 1, 0]


def test_one_simulation_serves_every_alpha_and_more_alpha_is_never_less_diff() -> None:
    scenario, law = law_of("sustained")
    runs = simulate_runs(scenario, law, seed=1, runs=range(50), steps=100)
    together = follow(runs, ALPHAS)
    for i, alpha in enumerate(ALPHAS):
        alone = follow(runs, [alpha])
        assert (together.agreements[i] == alone.agreements[0]).all()
    agreed = carries(runs, ALPHAS).agreed != NO_SYMBOL
    assert not (agreed[1:] & agreed[:-1]).any(), "no two transitions in a row"
    in_diff = (runs.symbol != NO_SYMBOL) & (runs.largest <= 1.5)
    assert (in_diff <= ((runs.symbol != NO_SYMBOL) & (runs.largest <= 3.0))).all()


@pytest.mark.parametrize(("loss", "holds"), [(0.3, False), (0.0, True)])
def test_one_who_goes_for_keys_holds_what_the_claim_leaves_her(loss: float, holds: bool) -> None:
    scenario, law = law_of("keys")
    scenario = scenario.model_copy(update={"tap": scenario.tap.model_copy(update={"loss": loss})})
    runs = simulate_runs(scenario, law, seed=3, runs=range(2), steps=320, record=True)
    sent = transfer(runs, payloads=[b"Ahoy"])
    for place in range(2):
        got, other = listen(runs, sent, ("key-solver", "nearest-centre"), place)
        assert (got.key_blocks, got.key_bits > 0) == (3, holds)
        assert (other.key_blocks, other.key_bits) == (0, 0)


def test_eavesdroppers_hear_what_the_scheme_sends() -> None:
    scenario, law = law_of("sustained")
    runs = simulate_runs(scenario, law, seed=12, runs=range(2), steps=900, record=True)
    sent = transfer(runs, payloads=[b"Ahoy"])
    names = ("set-membership", "nearest-centre", "list-decoder", "oracle")
    for place in range(2):
        weak, nearest, decoder, oracle = listen(runs, sent, names, place)
        assert weak.agreements == (sent.agreed[:, place] != NO_SYMBOL).sum() > 100
        assert nearest.right == decoder.right == oracle.right == weak.agreements
        assert 0.3 < weak.right / weak.agreements < 0.7, "she cannot tell them apart"
        assert (oracle.delivered, oracle.read) == (1, 1)
        assert decoder.read == 1
    blind = simulate_runs(scenario, law, seed=12, runs=range(1), steps=9)
    with pytest.raises(ValueError, match="record=True"):
        listen(blind, transfer(blind), names, 0)


class Reads(Eavesdropper):
    """Had one of the messages whole, and no more."""

    name = "reads"
    guesses = False
    had: tuple[bytes, ...] = (b"Ahoy",)
    count = 1

    def observe(self, transition: Transition) -> Guess:
        return Guess(transition.k, (0.25,) * 4, 0.5)

    def belief(self) -> Belief:
        return Belief(whole=self.had, whole_count=self.count)


class ReadsMany(Reads):
    """Had a hundred, and keeps the last two."""

    had = (b"Ahoy", b"Ahoy")
    count = 100


def test_a_message_read_once_counts_once_however_often_it_was_sent() -> None:
    scenario, law = law_of("packed")
    runs = simulate_runs(scenario, law, seed=12, runs=range(1), steps=200, record=True)
    sent = transfer(runs, payloads=[b"Ahoy"] * 100)
    once, many, oracle = listen(runs, sent, (Reads, ReadsMany, "oracle"), 0)
    assert once.delivered > 2
    assert once.read == 1
    assert (many.delivered, many.read) == (2, 2)
    assert (oracle.delivered, oracle.read) == (once.delivered, once.delivered)
