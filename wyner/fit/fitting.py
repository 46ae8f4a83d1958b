"""The order of a fit: excite, identify, pilot, calibrate, freeze, certify.

D_c changes the law, and the law changes what D_c must hold. So D_c is scaled under its own law
until it stands still, frozen, and only then are fresh sessions counted.

Where sensors are noisy the residuals show W = D_c + N - A N alone. W is what is scaled, frozen and
certified, and D_c is what N leaves of it: larger than the disturbance where N is taken too small,
and too small where N is taken too large.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller_service.sets.design import SynthesisError
from protocol.arrays import Array
from protocol.scenario import ConvexSet, NoiseSet, Scenario, ScenarioError, parse_scenario
from protocol.scenario.noise import widened
from runtime.progress import duration
from wyner.fit.conformal import (
    CONFIDENCE,
    conformal_scale,
    session_score,
    template,
    violation_bound,
)
from wyner.fit.identification import (
    ROUNDED,
    FitError,
    FittedModel,
    identify,
    inputs_without_effect,
)
from wyner.fit.sessions import OpenPlant, Transitions, excite, residuals_under
from wyner.simulate.engine import Law

Tables = dict[str, Any]
MakeLaw = Callable[[Scenario], Law]
Tell = Callable[[str], None]

ROUNDS: Final = 8
"""Times that D_c is scaled under its own law before the fit gives up."""

TIGHT: Final = 0.9
"""D_c stands still when its scale came out between this and 1."""

SPARE: Final = 1.02
"""What a new D_c is larger by than its scale says."""

LEAVES: Final = {"may_leave_defender_set": True}

LEAST_SHARE: Final = 0.02
"""Of W, that D_c is at least: noise alone is no disturbance, and she must be left some room."""

SMALLEST: Final = 1e-9
"""Share of the largest half-width that every half-width has, for a plant without noise."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How many sessions a fit takes.

    Parameters
    ----------
    excite_sessions, excite_steps : int
    amplitude : float
        Of the excitation, as a share of U.
    pilot : int
        Sessions that give the box its shape.
    calibration : int
        Sessions that scale it.
    violation : float
        The share of sessions that may leave it, for the calibration.
    fresh : int
        Sessions that certify it.
    steps : int
        Of a session under the law.
    seed : int
    """

    excite_sessions: int = 20
    excite_steps: int = 100
    amplitude: float = 0.3
    pilot: int = 20
    calibration: int = 100
    violation: float = 0.05
    fresh: int = 100
    steps: int = 200
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit came to.

    Parameters
    ----------
    tables : dict
        The scenario with its model, its D_c and its certificate, as TOML has it.
    scenario : Scenario
    model : Model or None
        None where the file states A and B.
    rounds : int
        Times that D_c was scaled.
    exceeded : int
        Fresh sessions that left it.
    """

    tables: Tables
    scenario: Scenario
    model: FittedModel | None
    rounds: int
    exceeded: int


def fit(
    tables: Mapping[str, Any],
    source: str,
    open_plant: OpenPlant,
    make_law: MakeLaw,
    plan: Plan,
    tell: Tell = lambda _: None,
    folder: Path = Path(),
) -> Fit:
    """Fit a scenario to its plant.

    Parameters
    ----------
    tables : mapping
        As TOML has them; ``defender.A``, ``defender.B`` and ``defender.disturbance`` may be
        missing. A and B that are there are kept.
    source : str
        Stands first in each line of an error.
    open_plant, make_law : callable
        Of a scenario: the plant, and the law on its design.
    plan : Plan
    tell : callable
        Takes a line on each stage.
    folder : Path
        Where the files that the scenario names are looked for.

    Raises
    ------
    ScenarioError
        With one line for each wrong field.
    FitError
        When the plant was not excited, or D_c does not come to rest.
    SynthesisError
        When there are no sets for what was found.
    """
    blank = _blank(tables, source)
    found = None
    defender = dict(tables.get("defender", {}))
    defender.pop("calibration", None)
    N = blank.defender.noise
    began = time.monotonic()
    seen = excite(
        blank,
        open_plant,
        sessions=plan.excite_sessions,
        steps=plan.excite_steps,
        amplitude=plan.amplitude,
        seed=plan.seed,
    )
    pace = (time.monotonic() - began) / (plan.excite_sessions * plan.excite_steps)
    follow = plan.pilot + plan.calibration + plan.fresh
    tell(
        f"{follow} sessions or more of {plan.steps} steps follow, about "
        f"{duration(follow * plan.steps * pace)}"
    )
    if "A" in defender and "B" in defender:
        errors = seen.x_next - seen.x @ np.array(blank.A).T - seen.u @ np.array(blank.B).T
    else:
        found = _identified(seen, noisy=N is not None)
        for j in inputs_without_effect(found, seen.x, seen.u):
            raise FitError(
                f"input u_{j + 1} has no effect: B's column is within its error (the largest entry "
                f"is {float(np.abs(found.B[:, j]).max()):.2g}); connect it, leave it out of "
                "control.inputs, or excite the plant with a larger --amplitude"
            )
        errors = seen.x_next - seen.x @ found.A.T - seen.u @ found.B.T
        defender |= {"A": found.A.tolist(), "B": found.B.tolist()}
        tell(f"identified A and B from {len(seen.x)} steps, condition {found.condition:.3g}")
    if (template(errors) <= ROUNDED * np.sqrt((seen.x_next**2).mean(axis=0))).all():
        raise FitError(
            "the plant shows no disturbance: the model leaves nothing but rounding (residuals up "
            f"to {float(template(errors).max()):.1g}), and a D_c of that size is none; state "
            "plant.disturbance, or state defender.disturbance without a fit"
        )
    A = np.array(defender.get("A") or blank.A)
    widths = _box(template(errors) * 1.1)
    rounds = 0
    first, sessions = 0, range(plan.pilot)
    while True:
        widths = _resting_on(N, A, widths)
        defender["disturbance"] = {"half_widths": _without(N, A, widths).tolist()}
        s = parse_scenario(_with(tables, defender), source)
        try:
            law = make_law(s)
        except SynthesisError as error:
            raise SynthesisError(
                f"{error} (D_c has half-widths {[float(f'{w:.4g}') for w in widths]}: a smaller "
                "--amplitude shows less of what the model leaves out)"
            ) from None
        residuals = residuals_under(
            s, law, open_plant, runs=sessions, steps=plan.steps, seed=plan.seed, folder=folder
        )
        first = sessions.stop
        sessions = range(first, first + plan.calibration)
        if rounds == 0:
            widths = _box(template(residuals.reshape(-1, s.n)) * SPARE)
            rounds = 1
            continue
        scores = [session_score(r, widths) for r in residuals]
        scale = conformal_scale(scores, plan.violation)
        tell(f"round {rounds}: scale {scale:.4f} of half-widths {widths.round(6).tolist()}")
        resting = bool((_resting_on(N, A, widths * scale) > widths * scale).all())
        if TIGHT <= scale <= 1 or (scale <= 1 and resting):
            break
        if rounds == ROUNDS:
            raise FitError(
                f"D_c does not come to rest in {ROUNDS} rounds (last scale {scale:.3g}): the law "
                "drives the plant to where the model is worse; fit a smaller range or more weight "
                "on the inputs"
            )
        widths = widths * scale * SPARE
        rounds += 1
    tell("frozen; fresh sessions under this law")
    fresh = range(sessions.start, sessions.start + plan.fresh)
    residuals = residuals_under(
        s, law, open_plant, runs=fresh, steps=plan.steps, seed=plan.seed, folder=folder
    )
    exceeded = sum(session_score(r, widths) > 1 + 1e-9 for r in residuals)
    defender["calibration"] = {
        "sessions": plan.fresh,
        "steps": plan.steps,
        "exceeded": exceeded,
        "violation": violation_bound(plan.fresh, exceeded, CONFIDENCE),
        "confidence": CONFIDENCE,
        "law_fingerprint": s.law_fingerprint(),
    }
    out = _with(tables, defender)
    return Fit(out, parse_scenario(out, source), found, rounds, exceeded)


def _with(tables: Mapping[str, Any], defender: Mapping[str, Any]) -> Tables:
    """The tables with this model; what disturbs a simulated state may leave a D_c of samples."""
    plant = dict(tables["plant"])
    noise = dict(plant.get("disturbance", {}))
    if noise.get("enters", "state") == "state":
        plant["disturbance"] = {**noise, **LEAVES}
    return {**tables, "plant": plant, "defender": dict(defender)}


def _identified(seen: Transitions, *, noisy: bool) -> FittedModel:
    """A and B; where readings are noisy by the readings before, of all steps that have one."""
    if not noisy or seen.steps < 2:
        return identify(seen.x, seen.u, seen.x_next)
    later = np.arange(len(seen.x)) % seen.steps != 0
    before = np.roll(seen.x, 1, axis=0)[later]
    return identify(seen.x[later], seen.u[later], seen.x_next[later], before)


def _of_noise(N: NoiseSet | None, A: Array) -> Array:
    """What N and A N add to the half-widths of D_c, shape (n,)."""
    nothing = np.full(len(A), 1.0)
    if N is None:
        return np.zeros(len(A))
    D_c = ConvexSet(half_widths=tuple(nothing.tolist()))
    wide = widened(D_c, N, tuple(map(tuple, A.tolist())))
    added: Array = np.array(wide.half_widths) - nothing
    return added


def _resting_on(N: NoiseSet | None, A: Array, widths: Array) -> Array:
    """W, no smaller than the noise alone makes it."""
    least = _of_noise(N, A)
    return np.maximum(widths, least + LEAST_SHARE * widths)


def _without(N: NoiseSet | None, A: Array, widths: Array) -> Array:
    """D_c of W."""
    return widths - _of_noise(N, A)


def _box(widths: Array) -> Array:
    """Half-widths, none of them zero."""
    largest = float(widths.max())
    return np.maximum(widths, SMALLEST * (largest or 1.0))


def _blank(tables: Mapping[str, Any], source: str) -> Scenario:
    """The scenario with a model and a D_c that are there to be replaced.

    Raises
    ------
    ScenarioError
        With one line for each wrong field, also when the number of states stands nowhere.
    """
    plant = tables.get("plant", {})
    point = plant.get("operating_point", {})
    known = (plant.get("initial_state"), plant.get("outputs"), point.get("state"), plant.get("A"))
    n = next((len(v) for v in known if isinstance(v, list) and v), None)
    control = dict(tables.get("control", {}))
    inputs = control.get("inputs", {})
    m = len(inputs.get("half_widths") or (inputs.get("H") or [[]])[0]) or None
    if n is None or m is None:
        raise ScenarioError(
            [
                f"{source}: plant.operating_point.state and control.inputs: expected both, to know "
                "how many states and inputs there are"
            ]
        )
    control.pop("disturbance", None)
    defender = dict(tables.get("defender", {}))
    defender.pop("calibration", None)
    if plant.get("kind", "linear") != "linear":
        defender.setdefault("A", np.eye(n).tolist())
        defender.setdefault("B", np.zeros((n, m)).tolist())
    defender["disturbance"] = {"half_widths": [1e9] * n}
    return parse_scenario({**tables, "control": control, "defender": defender}, source)
