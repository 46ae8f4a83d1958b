"""The table of schemes: what each claims, what Eve leaves of it, what it costs the loop.

A case is a scenario and a scheme. Its runs are simulated, the eavesdroppers hear some of them, and
the one who knows most keys counts. A scheme in a file of one's own is a case like the others
(``python -m studies scheme FILE.py:NAME``).
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from math import log2
from typing import Any, Final, NamedTuple

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.arrays import Array
from protocol.messages import Measurement, Message, Offer
from protocol.plugins import names_a_file
from protocol.scenario import Scenario
from protocol.schemes.registry import make_scheme
from protocol.statistics import Interval, bits_left, mean_over_runs, wilson
from studies.registry import Lines, Row, interval_of, study, table
from studies.signalling import changed
from tap_service.capture.channel import View, WiretapChannel
from tap_service.capture.transcript import Transcript
from tap_service.eavesdroppers.key_solver import KeySolver
from wyner.advice.answer import PlainLaw, ratio_of_means
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import TapResult, listen
from wyner.simulate.network import Side, Simulation

RUNS, STEPS, SEED = 20, 1000, 2811
"""Runs of each case, all of them heard, and a seed that no test has."""

SETTLED: Final = STEPS // 2
"""Steps from which on the cost is counted: before that the loop is on its way from x(0)."""

TEXT: Final = b"At nine."
MESSAGES: Final = 100

SETS: Final = "D_c is a secret: Eve knows 8 D_c alone"
LIKELIHOOD: Final = "Eve's estimate of the input is worse"
MISSES: Final = "Eve misses 30 % of the messages"

SEES: Final = ("nearest-centre", "list-decoder")
CORRECTS: Final = ("nearest-centre",)


class Case(NamedTuple):
    """A scheme on a scenario, and what its secrecy rests on."""

    scheme: str
    scenario: str
    assumption: str = SETS
    eves: tuple[str, ...] = SEES
    seed: int = SEED

    def built(self) -> Scenario:
        """The scenario with the scheme."""
        return changed(self.scenario, secrecy={"scheme": self.scheme})


CASES: Final = (
    Case("switched", "paper"),
    Case("switched", "sustained"),
    Case("switched", "st-mpc"),
    Case("pipelined", "sustained"),
    Case("pipelined", "packed"),
    Case("pipelined", "khepera"),
    Case("pipelined", "stochastic", LIKELIHOOD, CORRECTS),
    Case("reconciled", "stochastic", LIKELIHOOD, CORRECTS),
    Case("reconciled-31", "stochastic", LIKELIHOOD, CORRECTS),
    Case("sealed", "sealed", MISSES, ("key-solver",)),
    Case("examples/own/pairs.py:Pairs", "packed"),
)

COLUMNS: Final = (
    "scheme scenario assumption runs steps seed claimed claimed_low claimed_high eve keys "
    "named delivered read true cost cost_low cost_high estimates_wrong wrong"
)


class Measured(NamedTuple):
    """Of a case: bits that each run carried, the strongest Eve, costs, and what was wrong.

    ``kept`` is the share of a claimed bit that she leaves at most. ``estimates`` is the share of
    the controller's symbols that are not the coin, ``wrong`` what of the keys differs at the ends.
    """

    bits: list[float]
    eve: str
    result: TapResult
    kept: float
    cost: Interval
    estimates: float
    wrong: float


def by_engine(case: Case) -> Measured:
    """A case whose runs the engine makes."""
    scenario = case.built()
    law = make_law(scenario, cached_design(scenario))
    size = scenario.secrecy.candidates
    runs = simulate_runs(scenario, law, seed=case.seed, runs=range(RUNS), steps=STEPS, record=True)
    link = transfer(runs, payloads=[TEXT] * MESSAGES)
    assert runs.x is not None
    assert runs.u is not None
    each = [listen(runs, link, list(case.eves), place) for place in range(RUNS)]
    eve, result = max(
        ((name, summed(of)) for name, of in zip(case.eves, zip(*each, strict=True), strict=True)),
        key=lambda one: (one[1].read, one[1].known),
    )
    named = wilson(result.known, result.agreements)
    kept = bits_left(1, size, named).high / log2(size) if result.agreements else 0.0
    corrects = make_scheme(scenario.secrecy.scheme, size).corrects
    told = runs.symbol >= 0
    return Measured(
        ((link.pad >= 0).sum(axis=0) * log2(size)).tolist(),
        eve,
        result,
        kept,
        beside_plain(scenario, law, case.seed, costs(scenario, runs.x, runs.u)),
        float((told & (runs.symbol != runs.coin)).sum() / max(1, told.sum())),
        float(words_wrong(scenario, runs.symbol, runs.coin)) if corrects else 0.0,
    )


def costs(scenario: Scenario, x: Array, u: Array) -> Array:
    """Each run's mean cost of a settled step; x of shape (steps + 1, n, R), u (steps, m, R)."""
    Q, R = scenario.cost_weights
    weighed = np.einsum("knr,n->kr", x[1:] ** 2, Q) + np.einsum("kmr,m->kr", u**2, R)
    out: Array = weighed[SETTLED:].mean(axis=0)
    return out


def beside_plain(scenario: Scenario, law: CandidateLaw, seed: int, cost: Array) -> Interval:
    """The cost as a ratio to that of u = K x, in runs with the same disturbances."""
    plain = simulate_runs(
        scenario,
        PlainLaw(scenario, law.design),
        seed=seed,
        runs=range(len(cost)),
        steps=STEPS,
        record=True,
    )
    assert plain.x is not None
    assert plain.u is not None
    return ratio_of_means(cost, costs(scenario, plain.x, plain.u))


def summed(parts: Sequence[TapResult]) -> TapResult:
    """The counts of several runs together."""
    fields = zip(
        *((p.agreements, p.right, p.known, p.delivered, p.read) for p in parts), strict=True
    )
    return TapResult(*(sum(column) for column in fields))


def words_wrong(scenario: Scenario, estimates: Any, coins: Any) -> float:
    """The share of words that the syndrome does not correct: more errors than the code allows."""
    code = make_scheme(scenario.secrecy.scheme, 2).code  # type: ignore[attr-defined]
    words = len(coins) // code.n
    off = (estimates != coins)[: words * code.n].reshape(words, code.n, -1).sum(axis=1)
    return float((off > code.t).mean())


class TappedSimulation(Simulation):
    """The two ends, with all that they say on the field bus in order."""

    def __init__(self, scenario: Scenario, law: CandidateLaw, *, seed: int, run: int) -> None:
        self.said: list[Measurement | Offer] = []
        super().__init__(scenario, law, seed=seed, run=run, payloads=(TEXT,) * MESSAGES)

    def send(self, to: Side, message: Message) -> None:
        """Note it, and send it."""
        if isinstance(message, Measurement | Offer):
            self.said.append(message)
        super().send(to, message)


def by_cores(case: Case) -> Measured:
    """A case whose keys only the two ends' own cores make."""
    scenario = case.built()
    law = make_law(scenario, cached_design(scenario))
    bits, paths, held, blocks, wrong = [], [], 0, 0, 0
    for run in range(RUNS):
        ends = TappedSimulation(scenario, law, seed=case.seed, run=run)
        made = [t for t in ends.run(steps=STEPS).plant.values() if t.k < STEPS]
        bits.append(sum(t.key >= 0 for t in made) * log2(scenario.secrecy.candidates))
        paths.append(([made[0].x, *(t.x_next for t in made)], [t.u for t in made]))
        theirs = ends.history.controller
        wrong += sum(
            at in theirs and theirs[at].key != t.key for at, t in ends.history.plant.items()
        )
        tap, channel, transcript = (
            KeySolver(scenario.knowledge()),
            WiretapChannel(View(loss=scenario.tap.loss, seed=case.seed + run)),
            Transcript(),
        )
        for message in ends.said:
            for _, seen in channel.hear(0, message):
                tap.hear(seen)
                for transition in transcript.hear(seen):
                    tap.observe(transition)
        keys = tap.belief().keys
        assert keys is not None
        held, blocks = held + keys.bits, blocks + keys.blocks
    assert blocks
    x, u = (np.stack([np.array(path[i]) for path in paths], axis=-1) for i in (0, 1))
    cost = beside_plain(scenario, law, case.seed, costs(scenario, x, u))
    result = TapResult(0, 0, 0, 0, 0, blocks, held)
    return Measured(bits, case.eves[0], result, float(held == 0), cost, 0.0, float(wrong))


@study("schemes", COLUMNS, lambda: CASES)
def scheme_rows(case: Case) -> Iterator[tuple[Any, ...]]:
    """The row of a case."""
    cores = make_scheme(case.built().secrecy.scheme, 2).from_stream
    m = by_cores(case) if cores else by_engine(case)
    claimed = mean_over_runs(Counter(round(b) for b in m.bits)).scaled(1 / STEPS)
    r = m.result
    yield (
        case.scheme, case.scenario, case.assumption, len(m.bits), STEPS, case.seed, *claimed,
        m.eve, r.key_blocks or r.agreements, r.key_bits if cores else r.known, r.delivered, r.read,
        claimed.value * m.kept, *m.cost, m.estimates, m.wrong,
    )  # fmt: skip


HEAD: Final = (
    "scheme", "scenario", "is secret if", "claimed bits a step", "true, at most",
    "the strongest Eve", "control cost", "estimates wrong", "keys wrong",
)  # fmt: skip


@table("schemes", "findings", "schemes")
def shown(rows: Sequence[Row]) -> Lines:
    """A line a case."""
    return [HEAD, *(_line(row) for row in rows)]


def _line(row: Row) -> tuple[str, ...]:
    name = f"`{row['scheme']}`"
    if names_a_file(row["scheme"]):
        name = f"a file of one's own, `{row['scheme'].rpartition('/')[2]}`"
    claimed, cost = (interval_of(row, what) for what in ("claimed", "cost"))
    eve = f"`{row['eve']}`: {row['named']} of {row['keys']} keys"
    if row["eve"] == KeySolver.name:
        eve = f"`{row['eve']}`: {row['named']} bits of {row['keys']} key blocks"
    elif int(row["delivered"]):
        eve += f", {row['read']} of {row['delivered']} messages"
    wrong = float(row["estimates_wrong"])
    return (
        name,
        f"`{row['scenario']}`",
        row["assumption"],
        claimed.text(".3g"),
        f"{float(row['true']):.2g}",
        eve,
        cost.text(".3g"),
        f"{100 * wrong:.2g} %" if wrong else "none",
        f"{100 * float(row['wrong']):.2g} % of words" if float(row["wrong"]) else "none",
    )


def with_own(scheme: str, scenario: str, seed: int) -> str:
    """The table on record, and a line for a scheme of one's own that is measured now."""
    from studies.registry import markdown_table, recorded, studies

    case = Case(scheme, scenario, seed=seed)
    corrects = make_scheme(scheme, 2).corrects
    own = studies()["schemes"].measured(case._replace(eves=CORRECTS) if corrects else case)
    return markdown_table(shown([*recorded("schemes"), *own]))
