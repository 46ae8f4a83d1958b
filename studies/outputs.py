"""What each eavesdropper makes of a plant of which an encoder alone is read.

Every draw of d and n is a corner of what both ends assume. All listen to the same runs: as they
are, over a network that loses, through noise of her own, and where she misses messages.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import wilson
from studies.corners import at_the_corners
from studies.listeners import Counts, heard, one_run
from studies.registry import Lines, Row, study, table
from tap_service.capture.channel import View

RUNS, STEPS, SEED = 10, 700, 11
MESSAGE: Final = b"We sail at dawn."
TAPS: Final = ("set-membership", "nearest-centre", "list-decoder", "learning", "text")

CONDITIONS: Final[dict[str, tuple[float, View]]] = {
    "clear": (0.0, View()),
    "loss 30 % each way": (0.3, View()),
    "loss 50 % each way": (0.5, View()),
    "Eve's noise 0.001": (0.0, View(noise=0.001)),
    "Eve misses 10 %": (0.0, View(loss=0.1)),
}
"""What the network loses each way, and what she hears, by name."""

COLUMNS: Final = (
    "condition tap runs steps seed keys_of at_once at_once_low at_once_high later later_low "
    "later_high delivered read read_low read_high"
)


def over(scenario: Scenario, loss: float) -> Scenario:
    """The scenario over a network that loses so much each way."""
    if not loss:
        return scenario
    data = scenario.model_dump(mode="json", exclude_none=True)
    data["network"] = {"to_plant": {"loss": loss}, "to_controller": {"loss": loss}}
    return parse_scenario(data, scenario.name)


def _counts(condition: str, run: int) -> list[Counts]:
    """Of a run, for each eavesdropper."""
    loss, view = CONDITIONS[condition]
    view = view.model_copy(update={"seed": run})
    scenario = over(at_the_corners("encoder"), loss)
    made = one_run(scenario, run, seed=SEED, steps=STEPS, payload=MESSAGE)
    return heard(TAPS, made, view)


@study("outputs", COLUMNS, lambda: CONDITIONS)
def output_rows(condition: str) -> Iterator[tuple[Any, ...]]:
    """One row an eavesdropper."""
    by_tap = zip(*(_counts(condition, place) for place in range(RUNS)), strict=True)
    for name, counts in zip(TAPS, by_tap, strict=True):
        of, delivered = sum(one.keys for one in counts), sum(one.delivered for one in counts)
        at_once, later = sum(one.at_once for one in counts), sum(one.later for one in counts)
        yield (
            condition, name, RUNS, STEPS, SEED, of, *_told(at_once, of), *_told(later, of),
            delivered, *_told(sum(one.read for one in counts), delivered),
        )  # fmt: skip


@table("outputs", "concepts", "outputs")
def shown(rows: Sequence[Row]) -> Lines:
    """The table of docs/concepts.md: eavesdroppers down, conditions across."""
    cells = {(row["condition"], row["tap"]): row for row in rows}
    of = {row["condition"]: row["keys_of"] for row in rows}
    lines = [("", *(f"{condition}, {of[condition]} keys" for condition in CONDITIONS))]
    for tap in TAPS:
        mine = [cells[condition, tap] for condition in CONDITIONS]
        lines.append(
            (f"`{tap}`", *(f"{row['later']}; {row['read']} of {row['delivered']}" for row in mine))
        )
    return lines


def _told(count: int, of: int) -> tuple[float, float, float]:
    if not of:
        return (0, 0.0, 1.0)
    share = wilson(count, of)
    return (count, share.low, share.high)
