"""The control law as one who was told the policy has it."""

import numpy as np
import pytest

from controller_service.laws.base import CandidateLaw
from protocol.knowledge import Knowledge
from studies.secrecy.runs import law_of, scenario_at
from tap_service.inference.law import KnownLaw, PlanarLaw

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("alpha", [3.0, 8.0])
def test_the_policy_gives_the_law_in_the_terminal_set(
    alpha: float, sustained_law: CandidateLaw
) -> None:
    law = PlanarLaw.of(scenario_at("sustained", alpha).knowledge())
    assert law is not None
    x = RNG.uniform((-0.2, -1.0), (0.2, 1.0), (3000, 2))
    indices = sustained_law.indices(x)
    x, indices = x[indices == 0], indices[indices == 0]
    assert len(x) > 300
    offers = sustained_law.candidates_many(x, indices)[:, :, 0]
    assert np.abs(law.of_width(1 / alpha).offers(x) - offers).max() < 5e-3


def test_the_policy_of_several_inputs_gives_the_free_candidates() -> None:
    law = KnownLaw.of(scenario_at("quadruple-tank", 8.0).knowledge())
    assert law is not None
    for x in RNG.uniform(-0.01, 0.01, (20, 4)):
        offers = law_of("quadruple-tank").candidates(x.tolist())
        assert law.free @ x == pytest.approx(np.array(offers), abs=1e-6)


def test_a_gain_that_does_not_contract_or_a_law_without_one_gives_no_facets() -> None:
    k = scenario_at("sustained", 8.0).knowledge()
    assert k.policy is not None
    for gain in (None, ((0.0, 0.0),), ((5.0, 5.0),)):
        policy = k.policy.model_copy(update={"gain": gain})
        assert PlanarLaw.of(k.model_copy(update={"policy": policy})) is None


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
