"""What studies of eavesdroppers share: a run, what is heard of it, what each makes of that."""

import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.relabelling import best_labels, pairs_of, right_under
from protocol.scenario import Scenario
from protocol.statistics import Interval, share_over_runs
from studies.registry import Lines, Row
from studies.secrecy.study import offline, put_together
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import Belief, named
from wyner.simulate.engine import Runs, Transfer, simulate_runs, transfer
from wyner.simulate.engine.link import whole_messages
from wyner.simulate.engine.taps import transcript

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


def heard_by(transitions: Sequence[Transition], view: View) -> list[Transition]:
    """The transitions that a tap with this view puts together of copies 0."""
    if view.clear:
        return list(transitions)
    return put_together(_messages(transitions), view)


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


def heard(taps: Sequence[str], run: tuple[Runs, Transfer], view: View) -> list[Counts]:
    """What each eavesdropper makes of a run, heard through ``view``."""
    runs, link = run
    transitions = heard_by(list(transcript(runs, link, 0)), view)
    return counted(taps, runs.scenario, link, view, transitions)


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


def _both(row: dict[str, str]) -> str:
    keys, read = (
        Interval(*(100 * float(row[name]) for name in (what, f"{what}_low", f"{what}_high")))
        for what in ("keys", "read")
    )
    count = round(float(row["read"]) * int(row["delivered"]))
    share = f"{count} of {row['delivered']} [{read.low:.0f}, {read.high:.0f}]"
    return f"{keys.value:.3g} [{keys.low:.3g}, {keys.high:.3g}]; {share}"
