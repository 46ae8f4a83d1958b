"""What a claim gives in plant time, on the simulated loop; what she holds in a thousand blocks."""

from collections import Counter
from itertools import pairwise

import pytest

from controller_service.laws.base import CandidateLaw
from protocol.messages import Measurement, Offer
from protocol.scenario import Keys, Scenario
from tests.support.watched import Watched
from wyner.simulate.faults import Faults


def keyed(scenario: Scenario, eps_E: float, unheard_bits: int = 256) -> Scenario:
    keys = Keys(eps_E=eps_E, unheard_bits=unheard_bits)
    return scenario.model_copy(update={"keys": keys})


def seen(message: Measurement | Offer) -> tuple[str, int, int, int]:
    """What everyone can see of a message, beside the state it was sent in."""
    named = message.heard if isinstance(message, Offer) else message.applied_copy
    return message.topic, message.k, message.copy_number, named


@pytest.mark.long
def test_copies_do_not_tell_the_automatons_state(
    sustained: Scenario, sustained_law: CandidateLaw
) -> None:
    """Over 10,000 steps with losses and delays: first copies, repeats, copies named, gaps.

    A control beside each: one in ten of state 2 told otherwise moves it by more than 4.
    """
    faults = Faults(loss=0.2, repeat=0.1, delay_s=0.04)
    simulation = Watched(
        keyed(sustained, 0.3), sustained_law, seed=2, payloads=(b"x" * 1500,), faults=faults,
        step_s=0.1,
    )  # fmt: skip
    history = simulation.run(seconds=1080)
    role = {t.k: t.role for t in history.plant.values()}
    assert len(role) + history.missed > 10_000
    assert history.missed > 100
    said = [seen(m) for m in simulation.sent if isinstance(m, Measurement | Offer)]
    ks = sorted(role)
    gaps = [(str(role[k]), int(k - before > 1)) for before, k in pairwise(ks)]
    tables = {"steps missed before it": gaps}
    for topic in ("measurement", "offer"):
        for place in (2, 3):  # the copy's own number, and the partner's copy that it names
            tables[f"{topic} {place}"] = [
                (str(role[one[1]]), int(one[place]))
                for one in said
                if one[0] == topic and one[1] in role
            ]
    for name, table in tables.items():
        assert abs(_z(Counter(table))) < 4, name
        told = [(r, 1 if r == "message" and i % 10 == 0 else v) for i, (r, v) in enumerate(table)]
        assert _z(Counter(table)) - _z(Counter(told)) > 4, name


def _z(table: "Counter[tuple[str, int]]") -> float:
    """Difference of the shares of ones in the two states, in standard deviations."""
    of = {role: table[role, 0] + table[role, 1] for role in ("test", "message")}
    total = sum(of.values())
    p = sum(table[role, 1] for role in of) / total
    spread = (p * (1 - p) * sum(1 / n for n in of.values())) ** 0.5
    return float((table["test", 1] / of["test"] - table["message", 1] / of["message"]) / spread)
