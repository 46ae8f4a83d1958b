"""The worked step of docs/tutorial.md: one agreed transition of a seeded run, in numbers."""

from collections.abc import Sequence
from typing import Final, NamedTuple

from controller_service.laws.registry import cached_design
from protocol.agreement import predict
from protocol.link.session import CountedTransition
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from studies.registry import Lines, table
from wyner.simulate.network import Simulation

SEED: Final = 1
STEP: Final = 44
"""A transition of that run on which key symbol 1 is agreed, near the origin."""


class Worked(NamedTuple):
    """The transition that agrees, the one after it, and the coin of the first."""

    scenario: Scenario
    agreed: CountedTransition
    carried: CountedTransition
    coin: int


def worked() -> Worked:
    """Run the scenario ``sustained`` to the step after the one that is told."""
    from controller_service.laws.registry import make_law

    scenario = scenario_of("sustained")
    law = make_law(scenario, cached_design(scenario))
    simulation = Simulation(scenario, law, seed=SEED, payloads=(b"The old mill, at nine.",))
    history = simulation.run(steps=STEP + 2)
    first, second = (list(history.plant.values())[j] for j in (STEP, STEP + 1))
    if first.symbol < 0 or second.message_symbol < 0:
        raise ValueError(f"transition {STEP}: expected one that agrees")
    return Worked(scenario, first, second, first.coin)


def _vector(v: Sequence[float]) -> str:
    return f"({', '.join(f'{value:.4f}' for value in v)})"


@table("numbers", "tutorial")
def numbers() -> Lines:
    """The table of the page, one line a quantity."""
    return [("quantity", "value", "who knows it, or what it says"), *lines_of(worked())]


def lines_of(step: Worked) -> Lines:
    """The lines of a step."""
    t, scenario = step.agreed, step.scenario
    alpha = scenario.secrecy.alpha
    rows = [("x(k)", _vector(t.x), "in the measurement: everyone reads it")]
    for i, u in enumerate(t.candidates):
        rows.append((f"u_{i}", f"{u[0]:.4f}", "in the offer: everyone reads it"))
    rows.append(("b_r", str(step.coin), "the plant's coin: nobody else knows it"))
    for i, u in enumerate(t.candidates):
        centre = predict(scenario.A, scenario.B, t.x, u)
        rows.append(
            (f"c_{i} = A x + B u_{i}", _vector(centre), "computed by everyone who knows A and B")
        )
    rows.append(("x(k+1)", _vector(t.x_next), "in the next measurement: everyone reads it"))
    for i, g in enumerate(t.verdict.gauges):
        means = "inside D_c" if g <= 1 else f"outside D_c, inside D_e (alpha = {alpha:g})"
        rows.append((f"g_{i}", f"{g:.4f}", means))
    rows.append(("key symbol", str(t.symbol), "the one candidate inside D_c"))
    c = step.carried
    rows.append(("ciphertext symbol of the next offer", str(c.cipher), "everyone reads it"))
    rows.append(
        (
            "message symbol",
            f"({c.cipher} - {c.key}) mod {len(t.candidates)} = {c.message_symbol}",
            "what the plant recovers",
        )
    )
    return rows
