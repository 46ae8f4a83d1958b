"""Why a link has the rate it has: what became of the tested steps, and what would change it."""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from protocol.agreement import INSIDE
from protocol.statistics import Interval, share_over_runs

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from protocol.scenario import Scenario

RUNS: Final = 16
STEPS: Final = 250
SEED: Final = 1

SETTLED: Final = 50
"""Steps at the start of each run that are left out: the way to the target set is another loop."""

EQUAL: Final = 1e-3
"""Candidates whose predictions are no further apart than this, in D_c's gauge, are one."""

APART: Final = 2.0
"""Distance of two predictions, in D_c's gauge, from which no state lies in D_c around both."""

OFTEN: Final = 0.5
"""Share of the steps from which a reason is worth a remedy."""

WORTH: Final = 0.03
"""Share of the steps that a smaller D_c has to gain before it is advised."""

FULL: Final = 0.9
"""Agreement above which nothing is to be explained."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Why:
    """What became of the steps of a short simulation, as shares of all after the first `SETTLED`.

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
    remedies : tuple of str
        What to change, the most promising first.
    """

    agreed: Interval
    several: Interval
    none: Interval
    beyond: Interval
    equal: Interval
    distance: float
    saturated: Interval
    remedies: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """One object for machines."""
        its = {field.name: getattr(self, field.name) for field in fields(self)}
        return {n: v.as_json() if isinstance(v, Interval) else v for n, v in its.items()}

    def lines(self) -> list[str]:
        """For people."""
        told = [
            f"of 100 steps {_hundred(self.agreed)} could agree a key; in {_hundred(self.several)} "
            f"several inputs explain the state, in {_hundred(self.none)} none does, in "
            f"{_hundred(self.beyond)} it is outside a D_e ({RUNS} runs)",
            f"the two closest predictions are {self.distance:.2g} half-widths of D_c apart "
            f"(median; from {APART:g} on each step agrees), and one and the same in "
            f"{_hundred(self.equal)} of 100 steps",
        ]
        return told + [f"to raise the rate: {remedy}" for remedy in self.remedies]


def _hundred(share: Interval) -> str:
    return share.scaled(100.0).text(".0f")


def why(scenario: "Scenario", law: "CandidateLaw") -> Why:
    """Simulate `RUNS` runs and count.

    Raises
    ------
    wyner.simulate.engine.SimulationError
        When a run leaves the sets.
    """
    from wyner.simulate.engine import simulate_runs

    runs = simulate_runs(
        scenario, law, seed=SEED, runs=range(RUNS), steps=SETTLED + STEPS, record=True
    )
    assert runs.candidates is not None
    assert runs.gauges is not None
    gauges = runs.gauges[SETTLED:]
    inside = (gauges <= INSIDE).sum(axis=1)
    largest = runs.largest[SETTLED:]
    held = largest <= scenario.secrecy.alpha
    one = inside == 1
    U, bound = (np.array(v) for v in scenario.control.inputs.rows())
    candidates = runs.candidates[SETTLED:]
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
    }
    shares = {
        name: share_over_runs((int(n), STEPS) for n in steps.sum(axis=0))
        for name, steps in found.items()
    }
    # The same states judged by the smallest D_c that still holds D, and by its D_e; of a shape of
    # its own it stays.
    room = room_in(scenario)
    hers = 1.0 if scenario.secrecy.disturbance is not None else room
    one = (gauges <= room * INSIDE).sum(axis=1) == 1
    alone = one & (largest <= scenario.secrecy.alpha * hers)
    values = {name: share.value for name, share in shares.items()}
    remedies = _remedies(scenario, values, float(alone.mean()))
    return Why(**shares, distance=float(np.median(apart)), remedies=tuple(remedies))


def closest_predictions(scenario: "Scenario", candidates: Array) -> Array:
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
    M = candidates.shape[1]
    for i in range(M):
        for j in range(i):
            far = np.einsum("hn,knr->khr", rows, at[:, i] - at[:, j]).max(axis=1)
            back = np.einsum("hn,knr->khr", rows, at[:, j] - at[:, i]).max(axis=1)
            best = np.minimum(best, np.maximum(far, back))
    return best


def packed(scenario: "Scenario") -> "Scenario":
    """The same plant under the law ``packed``, with its first cost.

    Raises
    ------
    pydantic.ValidationError
        When that is no scenario.
    """
    data = scenario.model_dump(mode="json", exclude_none=True)
    control = {**data["control"], "law": "packed", "costs": data["control"]["costs"][:1]}
    return type(scenario).model_validate({**data, "control": control})


def packs(scenario: "Scenario") -> bool:
    """Whether the law ``packed`` has an alphabet and a terminal set here, by a regulator."""
    from pydantic import ValidationError

    from controller_service.laws.tables import PackedControl
    from controller_service.sets.design import SynthesisError, stated_start
    from controller_service.sets.packed_design import alphabet_of, nearest_regulator, reduced

    try:
        its = packed(scenario)
        assert isinstance(its.control, PackedControl)
        problem = reduced(its, alphabet_of(its, its.control.alphabet.spacing))
    except (ValidationError, SynthesisError):
        return False
    try:
        stated_start(problem)
    except SynthesisError:
        return nearest_regulator(problem) is not None
    return True


def room_in(scenario: "Scenario") -> float:
    """The share of D_c that D takes, in D_c's gauge; 1 where D is not known to stay inside."""
    d = scenario.plant.disturbance
    if d.kind == "gaussian" or d.may_leave_defender_set or d.enters not in (None, "state"):
        return 1.0
    H, h = (np.array(v) for v in scenario.defender.disturbance.rows())
    return float((np.abs(H) @ np.array(d.half_widths) / h).max())


def _remedies(scenario: "Scenario", found: dict[str, float], tight: float) -> list[str]:
    control, remedies = scenario.control, []
    if found["agreed"] >= FULL:
        return []
    if found["equal"] >= OFTEN and control.law == "paper":
        remedies.append(
            'control.law = "sustained": inside T_0 the law paper applies u = K x in both programs, '
            "so that the candidates are one"
        )
    elif found["equal"] >= OFTEN:
        remedies.append(
            "a larger target set: smaller control.regulator.next_state or larger "
            "control.regulator.input make a softer K and a wider T_0, in which the candidates can "
            "lie apart"
        )
    if found["several"] >= OFTEN:
        if control.law != "packed" and packs(scenario):
            remedies.append(
                'control.law = "packed", with one table [[control.costs]]: it keeps the '
                "predictions apart by as much as you say"
            )
        if found["saturated"] >= OFTEN:
            remedies.append(
                "wider control.inputs: the candidates are at their bounds in "
                f"{100 * found['saturated']:.0f} of 100 steps"
            )
    if found["several"] >= OFTEN and tight > found["agreed"] + WORTH:
        remedies.append(
            f"a smaller defender.disturbance: D takes {room_in(scenario):.2f} of it; so small, and "
            f"with today's kept as control.disturbance, {100 * tight:.0f} of 100 steps could agree"
        )
    if found["beyond"] > 1 - OFTEN or found["beyond"] > found["agreed"]:
        remedies.append("a larger secrecy.alpha, if she really knows so little")
    if found["none"] > 1 - FULL:
        remedies.append("a larger defender.disturbance: the state leaves every D_c")
    return remedies
