"""What `text` makes of every plant that is shipped, and of each way of hearing it.

Keys that she knows, up to one relabelling for all steps, and whole messages. The same captures
before each tap.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from protocol.statistics import share_over_runs
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.listeners import Counts, heard, one_run
from studies.registry import Lines, Row, study, table
from studies.secrecy.sentences import SENTENCES
from tap_service.capture.channel import View
from wyner.simulate.engine import Runs, Transfer

RUNS, SEED = 20, 2043
TAPS: Final = ("text",)
SHORT: Final = b"Sail at dawn"
"""Where a run is too short for a sentence."""


class Condition(NamedTuple):
    """A scenario, how it is heard, steps, and whether its message is a whole sentence."""

    scenario: str
    view: dict[str, Any]
    steps: int
    sentence: bool = True

    @property
    def heard(self) -> str:
        """How, in words."""
        if "view" in self.view:
            return f"{self.view['view']} alone"
        return ", ".join(
            f"{value:.0%} missed" if name == "loss" else f"{name} {value:g}"
            for name, value in self.view.items()
        )

    @property
    def name(self) -> str:
        """Of the row."""
        return f"{self.scenario}, {self.heard}"


MEASUREMENTS: Final = {"view": "measurements"}
OFFERS: Final = {"view": "offers"}
LOSS: Final = {"loss": 0.3}
CONDITIONS: Final = (
    Condition("packed-quadruple-tank", MEASUREMENTS, 320),
    Condition("packed-batch-reactor", MEASUREMENTS, 320),
    Condition("nonlinear-quadruple-tank", MEASUREMENTS, 320),
    Condition("unicycle", MEASUREMENTS, 320),
    Condition("noisy", MEASUREMENTS, 320),
    Condition("packed-double-integrator", MEASUREMENTS, 320),
    Condition("quadruple-tank", MEASUREMENTS, 1000, False),
    Condition("batch-reactor", MEASUREMENTS, 1000, False),
    Condition("encoder", MEASUREMENTS, 600),
    Condition("packed", MEASUREMENTS, 320),
    Condition("sustained", MEASUREMENTS, 1000, False),
    Condition("packed-double-integrator", OFFERS, 320),
    Condition("packed-batch-reactor", OFFERS, 320),
    Condition("packed-quadruple-tank", OFFERS, 320),
    Condition("packed", OFFERS, 320),
    Condition("sustained", OFFERS, 1000, False),
    Condition("packed", LOSS, 320),
    Condition("packed", {"loss": 0.5}, 320),
    Condition("packed-double-integrator", LOSS, 320),
    Condition("packed-batch-reactor", LOSS, 320),
    Condition("packed-quadruple-tank", LOSS, 320),
    Condition("nonlinear-quadruple-tank", LOSS, 640),
    Condition("unicycle", LOSS, 640),
    Condition("noisy", LOSS, 640),
    Condition("sustained", LOSS, 1000, False),
    Condition("quadruple-tank", LOSS, 1000, False),
    Condition("batch-reactor", LOSS, 1000, False),
    Condition("packed", {"noise": 0.05}, 320),
    Condition("packed-double-integrator", {"noise": 0.05}, 320),
    Condition("sustained", {"noise": 0.05}, 1000, False),
    Condition("packed", {"quantise": 0.1}, 320),
)
"""What is heard of what: each plant's readings alone first."""

COLUMNS: Final = (
    "condition tap runs steps seed keys_of keys keys_low keys_high delivered read read_low "
    "read_high seconds"
)


def simulated(scenario_name: str, steps: int, run: int, payload: bytes = SHORT) -> Runs:
    """One run of a shipped scenario, with its plant as it is."""
    return _made(Condition(scenario_name, {}, steps), run, payload)[0]


def _made(condition: Condition, run: int, payload: bytes) -> tuple[Runs, Transfer]:
    scenario = load_scenario(SCENARIOS / f"{condition.scenario}.toml")
    steps = condition.steps
    return one_run(scenario, run, seed=SEED, steps=steps, payload=payload, folder=SCENARIOS)


def made_of(condition: Condition, run: int, taps: Sequence[str] = TAPS) -> list[Counts]:
    """What each tap makes of a run."""
    payload = SENTENCES[run].encode() if condition.sentence else SHORT
    return heard(taps, _made(condition, run, payload), View(seed=run, **condition.view))


@study("eavesdroppers", COLUMNS, lambda: CONDITIONS)
def rows(
    one: Condition, count: int = RUNS, taps: Sequence[str] = TAPS
) -> Iterator[tuple[Any, ...]]:
    """One row a tap."""
    by_tap = zip(*(made_of(one, run, taps) for run in range(count)), strict=True)
    for tap, counts in zip(taps, by_tap, strict=True):
        keys = share_over_runs((c.known, c.keys) for c in counts)
        read = share_over_runs((c.read, c.delivered) for c in counts)
        keys_of, delivered = sum(c.keys for c in counts), sum(c.delivered for c in counts)
        seconds = round(sum(c.seconds for c in counts) / count, 1)
        yield (
            one.name, tap, count, one.steps, SEED, keys_of, *keys, delivered, *read, seconds,
        )  # fmt: skip


@table("eavesdroppers", "findings", "eavesdroppers")
def shown(found: Sequence[Row]) -> Lines:
    """A line a condition, taps across: keys in %, messages read, seconds of a core."""
    taps = list(dict.fromkeys(row["tap"] for row in found))
    cells = {(row["condition"], row["tap"]): row for row in found}
    lines = [("heard", *(f"`{tap}`" for tap in taps))]
    for name in dict.fromkeys(row["condition"] for row in found):
        mine = [cells[name, tap] for tap in taps if (name, tap) in cells]
        lines.append((name, *(_told(row) for row in mine)))
    return lines


def _told(row: dict[str, str]) -> str:
    keys, low, high = (100 * float(row[name]) for name in ("keys", "keys_low", "keys_high"))
    said = f"{keys:.1f} [{low:.1f}, {high:.1f}]"
    if "measurements" in row["condition"] or not int(row["delivered"]):
        return said
    return f"{said}; {round(float(row['read']) * int(row['delivered']))} of {row['delivered']}"
