"""Eavesdroppers where an encoder alone is read: a session's first steps are no refuge."""

from collections.abc import Sequence

import numpy as np
import pytest

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import Scenario, parse_scenario
from studies.corners import at_the_corners
from studies.listeners import heard_of
from studies.outputs import CONDITIONS, over
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import default_names, named
from tap_service.eavesdroppers.base import Model
from tap_service.inference.opening import Known, Opening, inferred
from tap_service.inference.output_fit import applied_in, identified, refitted
from tap_service.inference.output_model import LATER, LOST, OutputModel
from tests.support.recorded_pair import law_of
from tests.support.scenarios import changed
from tests.support.size import size
from wyner.simulate.engine import Runs, simulate_runs, transfer
from wyner.simulate.engine.link import Transfer
from wyner.simulate.engine.taps import listen, transcript

MESSAGE = b"At dawn."
STEPS = 300


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """d and n in the corners of what both ends assume."""
    return at_the_corners("encoder")


@pytest.fixture(scope="module")
def runs(scenario: Scenario) -> Runs:
    law = law_of("encoder")[1]
    return simulate_runs(scenario, law, seed=3, runs=range(8), steps=STEPS, record=True)


@pytest.fixture(scope="module")
def link(runs: Runs) -> Transfer:
    return transfer(runs, payloads=[MESSAGE])


def model_of(scenario: Scenario) -> OutputModel:
    model = Model.of(scenario.knowledge(), "a test")
    assert isinstance(model, OutputModel)
    return model


def known(model: OutputModel, heard: Sequence[Transition]) -> list[Known]:
    opening = Opening(model, 2)
    return [one for t in heard for one in opening.take(t)[0]] + opening.flush()


def test_the_ends_lose_a_session_s_first_steps_and_no_other(runs: Runs) -> None:
    """What every listener here takes for granted."""
    lost = runs.symbol == NO_SYMBOL
    first = np.argmin(lost, axis=0)
    assert lost.sum() == first.sum()
    assert (first >= 1).all()
    assert (first < LOST).all()
    assert len(set(first.tolist())) > 1


def test_some_readings_later_she_knows_every_candidate_that_was_applied(
    scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    model = model_of(scenario)
    for place in range(8):
        found = known(model, list(transcript(runs, link, place)))
        assert [one.place for one in found] == list(range(STEPS))
        wrong = [one.place for one in found if one.symbol != runs.coin[one.place, place]]
        assert all(place == 0 or place > STEPS - LATER for place in wrong)


def test_what_was_missed_is_given_out_as_unknown_and_the_rest_goes_on(
    scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    whole = list(transcript(runs, link, 0))
    heard = [*whole[:50], Transition("simulated", 50, None, None, 1, None), *whole[51:]]
    found = known(model_of(scenario), heard)
    assert [one.transition.k for one in found] == list(range(STEPS))
    assert [one.place for one in found if one.symbol is None] == [50]
    later = [one for one in found if 60 < one.place < STEPS - LATER]
    assert all(one.symbol == runs.coin[one.place, 0] for one in later)


@pytest.mark.long
def test_a_message_from_the_session_s_first_step_on_is_read(runs: Runs, link: Transfer) -> None:
    names = ["nearest-centre", "list-decoder"]
    for place in range(size(1, 8)):
        for found in listen(runs, link, names, place):
            assert (found.delivered, found.read) == (1, 1)
            assert found.right > 0.97 * found.agreements


@pytest.mark.parametrize(
    "name", ["nearest-centre", pytest.param("list-decoder", marks=pytest.mark.long), "text"]
)
def test_by_readings_she_names_the_message_symbols(
    name: str, scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    carried = dict(enumerate(link.message_symbol[:, 0].tolist()))
    tap = named(name)(scenario.knowledge())
    for t in transcript(runs, link, 0):
        tap.observe(t)
    tap.review()
    assert tap.belief().whole == (MESSAGE,)
    said = dict(tap.message_symbols())
    right = sum(said.get(k) == symbol for k, symbol in carried.items() if symbol != NO_SYMBOL)
    assert right >= 0.95 * sum(symbol != NO_SYMBOL for symbol in carried.values()) > 50


@pytest.mark.long
def test_who_was_told_nothing_learns_the_motor_and_reads_the_message(
    scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    """y(k+1) = 1.819 y(k) - 0.819 y(k-1) + 0.0094 u(k) + 0.0088 u(k-1), of two states."""
    kind = named("learning")
    told = View().knowledge(scenario.knowledge(), model=kind.told_model)
    assert (told.A, told.B, told.disturbance_H, told.policy) == (None, None, None, None)
    for place in size((0,), (0, 4)):
        tap = kind(told)
        for t in transcript(runs, link, place):
            tap.observe(t)
        later = {g.k: g.best for g in tap.review()}
        wrong = [k for k, coin in enumerate(runs.coin[:, place]) if later[k] != coin]
        assert len(wrong) < 0.03 * STEPS
        assert tap.belief().whole == (MESSAGE,)
        A, B = np.array(tap.belief().A), np.array(tap.belief().B)
        assert A[:, 0] == pytest.approx([1.81873, -0.81873], abs=0.05)
        assert B[:, 0] == pytest.approx([0.0094, 0.0088], abs=0.001)


def test_the_strongest_listens_unasked(scenario: Scenario) -> None:
    assert default_names(scenario.knowledge())[-1] == "text"


def test_too_little_makes_no_model(runs: Runs, link: Transfer) -> None:
    heard = list(transcript(runs, link, 0))
    assert identified(heard[:2], 0.0, None) is None


def test_deviations_are_found_from_readings_alone(
    scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    """Draws are corners, so that a deviation is a half-width: D_c, a twelfth of D_e, and N."""
    found = refitted(model_of(scenario), list(transcript(runs, link, 0)))
    assert found.deviations == pytest.approx([0.000468, 0.00906], rel=0.5)
    assert found.sensors == pytest.approx([0.00012], rel=1.0)


@pytest.mark.long
def test_through_noise_of_her_own_she_is_right_as_often_as_she_says(
    scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    """Eight times the encoder's noise: her probabilities beside her hits."""
    view = CONDITIONS["Eve's noise 0.001"][1]
    kind = named("text")
    sure: list[float] = []
    hits: list[bool] = []
    at_once = 0
    for place in range(size(2, 3)):
        heard = heard_of(runs, link, view, place)
        tap = kind(view.knowledge(scenario.knowledge()))
        at_once += sum(tap.observe(t).best == runs.coin[t.k, place] for t in heard)
        for g in tap.review():
            sure.append(max(g.symbol))
            hits.append(g.best == runs.coin[g.k, place])
    assert np.mean(hits) > at_once / len(hits) + 0.1
    assert np.mean(sure) == pytest.approx(np.mean(hits), abs=0.05)
    doubtful = [hit for hit, p in zip(hits, sure, strict=True) if p < 0.9]
    assert np.mean(doubtful) < np.mean(hits) - 0.1


@pytest.mark.slow
def test_text_reads_it_and_is_sure(runs: Runs, link: Transfer) -> None:
    (found,) = listen(runs, link, ["text"], 0)
    assert (found.delivered, found.read) == (1, 1)


def test_what_text_weighs_begins_to_agree_at_one_step_of_each_trajectory(
    scenario: Scenario, runs: Runs, link: Transfer
) -> None:
    steps = inferred(model_of(scenario), 2, list(transcript(runs, link, 0))).steps
    agrees: Array = np.array([(s.samples.min(axis=1) < 0.5).tolist() for s in steps[:LOST]])  # type: ignore[union-attr]
    assert not agrees[0].any()
    assert (np.diff(agrees.astype(int), axis=0) >= 0).all()
    assert agrees[1].mean() == pytest.approx(0.5, abs=0.05)
    assert steps[LOST].samples is not None
    assert len(steps[LOST].samples) == 1


@pytest.mark.long
def test_verdicts_that_the_ends_lost_after_missed_steps_break_no_message() -> None:
    """40 % lost each way: who takes all for agreed reads none, who tries each number all three."""
    scenario = over(at_the_corners("encoder"), 0.4)
    law = law_of("encoder")[1]
    runs = simulate_runs(scenario, law, seed=2, runs=range(7), steps=size(250, 500), record=True)
    link = transfer(runs, payloads=[size(b"At six", b"We sail at dawn.")])
    assert runs.missed is not None
    for place in size((3,), (0, 3, 6)):
        lost = (runs.symbol[:, place] == NO_SYMBOL) & ~runs.missed[:, place]
        assert lost[LOST:].sum() > 3
        takes, tries = listen(runs, link, ["nearest-centre", "list-decoder"], place)
        assert (takes.delivered, takes.read, tries.read) == (1, 0, 1)
        assert tries.right > 0.98 * tries.agreements


@pytest.mark.parametrize("fallback", ["zero", "hold", "regulator"])
def test_the_fallback_shows_in_the_readings(fallback: str) -> None:
    """She is not told which: over missed steps she goes along each."""
    data = over(at_the_corners("encoder"), 0.3).model_dump(mode="json", exclude_none=True)
    scenario = parse_scenario(data | {"link": {"fallback": fallback}}, "encoder")
    law = law_of("encoder")[1]
    runs = simulate_runs(scenario, law, seed=4, runs=range(1), steps=STEPS, record=True)
    assert runs.missed is not None
    assert runs.missed.sum() > 10
    heard = list(transcript(runs, transfer(runs, payloads=[MESSAGE]), 0))
    applied = applied_in(model_of(scenario), heard)
    right = [symbol == runs.coin[t.k, 0] for t, symbol in zip(heard, applied, strict=True)]
    assert np.mean(right[:-LATER]) > 0.98


def test_steps_that_a_network_takes_break_no_message_for_text() -> None:
    """A missed step is no transition: for who reads messages it is as if it were not there."""
    scenario = changed("packed", network={"to_plant": {"loss": 0.5}})
    law = law_of("packed")[1]
    runs = simulate_runs(scenario, law, seed=4, runs=range(1), steps=400, record=True)
    assert runs.missed is not None
    assert runs.missed.sum() > 10
    (found,) = listen(runs, transfer(runs, payloads=[MESSAGE]), ["text"], 0)
    assert (found.delivered, found.read) == (1, 1)
