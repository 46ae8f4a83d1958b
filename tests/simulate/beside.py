"""The two ends beside the engine, which does the same to the last bit; and through what fails."""

from collections.abc import Iterator

from controller_service.laws.base import CandidateLaw
from protocol.link.session import CountedTransition
from protocol.scenario import Scenario
from tests.support.safety import violations
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.faults import Faults
from wyner.simulate.network import History, Simulation


def beside_the_engine(
    scenario: Scenario, law: CandidateLaw, steps: int, step_s: float | None
) -> list[CountedTransition]:
    """The plant's transitions, whose readings, states, coins and symbols are the engine's; seed 4.

    The controller has counted the same.
    """
    together = simulate_runs(scenario, law, seed=4, runs=range(2), steps=steps, record=True)
    history = Simulation(scenario, law, seed=4, run=1, step_s=step_s).run(steps=steps)
    link = transfer(together)
    assert together.x is not None
    assert together.truth is not None
    done = [t for t in history.plant.values() if t.k < steps]
    assert len(done) > 30
    for t in done:
        assert t.x == tuple(together.x[t.k, :, 1])
        assert t.x_next == tuple(together.x[t.k + 1, :, 1])
        assert (t.coin, t.symbol) == (together.coin[t.k, 1], link.agreed[t.k, 1])
        assert t.truth is not None
        assert t.truth.x_next == tuple(together.truth[t.k + 1, :, 1])
    for at, t in history.controller.items():
        assert history.plant[at].shared == t.shared
    return done


def through_deaths_and_losses(scenario: Scenario, law: CandidateLaw) -> Iterator[History]:
    """Four runs, each until its one message has arrived exactly once; seeds 0 to 3."""
    for seed in range(4):
        faults = Faults(loss=0.2, repeat=0.2, delay_s=0.1, crash=0.05, until_s=30)
        both = Simulation(scenario, law, seed=seed, payloads=(b"a",), faults=faults, step_s=0.1)
        history = both.run(seconds=300, until=lambda b=both: bool(b.history.inbox))  # type: ignore[misc]
        assert list(violations(history, (b"a",))) == []
        assert history.crashes > 0
        assert history.inbox == [b"a"]
        yield history
