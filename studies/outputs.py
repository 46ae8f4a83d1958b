"""What each eavesdropper makes of a plant of which an encoder alone is read.

Every draw of d and n is a corner of what both ends assume. All listen to the same runs: as they
are, over a network that loses, through noise of her own, and where she misses messages.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import wilson
from studies.corners import at_the_corners
from studies.registry import Lines, Row, study, table
from studies.secrecy.study import offline
from tap_service.capture.channel import View, WiretapChannel
from tap_service.capture.transcript import Transcript, Transition
from tap_service.eavesdroppers import named
from wyner.simulate.engine import Runs, Transfer, simulate_runs, transfer
from wyner.simulate.engine.link import whole_messages
from wyner.simulate.engine.taps import transcript

RUNS, STEPS, SEED = 10, 700, 11
SESSION: Final = "0" * 16
MESSAGE: Final = b"We sail at dawn."
TAPS: Final = (
    "set-membership", "nearest-centre", "list-decoder", "fitted-box", "learning", "smoother",
    "text",
)  # fmt: skip

CONDITIONS: Final[dict[str, tuple[float, View]]] = {
    "clear": (0.0, View()),
    "loss 30 % each way": (0.3, View()),
    "loss 50 % each way": (0.5, View()),
    "her noise 0.001": (0.0, View(noise=0.001)),
    "she misses 10 %": (0.0, View(loss=0.1)),
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


def heard_by(transitions: Sequence[Transition], view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together of copies 0."""
    if view.clear:
        return list(transitions)
    return put_together(_messages(transitions), view)


def put_together(messages: Iterable[FieldMessage], view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together of messages."""
    channel, made = WiretapChannel(view), Transcript()
    out: list[Transition] = []
    for message in messages:
        for _, seen in channel.hear(0, message):
            out += made.hear(seen)
    return out + made.flush()


def _messages(transitions: Sequence[Transition]) -> Iterator[FieldMessage]:
    """A measurement and an offer a step, and the last measurement."""
    applied, after = -1, transitions[0].x
    for t in transitions:
        assert t.x is not None
        assert t.candidates is not None
        assert t.cipher is not None
        assert after is not None
        yield Measurement(session=SESSION, k=t.k, x=t.x, applied_k=applied, x_after=after)
        yield Offer(session=SESSION, k=t.k, candidates=t.candidates, cipher=t.cipher)
        applied, after = t.k, t.x_next
    assert after is not None
    yield Measurement(session=SESSION, k=applied + 1, x=after, applied_k=applied, x_after=after)


class Counts(NamedTuple):
    """What an eavesdropper made of a run: keys, right at once and later; messages, those read."""

    keys: int
    at_once: int
    later: int
    delivered: int
    read: int


def _counts(condition: str, run: int) -> list[Counts]:
    """Of a run, for each eavesdropper."""
    loss, view = CONDITIONS[condition]
    view = view.model_copy(update={"seed": run})
    scenario = over(at_the_corners("encoder"), loss)
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(
        scenario, law, seed=SEED, runs=range(run, run + 1), steps=STEPS, record=True
    )
    return heard(TAPS, scenario, runs, transfer(runs, payloads=[MESSAGE]), view)


def heard(
    taps: Sequence[str], scenario: Scenario, runs: Runs, link: Transfer, view: View
) -> list[Counts]:
    """What each eavesdropper makes of the first run, heard through ``view``."""
    return counted(taps, scenario, link, view, heard_by(list(transcript(runs, link, 0)), view))


def counted(
    taps: Sequence[str],
    scenario: Scenario,
    link: Transfer,
    view: View,
    transitions: Sequence[Transition],
) -> list[Counts]:
    """What each eavesdropper makes of ``transitions``, which were heard through ``view``."""
    truth = {k: key for k, key in enumerate(link.agreed[:, 0].tolist()) if key != NO_SYMBOL}
    messages = whole_messages(link.message_symbol[:, 0].tolist(), scenario.secrecy.candidates)
    out = []
    for kind in map(named, taps):
        tap = offline(kind, view.knowledge(scenario.knowledge(), model=kind.told_model))
        first = {t.k: tap.observe(t).best for t in transitions}
        second = first | {g.k: g.best for g in (*tap.final_guesses, *tap.review())}
        whole = tap.belief().whole
        at_once, later = (
            sum(said.get(k) == key for k, key in truth.items()) for said in (first, second)
        )
        read = sum(m in whole for m in messages)
        out.append(Counts(len(truth), at_once, later, len(messages), read))
    return out


@study("outputs", COLUMNS, lambda: CONDITIONS)
def output_rows(condition: str) -> Iterator[tuple[Any, ...]]:
    """One row an eavesdropper."""
    totals = np.sum([_counts(condition, place) for place in range(RUNS)], axis=0)
    for name, (of, at_once, later, delivered, read) in zip(TAPS, totals.tolist(), strict=True):
        yield (
            condition, name, RUNS, STEPS, SEED, of,
            *(v for count in (at_once, later) for v in _told(count, of)),
            delivered, *_told(read, delivered),
        )  # fmt: skip


@table("outputs", "control", "outputs")
def shown(rows: Sequence[Row]) -> Lines:
    """The table of docs/control.md: eavesdroppers down, conditions across."""
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
