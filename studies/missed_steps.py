"""What eavesdroppers make of a message where the plant misses steps, and they miss messages.

The network loses measurements, so that in some steps the plant has no offer. Where she misses the
measurement after such a step too, nothing tells her that no symbol was carried in it.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from protocol.scenario import Scenario, parse_scenario
from studies.listeners import Counts, by_condition, heard, heard_of, one_run, told
from studies.registry import Lines, Row, study, table
from studies.secrecy.sentences import SENTENCES
from studies.signalling import changed
from tap_service.capture.channel import View

RUNS, SEED = 10, 5
LOST: Final = 0.03
"""Share of measurements that the network loses, each sent once."""
TAPS: Final = ("nearest-centre", "list-decoder", "text")


class Condition(NamedTuple):
    """A scenario, the characters of its message, steps, and the share of messages she misses."""

    scenario: str
    characters: int
    steps: int
    missed: float


CONDITIONS: Final = {
    "`packed`, Eve misses 30 %": Condition("packed", 100, 330, 0.3),
    "`sustained`, Eve misses 10 %": Condition("sustained", 4, 500, 0.1),
}

COLUMNS: Final = (
    "condition tap runs steps seed lost plant_missed not_told keys_of keys keys_low "
    "keys_high delivered read read_low read_high"
)


def scenario_of(condition: str) -> Scenario:
    """The scenario with its network; `packed` with four candidates."""
    name = CONDITIONS[condition].scenario
    secrecy = {"candidates": 4} if name == "packed" else {}
    data = changed(name, secrecy=secrecy).model_dump(mode="json", exclude_none=True)
    data["link"] |= {"fallback": "zero", "repeats_per_period": 1}
    data["network"] = {"to_controller": {"loss": LOST}}
    return parse_scenario(data, name)


def made_of(condition: str, run: int) -> tuple[int, int, list[Counts]]:
    """Of a run: steps that the plant missed, those she takes for possible, and the counts."""
    of = CONDITIONS[condition]
    payload = SENTENCES[run].encode()[: of.characters]
    made = one_run(scenario_of(condition), run, seed=SEED, steps=of.steps, payload=payload)
    view, missed = View(loss=of.missed, seed=run), made[0].missed
    assert missed is not None
    not_told = sum(bool(missed[t.k, 0]) for t in heard_of(*made, view))
    return int(missed.sum()), not_told, heard(TAPS, made, view)


@study("missed-steps", COLUMNS, lambda: CONDITIONS)
def missed_rows(condition: str) -> Iterator[tuple[Any, ...]]:
    """One row an eavesdropper."""
    missed, not_told, counts = zip(*(made_of(condition, run) for run in range(RUNS)), strict=True)
    totals, steps = (sum(missed), sum(not_told)), CONDITIONS[condition].steps
    for tap, of_runs in zip(TAPS, zip(*counts, strict=True), strict=True):
        yield (condition, tap, RUNS, steps, SEED, LOST, *totals, *told(of_runs))


@table("missed-steps", "findings", "missed-steps")
def shown(rows: Sequence[Row]) -> Lines:
    """Eavesdroppers down, conditions across."""
    return by_condition(rows, TAPS, CONDITIONS)
