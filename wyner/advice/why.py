"""Why a link has the rate it has: what became of the tested steps, and what would change it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import combinations
from typing import Any, Final

import numpy as np

from controller_service.laws.errors import ProgramError
from controller_service.laws.registry import make_law, synthesise
from controller_service.sets.terminal import SynthesisError
from protocol.agreement import INSIDE
from protocol.arrays import Array
from protocol.scenario import Scenario, ScenarioError, with_fields
from protocol.statistics import Interval, share_over_runs
from wyner.advice import rate
from wyner.simulate.engine import Runs, SimulationError

SOFTER: Final = (100.0, 1000.0)
"""Factors by which the inputs' weights are raised, for a softer regulator."""

HELPS: Final = 0.02
"""Share of the steps that a change of the law must add to be advised."""

EQUAL: Final = 1e-3
"""Candidates whose predictions are no further apart than this, in D_c's gauge, are one."""

APART: Final = 2.0
"""Distance of two predictions, in D_c's gauge, from which no state lies in D_c around both."""

OFTEN: Final = 0.5
"""Share of the steps from which a reason is worth a remedy."""

FULL: Final = 0.9
"""Agreement above which nothing is to be explained."""


@dataclass(frozen=True, slots=True)
class Why:
    """What became of the steps of the loop once it has settled, as shares of all.

    Their intervals are over runs.

    Parameters
    ----------
    agreed, several, none, beyond : Interval
        One candidate explains the state; several do; none does; one does, but a D_e does not hold
        the state. They add up to 1.
    equal : Interval
        Share of the steps in which the closest two predictions are one.
    distance : float
        Median distance of the closest two predictions, in D_c's gauge; from 2 on a key is certain.
    saturated : Interval
        Share of the steps in which an input of a candidate is at a bound of U.
    left : Interval
        Share of the steps whose disturbance was outside D_c.
    remedies : tuple of str
        What to change, the most promising first.
    runs : int
    """

    agreed: Interval
    several: Interval
    none: Interval
    beyond: Interval
    equal: Interval
    distance: float
    saturated: Interval
    left: Interval
    remedies: tuple[str, ...]
    runs: int

    def as_json(self) -> dict[str, Any]:
        """One object for machines."""
        its = {field.name: getattr(self, field.name) for field in fields(self)}
        return {n: v.as_json() if isinstance(v, Interval) else v for n, v in its.items()}

    def lines(self) -> list[str]:
        """For people."""
        told = [
            f"of 100 settled steps ({self.runs} runs):",
            f"  a key can be made in {_hundred(self.agreed)}",
            f"  the inputs cannot be told apart in {_hundred(self.several)}",
            f"  no input explains the state in {_hundred(self.none)}",
            f"  the state is outside D_e of an input in {_hundred(self.beyond)}",
            f"the two closest predictions are {self.distance:.2g} half-widths of D_c apart "
            f"(median; from {APART:g} on each step agrees), and one and the same in "
            f"{_hundred(self.equal)} of 100 steps",
        ]
        if self.left.value:
            told.append(
                f"{self.left.scaled(100.0).text('.2g')} of 100 steps leave D_c: a key that is made "
                "there may be wrong"
            )
        aim = "to raise the rate" if self.agreed.value else "to keep it talking"
        return told + [f"{aim}: {remedy}" for remedy in self.remedies]


def _hundred(share: Interval) -> str:
    return share.scaled(100.0).text(".0f")


def why(scenario: Scenario, parts: Sequence[Runs]) -> Why:
    """Count what became of the settled steps.

    Parameters
    ----------
    scenario : Scenario
    parts : sequence of Runs
        Those of :func:`wyner.advice.rate.long_runs`, recorded, and without missed steps.
    """

    def settled(name: str) -> Array:
        """What the steps after the burn-in were recorded with, of all runs."""
        recorded = [getattr(runs, name)[rate.BURN_IN :] for runs in parts]
        return np.concatenate(recorded, axis=-1)

    gauges, candidates, largest = map(settled, ("gauges", "candidates", "largest"))
    coin = settled("coin").astype(np.intp)
    applied = np.take_along_axis(gauges, coin[:, None], axis=1)[:, 0]
    steps = len(largest)
    inside = (gauges <= INSIDE).sum(axis=1)
    held = largest <= scenario.secrecy.alpha
    one = inside == 1
    U, bound = (np.array(v) for v in scenario.control.inputs.rows())
    reach = np.einsum("rm,kjmn->kjrn", U, candidates)
    at_bound = (reach >= bound[None, None, :, None] * (1 - 1e-6)).any(axis=(1, 2))
    apart = closest_predictions(scenario, candidates)
    found = {
        "agreed": one & held,
        "several": inside > 1,
        "none": inside == 0,
        "beyond": one & ~held,
        "equal": apart <= EQUAL,
        "saturated": at_bound,
        "left": applied > INSIDE,
    }
    shares = {
        name: share_over_runs((int(n), steps) for n in flags.sum(axis=0))
        for name, flags in found.items()
    }
    remedies = remedies_for(scenario, {name: share.value for name, share in shares.items()})
    return Why(
        **shares,
        distance=float(np.median(apart)),
        remedies=tuple(remedies),
        runs=largest.shape[-1],
    )


def closest_predictions(scenario: Scenario, candidates: Array) -> Array:
    """Distance of the two closest predictions in D_c's gauge, shape (steps, R).

    Parameters
    ----------
    scenario : Scenario
    candidates : array, shape (steps, M, m, R)
    """
    B = np.array(scenario.B)
    H, h = (np.array(v) for v in scenario.defender.disturbance.rows())
    rows = H / h[:, None]
    at = np.einsum("nm,kjmr->kjnr", B, candidates)
    best = np.full((len(candidates), candidates.shape[-1]), np.inf)
    for i, j in combinations(range(candidates.shape[1]), 2):
        along = np.einsum("hn,knr->khr", rows, at[:, i] - at[:, j])
        best = np.minimum(best, np.abs(along).max(axis=1))  # there and back
    return best


def remedies_for(scenario: Scenario, found: dict[str, float]) -> list[str]:
    """What to change, the most promising first; ``found`` are the shares of :class:`Why`.

    Each change of the law has been simulated, and is there because it helped.
    """
    if found["agreed"] >= FULL:
        return []
    remedies = []
    for text, changes in _laws(scenario):
        share = settled_share(scenario, changes)
        if share > found["agreed"] + HELPS:
            remedies.append(f"{text} ({100 * share:.3g} of 100 steps make a key there, simulated)")
    if found["equal"] >= OFTEN and scenario.control.regulator is None:
        remedies.append(
            "a larger target set: a smaller control.gain, or control.regulator in its place, makes "
            "a softer K and a wider T_0, in which the candidates can lie apart"
        )
    if min(found["several"], found["saturated"]) >= OFTEN:
        remedies.append(
            "wider control.inputs: the candidates are at their bounds in "
            f"{100 * found['saturated']:.0f} of 100 steps"
        )
    if found["beyond"] > min(1 - OFTEN, found["agreed"]):
        remedies.append("a larger secrecy.alpha, if Eve really knows so little")
    if found["none"] > 1 - FULL:
        remedies.append("a larger defender.disturbance: the state leaves every D_c")
    return remedies


def _laws(scenario: Scenario) -> Iterator[tuple[str, dict[str, Any]]]:
    """Changes of the law that may raise the rate: a line, and the fields of ``[control]``."""
    control = scenario.control
    if control.law == "paper":
        yield (
            'control.law = "sustained": inside T_0 the law paper applies u = K x in both programs, '
            "so that the candidates are one",
            {"law": "sustained"},
        )
    if (regulator := control.regulator) is not None:
        for factor in SOFTER:
            weights = [float(f"{factor * weight:.3g}") for weight in regulator.input]
            yield (
                f"control.regulator.input = {weights}: a softer K and a wider T_0, in which the "
                "candidates can lie apart",
                {"regulator": {"next_state": regulator.next_state, "input": weights}},
            )
    if control.law != "packed":
        yield (
            'control.law = "packed", with one table [[control.costs]]: it keeps the predictions '
            "apart by as much as you say",
            {"law": "packed", "costs": [control.costs[0].model_dump(exclude_none=True)]},
        )


def settled_share(scenario: Scenario, fields: dict[str, Any]) -> float:
    """The share of steps that could agree a key once the loop from the origin has settled.

    0 where these fields of ``[control]`` make no scenario, or it has no design or cannot run.
    """
    changes = {f"control.{name}": value for name, value in fields.items()}
    # Near the origin the smallest sets are enough.
    changes |= {"control.horizon": 1, "plant.initial_state": [0.0] * scenario.n}
    try:
        quiet = with_fields(scenario, changes, scenario.name).model_copy(update={"network": None})
        (runs,) = rate.long_runs(quiet, make_law(quiet, synthesise(quiet)))
    except (ScenarioError, SynthesisError, ProgramError, SimulationError):
        return 0.0
    could = (runs.symbol >= 0) & (runs.largest <= scenario.secrecy.alpha)
    return float(could[rate.BURN_IN :].mean())
