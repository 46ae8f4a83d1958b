"""Offers alone, or states alone, before someone who was told the control policy."""

from functools import cache

import numpy as np
import pytest

from controller_service.laws.base import CandidateLaw
from protocol.knowledge import Knowledge
from protocol.scenario import Scenario
from studies.secrecy.runs import Run, law_of, scenario_at, simulate
from studies.secrecy.study import heard_by, output_about
from tap_service.capture.channel import View
from tap_service.eavesdroppers import smoother
from tap_service.eavesdroppers.smoother import FIRST, Smoother
from tap_service.inference import offers_reader
from tap_service.inference.offers_reader import LEAST, TRIAL, OffersReader
from tap_service.inference.particle_smoother import SAMPLES
from tap_service.inference.policy import KnownLaw
from tests.support.size import size
from wyner.runs.score.score import EavesdropperScore, TapOutput, score

SEEDS = (1,)
OFFERS = View(view="offers")
RNG = np.random.default_rng(0)


def law_told(scenario: Scenario) -> KnownLaw:
    law = KnownLaw.of(scenario.knowledge())
    assert law is not None
    return law


def reader_for(run: Run, noise: float = 0.0) -> OffersReader:
    k = run.scenario.knowledge()
    shape = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
    return OffersReader(np.array(k.A), np.array(k.B), shape, law_told(run.scenario), noise)


Played = tuple[Run, Smoother, TapOutput, EavesdropperScore]


def played(
    seed: int,
    view: View = OFFERS,
    steps: int = 160,
    name: str = "sustained",
    alpha: float = 8.0,
    trial: int = size(40, TRIAL),
    first: int = size(200, FIRST),
) -> Played:
    """A run before a smoother who was told the policy; played once, for it takes long.

    She decodes ``first`` after so many steps, and tries scales on at most ``trial``.
    """
    return _played(seed, view, steps, name, alpha, trial, first)


@cache
def _played(
    seed: int, view: View, steps: int, name: str, alpha: float, trial: int, first: int
) -> Played:
    run = simulate(steps, seed, name=name, alpha=alpha)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(offers_reader, "TRIAL", trial)
        patch.setattr(smoother, "FIRST", first)
        tap = Smoother(view.knowledge(run.scenario.knowledge()))
        said = output_about(tap, heard_by(run, view))
    return run, tap, said, score(run.truth, said)


# --- the law -------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [3.0, 8.0])
def test_the_policy_gives_the_law_in_the_terminal_set(
    alpha: float, sustained_law: CandidateLaw
) -> None:
    law = law_told(scenario_at("sustained", alpha))
    x = RNG.uniform((-0.2, -1.0), (0.2, 1.0), (3000, 2))
    indices = sustained_law.indices(x)
    x, indices = x[indices == 0], indices[indices == 0]
    assert len(x) > 300
    offers = sustained_law.candidates_many(x, indices)
    assert np.abs(law.offers(x, 1 / alpha) - offers).max() < 5e-3


def test_the_policy_of_several_inputs_gives_the_free_candidates() -> None:
    scenario = scenario_at("quadruple-tank", 8.0)
    law = law_told(scenario)
    assert not law.facets
    for x in RNG.uniform(-0.01, 0.01, (20, 4)):
        offers = law_of("quadruple-tank").candidates(x.tolist())
        assert law.offers(x[None], 1.0)[0] == pytest.approx(np.array(offers), abs=1e-6)


def test_a_gain_that_does_not_contract_or_a_law_without_one_gives_no_facets() -> None:
    k = scenario_at("sustained", 8.0).knowledge()
    assert k.policy is not None
    for gain in (None, ((0.0, 0.0),), ((5.0, 5.0),)):
        policy = k.policy.model_copy(update={"gain": gain})
        law = KnownLaw.of(k.model_copy(update={"policy": policy}))
        assert law is not None
        assert not law.facets


def test_without_a_policy_or_a_model_there_is_no_law() -> None:
    k = scenario_at("sustained", 8.0).knowledge()
    for lacking in ("policy", "A", "B"):
        assert KnownLaw.of(k.model_copy(update={lacking: None})) is None


def test_the_policy_tells_no_secret_and_may_be_missing() -> None:
    k = scenario_at("sustained", 8.0).knowledge()
    assert k.policy is not None
    told = {"law", "costs", "gain", "together", "certain", "regulator", "spacing"}
    assert set(k.policy.model_dump()) == told
    assert k.policy == scenario_at("sustained", 2.0).knowledge().policy
    assert Knowledge.model_validate_json(k.model_dump_json()) == k
    old = k.model_dump(mode="json", exclude={"policy"})
    assert Knowledge.model_validate(old).policy is None


# --- offers alone --------------------------------------------------------------------------------


@pytest.mark.long
def test_offers_alone_give_most_keys_away() -> None:
    """Over 20 runs of 1000 steps it is measured: docs/findings.md."""
    keys = [played(seed)[3].keys_reviewed for seed in SEEDS]
    assert sum(k.of for k in keys) > 30
    assert sum(k.right for k in keys) >= 0.84 * sum(k.of for k in keys)


@pytest.mark.long
def test_offers_alone_give_message_bits_away() -> None:
    bits = [played(seed)[3].bits for seed in SEEDS]
    assert sum(b.right for b in bits) >= 0.75 * sum(b.of for b in bits)


@pytest.mark.long
def test_what_she_claims_is_what_comes_true() -> None:
    claimed, came = [], []
    for seed in SEEDS:
        run, tap, _, _ = played(seed)
        for guess in tap.review():
            key = run.truth.keys.get((run.messages[0].session, guess.k))
            if key is not None:
                claimed.append(max(guess.symbol))
                came.append(guess.best == key)
    p, hit = np.array(claimed), np.array(came)
    assert abs(p.mean() - hit.mean()) < 0.06
    assert hit[p > 0.97].mean() > 0.95
    assert 0.4 < hit[p < 0.75].mean() < 0.9


@pytest.mark.long
def test_constrained_candidates_do_not_poison_what_follows() -> None:
    """Most offers are: the unclipped ones alone would leave her far behind."""
    right = of = 0
    for seed in SEEDS:
        run, _, said, _ = played(seed)
        free = law_told(run.scenario).free[0]
        for t in heard_by(run, View()):
            at = (t.session, t.k)
            assert t.candidates is not None
            clipped = np.abs(free @ np.array(t.x) - t.candidates[0]).max() > 1e-6
            if clipped and at in run.truth.keys:
                right, of = right + (said.reviewed.get(at) == run.truth.keys[at]), of + 1
    assert of > 6
    assert right > 0.8 * of


LOSING = View(view="offers", loss=0.1, seed=3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("alpha", "seed", "view", "steps"),
    [(3.0, 3, LOSING, 120), (8.0, 1, OFFERS, 160)],
)
def test_the_width_of_the_defenders_set_is_learned(
    alpha: float, seed: int, view: View, steps: int
) -> None:
    _, tap, _, _ = played(seed, view, steps, alpha=alpha)
    assert tap.reader.width is not None
    low, high = tap.reader.width
    assert 0.93 / alpha < low < high < 1.08 / alpha
    assert high / low < 1.07
    # D is 10/12 of D_c here
    assert 0.6 / alpha < tap.reader.support < 1.2 / alpha


@pytest.mark.parametrize("alpha", [2.0, 3.0, 8.0])
def test_states_with_their_offers_tell_the_width_to_a_thousandth(alpha: float) -> None:
    run = simulate(1000, 0, alpha=alpha)
    heard = heard_by(run, View())
    x = np.array([t.x for t in heard])
    width, left = reader_for(run).width_of(x, np.array([t.candidates for t in heard]))
    assert width == pytest.approx(1 / alpha, rel=1e-3)
    assert left < 5e-3


def test_without_the_law_she_guesses_evenly() -> None:
    run = simulate(150, 0)
    knowledge = run.scenario.knowledge().model_copy(update={"policy": None})
    tap = Smoother(knowledge)
    output_about(tap, heard_by(run, OFFERS))
    assert {g.symbol for g in tap.review()} == {(0.5, 0.5)}


@pytest.mark.long
def test_lost_offers_are_bridged() -> None:
    run, tap, said, _ = played(3, LOSING, 120, alpha=3.0)
    heard = {t.k for t in heard_by(run, LOSING) if t.candidates}
    assert len(heard) < 114
    keys = {at: key for at, key in run.truth.keys.items() if at[1] in heard}
    assert sum(said.reviewed.get(at) == key for at, key in keys.items()) > 0.78 * len(keys)
    assert len(tap.review()) > 110


@pytest.mark.long
def test_a_plant_of_four_states_and_two_inputs_is_read_too() -> None:
    """Scales are tried as she goes, and again at the end."""
    _, _, _, scored = played(0, steps=120, name="quadruple-tank", trial=TRIAL, first=FIRST)
    assert scored.keys_reviewed.of > 15
    assert scored.keys_reviewed.right > 0.8 * scored.keys_reviewed.of


@pytest.mark.parametrize("name", ["paper", "double-integrator", "batch-reactor"])
def test_every_plant_can_be_listened_to(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offers_reader, "TRIAL", size(12, TRIAL))
    run = simulate(LEAST + 8, 0, name=name)
    steps = reader_for(run).infer(heard_by(run, OFFERS))
    assert len(steps) == LEAST + 7  # the last offer is not known to have been applied
    for step in steps:
        assert step.samples is not None
        assert step.samples.shape == (SAMPLES, 2)
        assert np.isfinite(step.samples).all()


@pytest.mark.long
def test_noise_that_hides_the_law_is_no_reason_to_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offers_reader, "TRIAL", size(12, TRIAL))
    run = simulate(LEAST + 2, 0)
    view = View(view="offers", quantise=0.5)
    steps = reader_for(run, noise=0.5 / np.sqrt(12)).infer(heard_by(run, view))
    assert all(s.samples is not None and np.isfinite(s.samples).all() for s in steps)


def test_too_few_offers_say_nothing() -> None:
    run = simulate(LEAST - 2, 0)
    steps = reader_for(run).infer(heard_by(run, OFFERS))
    assert steps
    assert all(s.samples is None for s in steps)
    assert reader_for(run).infer([]) == []


def test_sessions_are_read_apart() -> None:
    """The second is heard whole, so that no scale need be tried."""
    first, second = simulate(34, 4), simulate(34, 5)
    transitions = [*heard_by(first, OFFERS), *heard_by(second, View())]
    steps = reader_for(first).infer(transitions)
    assert [s.transition for s in steps] == transitions
    assert all(s.samples is not None for s in steps)


# --- both, in part -------------------------------------------------------------------------------


@pytest.mark.long
def test_lost_messages_are_inferred_by_the_law_that_she_was_told() -> None:
    _, tap, _, scored = played(0, View(loss=0.3, seed=0), 200)
    assert scored.keys_reviewed.right > 0.88 * scored.keys_reviewed.of
    assert scored.bits.right > 0.75 * scored.bits.of
    low, high = tap.reader.width or (0.0, 0.0)
    assert 0.995 / 8 < low < high < 1.005 / 8  # states beside their offers give it away


def test_what_was_heard_whole_is_exact() -> None:
    run = simulate(120, 5)
    view = View(loss=0.2, seed=5)
    clear = {t.k: t for t in heard_by(run, View())}
    k = run.scenario.knowledge()
    A, B, H = np.array(k.A), np.array(k.B), np.array(k.disturbance_H)
    whole = 0
    for step in reader_for(run).infer(heard_by(run, view)):
        if step.transition.whole:
            t = clear[step.transition.k]
            residual = np.array(t.x_next) - A @ np.array(t.x) - np.array(t.candidates) @ B.T
            gauges = (residual @ H.T / np.array(k.disturbance_h)).max(axis=1)
            assert step.samples is not None
            assert step.samples == pytest.approx(gauges[None], abs=1e-4)
            whole += 1
    assert whole > 20


def test_a_law_that_the_transcript_contradicts_is_not_believed() -> None:
    run = simulate(200, 6)
    heard = heard_by(run, View(loss=0.1, seed=6))
    assert reader_for(run).trusts(heard)
    assert reader_for(run).trusts(heard[:20])
    k = run.scenario.knowledge()
    assert k.policy is not None
    other = k.policy.model_copy(update={"gain": ((-3.0, -2.0),)})
    law = KnownLaw.of(k.model_copy(update={"policy": other}))
    assert law is not None
    assert law.facets
    shape = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
    reader = OffersReader(np.array(k.A), np.array(k.B), shape, law, 0.0)
    assert not reader.trusts(heard)


@pytest.mark.long
def test_noise_is_borne() -> None:
    view = View(noise=0.05, seed=0)
    _, _, _, scored = played(0, view, size(64, 80))
    assert scored.keys_reviewed.right > 0.85 * scored.keys_reviewed.of
