"""What `text` makes of every plant that is shipped, and of each way of hearing it.

Keys that she knows, up to one relabelling for all steps, and whole messages. The same captures
before each tap.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.relabelling import best_labels, pairs_of, right_under
from protocol.statistics import share_over_runs
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.outputs import heard_by
from studies.registry import Lines, Row, study, table
from studies.secrecy.sentences import SENTENCES
from studies.secrecy.study import offline
from tap_service.capture.channel import View
from tap_service.eavesdroppers import named
from wyner.simulate.engine import Runs, simulate_runs, transfer
from wyner.simulate.engine.link import whole_messages
from wyner.simulate.engine.taps import transcript

RUNS, SEED = 20, 43
TAPS: Final = ("text", "smoother")
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
    Condition("packed", {"loss": 0.3}, 320),
    Condition("packed", {"loss": 0.5}, 320),
    Condition("packed-double-integrator", {"loss": 0.3}, 320),
    Condition("packed-batch-reactor", {"loss": 0.3}, 320),
    Condition("packed-quadruple-tank", {"loss": 0.3}, 320),
    Condition("nonlinear-quadruple-tank", {"loss": 0.3}, 640),
    Condition("unicycle", {"loss": 0.3}, 640),
    Condition("noisy", {"loss": 0.3}, 640),
    Condition("sustained", {"loss": 0.3}, 1000, False),
    Condition("quadruple-tank", {"loss": 0.3}, 1000, False),
    Condition("batch-reactor", {"loss": 0.3}, 1000, False),
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


class Counted(NamedTuple):
    """What a tap made of a run: keys, those known; messages, those read; seconds of a core."""

    keys: int
    known: int
    delivered: int
    read: int
    seconds: float


def simulated(scenario_name: str, steps: int, run: int) -> Runs:
    """One run of a shipped scenario, with its plant as it is."""
    scenario = load_scenario(SCENARIOS / f"{scenario_name}.toml")
    law = make_law(scenario, cached_design(scenario))
    runs = range(run, run + 1)
    return simulate_runs(
        scenario, law, seed=SEED, runs=runs, steps=steps, record=True, folder=SCENARIOS
    )


def made_of(condition: Condition, run: int, taps: Sequence[str] = TAPS) -> list[Counted]:
    """What each tap makes of a run."""
    runs = simulated(condition.scenario, condition.steps, run)
    scenario = runs.scenario
    payload = SENTENCES[run].encode() if condition.sentence else SHORT
    link = transfer(runs, payloads=[payload])
    view = View(seed=run, **condition.view)
    transitions = heard_by(list(transcript(runs, link, 0)), view)
    truth = {k: key for k, key in enumerate(link.agreed[:, 0].tolist()) if key != NO_SYMBOL}
    size = scenario.secrecy.candidates
    messages = whole_messages(link.message_symbol[:, 0].tolist(), size)
    out = []
    for kind in map(named, taps):
        begun = time.process_time()
        tap = offline(kind, view.knowledge(scenario.knowledge(), model=kind.told_model))
        said = {t.k: tap.observe(t).best for t in transitions}
        said |= {g.k: g.best for g in (*tap.final_guesses, *tap.review())}
        pairs = pairs_of((said[k], key) for k, key in truth.items() if k in said)
        known = right_under(pairs, best_labels(pairs, size))
        whole = tap.belief().whole
        read = sum(m in whole for m in messages)
        seconds = time.process_time() - begun
        out.append(Counted(len(truth), known, len(messages), read, seconds))
    return out


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
