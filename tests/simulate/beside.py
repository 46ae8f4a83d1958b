"""The two ends beside the engine, which does the same to the last bit; and through what fails."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_service.laws.base import CandidateLaw
from protocol.link.session import CountedTransition
from protocol.scenario import Scenario
from tests.support.safety import violations
from tests.support.watched import Watched
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.faults import Faults
from wyner.simulate.network import History, Simulation


def beside_the_engine(
    scenario: Scenario,
    law: CandidateLaw,
    steps: int,
    *,
    seed: int = 4,
    run: int = 1,
    folder: Path = Path(),
) -> list[CountedTransition]:
    """The plant's transitions on a virtual clock, all of whose numbers are the engine's.

    The engine makes another run beside it; the controller has counted the same.
    """
    record = simulate_runs(
        scenario, law, seed=seed, runs=range(run, run + 2), steps=steps, record=True, folder=folder
    )
    link = transfer(record, payloads=[b"ok"])
    ends = Simulation(
        scenario,
        law,
        seed=seed,
        run=run,
        payloads=(b"ok",),
        step_s=None if scenario.network is None else scenario.plant.period_s,
        folder=folder,
    )
    history = ends.run(steps=steps)
    assert record.x is not None
    assert record.u is not None
    assert record.candidates is not None
    assert record.gauges is not None
    done = [t for t in history.plant.values() if t.k < steps]
    missed = [] if record.missed is None else record.missed[:, 0].nonzero()[0].tolist()
    assert history.missed == len(missed)
    # the last offer may come after the last step
    made = [k for k in range(steps) if k not in missed]
    assert [t.k for t in done] == made[: len(done)]
    assert len(made) - len(done) <= (record.missed is not None)
    for t in done:
        assert t.x == tuple(record.x[t.k, :, 0])
        assert t.candidates == tuple(map(tuple, record.candidates[t.k, :, :, 0].tolist()))
        assert t.x_next == tuple(record.x[t.k + 1, :, 0])
        assert t.verdict.gauges == tuple(record.gauges[t.k, :, 0])
        assert t.coin == record.coin[t.k, 0]
        assert t.cipher == link.cipher[t.k, 0]
        assert (t.symbol, t.key) == (link.agreed[t.k, 0], link.pad[t.k, 0])
        assert t.message_symbol == link.message_symbol[t.k, 0]
        if record.truth is not None:
            assert t.truth is not None
            assert t.truth.x_next == tuple(record.truth[t.k + 1, :, 0])
    for at, t in history.controller.items():
        assert history.plant[at].shared == t.shared
    x = record.x if record.truth is None else record.truth
    assert record.state_cost == pytest.approx((x[1:] ** 2).sum(axis=(0, 1)))
    assert record.input_effort == pytest.approx((record.u**2).sum(axis=(0, 1)))
    Q, R = scenario.cost_weights
    costs = np.einsum("knr,n->r", x[1:] ** 2, Q) + np.einsum("kmr,m->r", record.u**2, R)
    assert record.cost == pytest.approx(costs)
    return done


BAD = Faults(loss=0.2, repeat=0.2, delay_s=0.1, crash=0.05, until_s=30)


def through_deaths_and_losses(
    scenario: Scenario, law: CandidateLaw, faults: Faults = BAD, step_s: float = 0.1, **more: Any
) -> Iterator[History]:
    """Four runs, each until its one message has arrived exactly once; seeds 0 to 3."""
    common: dict[str, Any] = {"payloads": (b"a",), "faults": faults, "step_s": step_s}
    for seed in range(4):
        both = Watched(scenario, law, seed=seed, **common, **more)
        history = both.run(seconds=4000 * step_s, until=lambda b=both: bool(b.history.inbox))  # type: ignore[misc]
        assert list(violations(history, (b"a",))) == []
        assert history.crashes > 0
        assert history.inbox == [b"a"]
        yield history
