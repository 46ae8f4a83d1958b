"""What eavesdroppers make of a message where the plant misses steps, and they miss messages.

The network loses measurements, so that in some steps the plant has no offer. Where she misses the
measurement after such a step too, nothing tells her that no symbol was carried in it.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from protocol.messages import FieldMessage, Measurement, Offer
from protocol.scenario import Scenario, parse_scenario
from studies.listeners import SESSION, Counts, by_condition, counted, one_run, told
from studies.registry import Lines, Row, study, table
from studies.secrecy.sentences import SENTENCES
from studies.secrecy.study import put_together
from studies.signalling import changed
from tap_service.capture.channel import View
from wyner.simulate.engine import Runs, Transfer
from wyner.simulate.engine.taps import transcript

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


def messages_of(runs: Runs, link: Transfer) -> Iterator[FieldMessage]:
    """All that the two ends of the first run say: in a missed step the plant alone speaks."""
    made = {t.k: t for t in transcript(runs, link, 0)}
    assert runs.x is not None
    x = [tuple(row) for row in runs.x[:, :, 0].tolist()]
    applied, after = -1, x[0]
    for k, now in enumerate(x):
        yield Measurement(session=SESSION, k=k, x=now, applied_k=applied, x_after=after)
        if (t := made.get(k)) is not None:
            assert t.candidates is not None
            assert t.cipher is not None
            assert t.x_next is not None
            yield Offer(session=SESSION, k=k, candidates=t.candidates, cipher=t.cipher)
            applied, after = k, t.x_next


class Heard(NamedTuple):
    """Of one run: steps that the plant missed, those she takes for possible, and the counts."""

    missed: int
    not_told: int
    counts: list[Counts]


def made_of(condition: str, run: int) -> Heard:
    """What each eavesdropper makes of a run."""
    of, scenario = CONDITIONS[condition], scenario_of(condition)
    payload = SENTENCES[run].encode()[: of.characters]
    runs, link = one_run(scenario, run, seed=SEED, steps=of.steps, payload=payload)
    view = View(loss=of.missed, seed=run)
    transitions = put_together(messages_of(runs, link), view)
    assert runs.missed is not None
    missed = runs.missed[:, 0]
    not_told = sum(bool(missed[t.k]) for t in transitions)
    counts = counted(TAPS, scenario, link, view, transitions)
    return Heard(int(missed.sum()), not_told, counts)


@study("missed-steps", COLUMNS, lambda: CONDITIONS)
def missed_rows(condition: str) -> Iterator[tuple[Any, ...]]:
    """One row an eavesdropper."""
    runs = [made_of(condition, run) for run in range(RUNS)]
    totals = sum(run.missed for run in runs), sum(run.not_told for run in runs)
    steps = CONDITIONS[condition].steps
    by_tap = zip(*(run.counts for run in runs), strict=True)
    for tap, counts in zip(TAPS, by_tap, strict=True):
        yield (condition, tap, RUNS, steps, SEED, LOST, *totals, *told(counts))


@table("missed-steps", "findings", "missed-steps")
def shown(rows: Sequence[Row]) -> Lines:
    """Eavesdroppers down, conditions across."""
    return by_condition(rows, TAPS, CONDITIONS)
