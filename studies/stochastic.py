"""What is left of a corrected word under one Eve and another; see the scheme `reconciled`.

Eve has a word of her own, an estimate of each coin. What differs from the controller's are her
errors, and the bits in clear correct them as they do the plant's. Where she has more than the code
corrects she tries words in order of their distance from her own: of those at her distance or nearer
one in 2^clear is not ruled out by the bits in clear.
"""

from collections.abc import Callable, Iterator, Sequence
from math import comb, erfc, log2, sqrt
from typing import Any, Final, NamedTuple

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from protocol.arrays import Array, Flags, Indices
from protocol.scenario import Scenario
from protocol.schemes.reconciled import Reconciled
from protocol.schemes.registry import make_scheme
from protocol.statistics import normal_mean, share_over_runs
from studies.registry import Lines, Row, interval_of, study, table
from studies.signalling import changed
from tap_service.inference.identification import identify
from wyner.simulate.engine import Runs, simulate_runs

RUNS, STEPS, SEED = 40, 2016, 2812
"""Thirty-two words of 63, sixty-five of 31, in each run."""

FIRST, GROWTH = 12, 1.25
"""Transitions before the one who learns fits first, and how many times as many before she does
again."""

SCHEMES: Final = ("reconciled", "reconciled-31")


class NoisyModel(NamedTuple):
    """A, B and the deviations of d, as somebody takes them."""

    A: Array
    B: Array
    deviations: Array

    def estimates(self, x: Array, candidates: Array, x_next: Array) -> Indices:
        """The likeliest candidate of each step, shape (steps,)."""
        off = x_next[:, None] - (x @ self.A.T)[:, None] - candidates @ self.B.T
        out: Indices = (off**2 / self.deviations**2).sum(axis=2).argmin(axis=1)
        return out


Hearing = Callable[[NoisyModel, Array, Array, Array, np.random.Generator], Indices]
"""Takes the true model, x, the candidates and x_next of a run; her estimates."""


def wrong_covariance(factor: float) -> Hearing:
    """She takes the first state's deviation for so many times smaller."""

    def hears(
        true: NoisyModel, x: Array, u: Array, after: Array, _: np.random.Generator
    ) -> Indices:
        return true._replace(deviations=true.deviations / [factor, 1.0]).estimates(x, u, after)

    return hears


def wrong_model(share: float) -> Hearing:
    """Each entry of her A and B is wrong by that share, up or down."""

    def hears(
        true: NoisyModel, x: Array, u: Array, after: Array, draw: np.random.Generator
    ) -> Indices:
        A, B = (M * (1 + share * draw.choice([-1, 1], M.shape)) for M in (true.A, true.B))
        return true._replace(A=A, B=B).estimates(x, u, after)

    return hears


def learns(_: NoisyModel, x: Array, u: Array, after: Array, draw: np.random.Generator) -> Indices:
    """She is told nothing: guesses, fits, and estimates with what she has, from then on.

    A law that is linear leaves her two models, with B and with -B. She names as she did before.
    """
    out = draw.integers(2, size=len(x))
    heard = FIRST
    while heard < len(x):
        fit = identify(x[:heard], u[:heard], after[:heard], refine=False)
        off = after[:heard] - x[:heard] @ fit.A.T - fit.offset
        off -= np.einsum("kj,ij->ki", u[np.arange(heard), fit.choice], fit.B)
        hers = NoisyModel(fit.A, fit.B, off.std(axis=0))
        until = min(len(x), max(heard + 1, int(heard * GROWTH)))
        guessed = hers.estimates(x[:until], u[:until], after[:until])
        if heard > FIRST and (guessed[FIRST:heard] != out[FIRST:heard]).mean() > 0.5:
            guessed = 1 - guessed
        out[heard:until] = guessed[heard:]
        heard = until
    return out


EVES: Final[dict[str, Hearing]] = {
    "the same model": wrong_covariance(1.0),
    "a deviation 3 times too small": wrong_covariance(3.0),
    "a deviation 10 times too small": wrong_covariance(10.0),
    "A, B wrong by 10 %": wrong_model(0.1),
    "A, B wrong by 30 %": wrong_model(0.3),
    "told nothing, learns": learns,
}

COLUMNS: Final = (
    "scheme eve runs steps seed words expected before before_low before_high after after_low "
    "after_high syndrome clear key her_errors corrected corrected_low corrected_high left left_low "
    "left_high last_wrong"
)


def left(scheme: Reconciled, errors: int) -> float:
    """Bits of a word's keys that are left at most, where her word has so many errors."""
    if errors <= scheme.code.t:
        return 0.0
    nearer = log2(sum(comb(scheme.code.n, i) for i in range(errors + 1)))
    return min(float(scheme.key_bits), max(0.0, nearer - scheme.clear_bits))


def expected_errors(scenario: Scenario, candidates: Array) -> float:
    """How often the likelier of two inputs is the wrong one: Q of half their distance."""
    assert scenario.defender.deviations is not None
    apart = (candidates[0] - candidates[1]) @ np.array(scenario.B).T
    return erfc(float(np.linalg.norm(apart / scenario.defender.deviations)) / sqrt(8)) / 2


def words(off: Flags, n: int) -> Array:
    """Errors of each whole word, shape (words,)."""
    out: Array = off[: len(off) // n * n].reshape(-1, n).sum(axis=1)
    return out


@study("stochastic", COLUMNS, lambda: SCHEMES)
def stochastic_rows(name: str) -> Iterator[tuple[Any, ...]]:
    """A row an Eve."""
    scenario, scheme = changed("stochastic", secrecy={"scheme": name}), make_scheme(name, 2)
    assert isinstance(scheme, Reconciled)
    law, n = make_law(scenario, cached_design(scenario)), scheme.code.n
    runs = simulate_runs(scenario, law, seed=SEED, runs=range(RUNS), steps=STEPS, record=True)
    assert runs.x is not None
    assert runs.candidates is not None
    true = NoisyModel(
        np.array(scenario.A), np.array(scenario.B), np.array(scenario.defender.deviations)
    )
    wrong = runs.symbol != runs.coin
    plant = [words(wrong[:, r], n) for r in range(RUNS)]
    before = share_over_runs((int(w.sum()), len(wrong)) for w in wrong.T)
    after = share_over_runs((int((e > scheme.code.t).sum()), len(e)) for e in plant)
    expected = expected_errors(scenario, runs.candidates[0, :, :, 0])
    for eve, hears in EVES.items():
        off = [her_errors(runs, r, true, hears) for r in range(RUNS)]
        errors = [words(o, n) for o in off]
        corrected = share_over_runs((int((e <= scheme.code.t).sum()), len(e)) for e in errors)
        of_runs = [float(np.mean([left(scheme, int(v)) for v in e])) for e in errors]
        last = [int(np.flatnonzero(e > scheme.code.t).max(initial=-1)) + 1 for e in errors]
        yield (
            name, eve, RUNS, STEPS, SEED, sum(map(len, errors)), expected, *before, *after,
            scheme.code.check_bits, scheme.clear_bits, scheme.key_bits,
            float(np.mean(off)), *corrected,
            *normal_mean(sum(of_runs), sum(v * v for v in of_runs), RUNS), max(last) * n,
        )  # fmt: skip


def her_errors(runs: Runs, r: int, true: NoisyModel, hears: Hearing) -> Flags:
    """Where her estimates differ from the controller's, up to one relabelling for the run."""
    assert runs.x is not None
    assert runs.candidates is not None
    x, draw = runs.x[:, :, r], np.random.default_rng([SEED, r])
    guessed = hears(true, x[:-1], runs.candidates[..., r], x[1:], draw)
    out: Flags = guessed != runs.symbol[:, r]
    return out if out.mean() <= 0.5 else ~out


@table("stochastic", "findings", "stochastic")
def shown(rows: Sequence[Row]) -> Lines:
    """A line an Eve; what the ends do stands in its scheme's first."""
    head = (
        "scheme", "estimates wrong: expected, counted", "words wrong after", "in clear, key bits",
        "Eve", "bits unlike the controller's", "words that Eve has",
        "bits left of a word, at most", "lacks none after step",
    )  # fmt: skip
    lines: list[tuple[str, ...]] = [head]
    for row in rows:
        before, after, corrected, kept = (
            interval_of(row, what) for what in ("before", "after", "corrected", "left")
        )
        ends = ("", "", "", "")
        if row["eve"] == next(iter(EVES)):
            counted = before.scaled(100).text(".3g")
            ends = (
                f"`{row['scheme']}`",
                f"{100 * float(row['expected']):.3g} %, {counted} %",
                f"{after.scaled(100).text('.2g')} %",
                f"{row['syndrome']} + {int(row['clear']) - int(row['syndrome'])}, {row['key']}",
            )
        last = int(row["last_wrong"])
        lines.append(
            (
                *ends,
                row["eve"],
                f"{100 * float(row['her_errors']):.2g} %",
                f"{corrected.scaled(100).text('.3g')} %",
                kept.text(".2g") if kept.high else "0",
                "-" if last >= int(row["steps"]) - 62 else str(last),
            )
        )
    return lines
