"""What `text` makes of every plant that is shipped, and of each way of hearing it.

Keys that it knows, up to one relabelling for all steps, whole messages, and what it states of them.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from protocol.statistics import share_over_runs
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.listeners import heard, one_run
from studies.registry import Lines, Row, study, table
from studies.secrecy.sentences import SENTENCES
from studies.secrecy.tables import median
from tap_service.capture.channel import View

RUNS, SEED = 20, 2043
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

Task = tuple[Condition, int]
"""A condition, and the number of a run."""

COLUMNS: Final = (
    "condition run seed steps keys known delivered read probability likeliest_exact bits_left "
    "message_bits seconds"
)


def tasks() -> Iterator[Task]:
    """Every condition of the first run, then of the next: what is on record is even."""
    return ((condition, run) for run in range(RUNS) for condition in CONDITIONS)


@study("eavesdroppers", COLUMNS, tasks)
def rows(task: Task) -> Iterator[tuple[Any, ...]]:
    """One row."""
    one, run = task
    payload = SENTENCES[run].encode() if one.sentence else SHORT
    scenario = load_scenario(SCENARIOS / f"{one.scenario}.toml")
    made = one_run(scenario, run, seed=SEED, steps=one.steps, payload=payload, folder=SCENARIOS)
    (counts,) = heard(("text",), made, View(seed=run, **one.view))
    belief, bits = counts.belief, 8 * len(payload)  # no message leaves more
    yield (
        one.name, run, SEED, one.steps, counts.keys, counts.known, counts.delivered, counts.read,
        f"{belief.confidence:.6g}", int(belief.message == payload),
        "" if belief.bits_left is None else f"{min(belief.bits_left, bits):.3f}", bits,
        round(counts.seconds, 1),
    )  # fmt: skip


@table("eavesdroppers", "findings", "eavesdroppers")
def shown(found: Sequence[Row]) -> Lines:
    """A line a condition: keys in %, messages read, bits left where it is stated, seconds."""
    lines: list[tuple[str, ...]] = [
        ("what is heard", "runs", "keys known, %", "messages read", "bits left of", "seconds"),
    ]
    for name in dict.fromkeys(row["condition"] for row in found):
        mine = [row for row in found if row["condition"] == name]
        keys = share_over_runs((int(row["known"]), int(row["keys"])) for row in mine)
        delivered = sum(int(row["delivered"]) for row in mine)
        read = share_over_runs((int(row["read"]), int(row["delivered"])) for row in mine)
        left = [float(row["bits_left"]) for row in mine if row["bits_left"]]
        ciphers = delivered and "measurements" not in name
        lines.append(
            (
                name,
                str(len(mine)),
                keys.scaled(100).text(".1f"),
                f"{round(read.value * delivered)} of {delivered}" if ciphers else "-",
                f"{median(left).text('.1f')} of {mine[0]['message_bits']}" if left else "-",
                f"{median([float(row['seconds']) for row in mine]).value:.1f}",
            )
        )
    return lines
