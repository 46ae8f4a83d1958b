"""What noise of the plant's own sensors leaves: candidates, keys, and the eavesdroppers."""

from collections.abc import Iterator
from typing import Any, Final

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law, synthesise
from controller_service.sets.design import SynthesisError
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import wilson
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import TapResult, listen
from wyner.sweeps.grid import SOURCES as LOOP_SOURCES
from wyner.sweeps.grid import TAP_SOURCES

SOURCES: Final = ("studies/readings.py", *LOOP_SOURCES, *TAP_SOURCES)
"""Where the numbers of this module come from."""

SHARES: Final = (0.05, 0.2, 0.3, 0.5)
"""Half-width of the noise over that of D_c, in each coordinate."""
RUNS, STEPS, SEED = 20, 500, 7
TAPPED, TAPPED_STEPS = 2, 500
MESSAGE: Final = b"We sail at dawn."
TAPS: Final = ("nearest-centre", "list-decoder", "learning", "text")

COLUMNS: Final = (
    "share",
    "candidates",
    "runs",
    "steps",
    "seed",
    "agreed",
    "agreed_low",
    "wrong",
    "impossible",
    "tapped_runs",
    "tapped_steps",
    "delivered",
    *(f"{tap} {what}" for tap in TAPS for what in ("keys right", "of keys", "read")),
)


def noisy(share: float, candidates: int) -> Scenario:
    """The shipped scenario ``noisy`` with d in the corners of D_c, and n in those of N."""
    base = load_scenario(SCENARIOS / "noisy.toml")
    widths = base.defender.disturbance.half_widths
    assert widths is not None
    N = [share * w for w in widths]
    data = base.model_dump(mode="json", exclude_none=True)
    data["plant"]["disturbance"] = {"kind": "corners", "half_widths": list(widths)}
    data["plant"]["noise"] = {"kind": "corners", "half_widths": N}
    data["defender"]["noise"] = {"half_widths": N}
    data["secrecy"]["candidates"] = candidates
    return parse_scenario(data, f"noise {share:g}")


def largest(share: float) -> tuple[Scenario, CandidateLaw]:
    """The scenario with as many candidates as the rule allows beside this noise."""
    for candidates in range(8, 1, -1):
        scenario = noisy(share, candidates)
        try:
            return scenario, make_law(scenario, synthesise(scenario))
        except SynthesisError:
            continue
    raise SynthesisError(f"defender.noise: {share:g} of D_c leaves no two candidates")


def reading_rows() -> Iterator[tuple[Any, ...]]:
    """One row a share of noise."""
    for share in SHARES:
        scenario, law = largest(share)
        runs = simulate_runs(scenario, law, seed=SEED, runs=range(RUNS), steps=STEPS)
        possible = runs.largest <= scenario.secrecy.alpha
        agreed = possible & (runs.symbol != NO_SYMBOL)
        count = int(agreed.sum())
        heard = list(_heard(scenario, law))
        yield (
            share,
            scenario.secrecy.candidates,
            RUNS,
            STEPS,
            SEED,
            count / agreed.size,
            wilson(count, agreed.size).low,
            int((agreed & (runs.symbol != runs.coin)).sum()),
            int((~possible).sum()),
            TAPPED,
            TAPPED_STEPS,
            sum(one[0].delivered for one in heard),
            *(
                sum(getattr(one[place], what) for one in heard)
                for place in range(len(TAPS))
                for what in ("right", "agreements", "read")
            ),
        )


def _heard(scenario: Scenario, law: CandidateLaw) -> Iterator[list[TapResult]]:
    runs = simulate_runs(
        scenario, law, seed=SEED, runs=range(TAPPED), steps=TAPPED_STEPS, record=True
    )
    link = transfer(runs, payloads=[MESSAGE])
    for place in range(TAPPED):
        yield listen(runs, link, TAPS, place)
