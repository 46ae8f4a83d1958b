"""What each eavesdropper makes of `sustained` where the test's set is not D_e made smaller.

A D_e of its own shape, and noise of the plant's own sensors: D_e then does not tell her the set by
which both ends test. She hears everything.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

from protocol.scenario import Scenario
from studies.listeners import Counts, by_condition, heard, one_run, told
from studies.registry import Lines, Row, study, table
from studies.signalling import changed
from tap_service.capture.channel import View

RUNS, STEPS, SEED = 10, 500, 7
MESSAGE: Final = b"Sail"
TAPS: Final = ("nearest-centre", "list-decoder", "learning", "text")

CONDITIONS: Final[dict[str, dict[str, Any]]] = {
    "D_e (0.24, 0.96)": {"secrecy": {"alpha": 1.0, "disturbance": {"half_widths": [0.24, 0.96]}}},
    "noise 20 % of D_c": {
        "plant": {"noise": {"half_widths": [0.02, 0.02]}},
        "defender": {"noise": {"half_widths": [0.024, 0.024]}},
    },
}
"""What is changed of the scenario, by name. D_c is (0.12, 0.12)."""

COLUMNS: Final = (
    "condition tap runs steps seed keys_of keys keys_low keys_high delivered read read_low "
    "read_high"
)


def scenario_of(condition: str) -> Scenario:
    """`sustained`, changed."""
    return changed("sustained", **CONDITIONS[condition])


@study("other-sets", COLUMNS, lambda: CONDITIONS)
def other_set_rows(condition: str) -> Iterator[tuple[Any, ...]]:
    """One row an eavesdropper."""
    by_tap = zip(*(made_of(condition, run) for run in range(RUNS)), strict=True)
    for tap, counts in zip(TAPS, by_tap, strict=True):
        yield (condition, tap, RUNS, STEPS, SEED, *told(counts))


def made_of(condition: str, run: int) -> list[Counts]:
    """What each eavesdropper makes of a run."""
    made = one_run(scenario_of(condition), run, seed=SEED, steps=STEPS, payload=MESSAGE)
    return heard(TAPS, made, View())


@table("other-sets", "findings", "other-sets")
def shown(rows: Sequence[Row]) -> Lines:
    """Eavesdroppers down, conditions across."""
    return by_condition(rows, TAPS, CONDITIONS)
