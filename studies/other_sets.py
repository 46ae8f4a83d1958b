"""What each eavesdropper makes of `sustained` where the test's set is not D_e made smaller.

A D_e of its own shape, and noise of the plant's own sensors: D_e then does not tell her the set by
which both ends test. She hears everything. ``python -m studies.other_sets`` puts the table of the
data on the page.
"""

import csv
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, Final

from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from studies import DATA
from studies.outputs import Counts, heard
from studies.pages import between_marks
from studies.readings import by_condition, told
from studies.signalling import changed
from tap_service.capture.channel import View
from wyner.simulate.engine import simulate_runs, transfer
from wyner.sweeps.code import ROOT

RUNS, STEPS, SEED = 10, 500, 7
MESSAGE: Final = b"Sail"
TAPS: Final = ("nearest-centre", "list-decoder", "fitted-box", "learning", "smoother", "text")

CONDITIONS: Final[dict[str, dict[str, Any]]] = {
    "D_e (0.24, 0.96)": {"secrecy": {"alpha": 1.0, "disturbance": {"half_widths": [0.24, 0.96]}}},
    "noise 20 % of D_c": {
        "plant": {"noise": {"half_widths": [0.02, 0.02]}},
        "defender": {"noise": {"half_widths": [0.024, 0.024]}},
    },
}
"""What is changed of the scenario, by name. D_c is (0.12, 0.12)."""

PAGE: Final = ROOT / "docs" / "findings.md"

COLUMNS: Final = (
    "condition", "tap", "runs", "steps", "seed", "keys_of", "keys", "keys_low", "keys_high",
    "delivered", "read", "read_low", "read_high",
)  # fmt: skip


def scenario_of(condition: str) -> Scenario:
    """`sustained`, changed."""
    return changed("sustained", **CONDITIONS[condition])


def other_set_rows() -> Iterator[tuple[Any, ...]]:
    """One row a condition and eavesdropper."""
    with ProcessPoolExecutor() as pool:
        found = {
            condition: [pool.submit(made_of, condition, run) for run in range(RUNS)]
            for condition in CONDITIONS
        }
        for condition, runs in found.items():
            by_tap = zip(*(run.result() for run in runs), strict=True)
            for tap, counts in zip(TAPS, by_tap, strict=True):
                yield (condition, tap, RUNS, STEPS, SEED, *told(counts))


def made_of(condition: str, run: int) -> list[Counts]:
    """What each eavesdropper makes of a run."""
    scenario = scenario_of(condition)
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(
        scenario, law, seed=SEED, runs=range(run, run + 1), steps=STEPS, record=True
    )
    return heard(TAPS, scenario, runs, transfer(runs, payloads=[MESSAGE]), View())


def written(text: str, rows: Sequence[dict[str, str]]) -> str:
    """The page with the table between its marks."""
    return between_marks(text, "other-sets", by_condition(rows, TAPS, CONDITIONS))


def recorded() -> list[dict[str, str]]:
    """The rows of the data file."""
    with (DATA / "other-sets.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), recorded()), encoding="utf-8")
