"""What studies of eavesdroppers share: a run, what is heard of it, what each makes of that."""

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage
from protocol.relabelling import best_labels, pairs_of, right_under
from protocol.scenario import Scenario
from protocol.statistics import share_over_runs
from studies.registry import Lines, Row, interval_of
from tap_service.capture.channel import View, WiretapChannel
from tap_service.capture.transcript import Transcript, Transition
from tap_service.eavesdroppers import Belief, Eavesdropper, named
from tap_service.eavesdroppers.text import Text
from wyner.simulate.engine import Runs, Transfer, simulate_runs, transfer
from wyner.simulate.engine.link import whole_messages
from wyner.simulate.engine.taps import public_messages

SESSION: Final = "0" * 16


def one_run(
    scenario: Scenario,
    run: int,
    *,
    seed: int,
    steps: int,
    payload: bytes,
    law: CandidateLaw | None = None,
    folder: Path = Path(),
) -> tuple[Runs, Transfer]:
    """One run with its record, under the scenario's own law by default, and what it carried."""
    law = law or make_law(scenario, cached_design(scenario))
    runs = simulate_runs(
        scenario, law, seed=seed, runs=range(run, run + 1), steps=steps, record=True, folder=folder
    )
    return runs, transfer(runs, payloads=[payload])


def put_together(messages: Iterable[FieldMessage], view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together of messages."""
    channel, made = WiretapChannel(view), Transcript()
    seen = [heard for message in messages for _, heard in channel.hear(0, message)]
    seen += [heard for _, heard in channel.rest()]
    return [t for message in seen for t in made.hear(message)] + made.flush()


def heard_of(runs: Runs, link: Transfer, view: View, place: int = 0) -> list[Transition]:
    """What a tap with this view puts together of a run's copies 0."""
    return put_together(public_messages(runs, link, place, SESSION), view)


def offline(kind: type[Eavesdropper], knowledge: Knowledge) -> Eavesdropper:
    """An eavesdropper for a whole capture: `text` reads it once, at the end."""
    return Text(knowledge, live=False) if kind is Text else kind(knowledge)


class Counts(NamedTuple):
    """What an eavesdropper made of a run.

    Keys, right at once and later, and known up to one relabelling; messages, those read; what it
    believes in the end; seconds of a core.
    """

    keys: int
    at_once: int
    later: int
    known: int
    delivered: int
    read: int
    belief: Belief
    seconds: float


def heard(
    taps: Sequence[str], made: tuple[Runs, Transfer], view: View, place: int = 0
) -> list[Counts]:
    """What each eavesdropper makes of a run, heard through ``view``."""
    runs, link = made
    scenario, transitions = runs.scenario, heard_of(runs, link, view, place)
    truth = {k: key for k, key in enumerate(link.agreed[:, place].tolist()) if key != NO_SYMBOL}
    messages = whole_messages(link.message_symbol[:, place].tolist(), scenario.secrecy.candidates)
    out = []
    for kind in map(named, taps):
        begun = time.process_time()
        tap = offline(kind, view.knowledge(scenario.knowledge(), model=kind.told_model))
        first = {t.k: tap.observe(t).best for t in transitions}
        second = first | {g.k: g.best for g in (*tap.final_guesses, *tap.review())}
        belief = tap.belief()
        at_once, later = (
            sum(said.get(k) == key for k, key in truth.items()) for said in (first, second)
        )
        pairs = pairs_of((second[k], key) for k, key in truth.items() if k in second)
        known = right_under(pairs, best_labels(pairs, scenario.secrecy.candidates))
        read = sum(m in belief.whole for m in messages)
        seconds = time.process_time() - begun
        out.append(Counts(len(truth), at_once, later, known, len(messages), read, belief, seconds))
    return out


def told(counts: Sequence[Counts]) -> tuple[float, ...]:
    """Keys, the share right in the end and its interval over runs; the same of messages."""
    keys = share_over_runs((one.later, one.keys) for one in counts)
    read = share_over_runs((one.read, one.delivered) for one in counts)
    return (sum(c.keys for c in counts), *keys, sum(c.delivered for c in counts), *read)


def by_condition(rows: Sequence[Row], taps: Sequence[str], conditions: Iterable[str]) -> Lines:
    """A table of keys in % and messages read: eavesdroppers down, conditions across."""
    cells = {(row["condition"], row["tap"]): row for row in rows}
    names = tuple(conditions)
    lines = [("tap", *names)]
    for tap in taps:
        lines.append((f"`{tap}`", *(_both(cells[name, tap]) for name in names)))
    return lines


def _both(row: Row) -> str:
    keys, read = (interval_of(row, name, 100) for name in ("keys", "read"))
    count = round(float(row["read"]) * int(row["delivered"]))
    share = f"{count} of {row['delivered']} [{read.low:.0f}, {read.high:.0f}]"
    return f"{keys.value:.3g} [{keys.low:.3g}, {keys.high:.3g}]; {share}"
