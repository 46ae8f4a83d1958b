"""The order of a fit: excite, identify, pilot, calibrate, freeze, certify.

D_c changes the law, and the law changes what D_c must hold. So D_c is scaled under its own law
until it stands still, frozen, and only then are fresh sessions counted.

Where sensors are noisy the residuals show W = D_c + N - A N alone. W is what is scaled, frozen and
certified, and D_c is what N leaves of it: larger than the disturbance where N is taken too small,
and too small where N is taken too large.
"""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from protocol.arrays import Array
from protocol.scenario import ConvexSet, NoiseSet, Scenario, ScenarioError, parse_scenario
from protocol.scenario.noise import widened
from runtime.progress import duration
from wyner.fit.conformal import CONFIDENCE, conformal_scale, template, violation_bound
from wyner.fit.identification import ROUNDED, FitError, identify
from wyner.fit.plan import Plan
from wyner.fit.sessions import Own, excite, residuals, residuals_under

Tables = dict[str, Any]

ROUNDS: Final = 8
"""Times that D_c is scaled under its own law before the fit gives up."""

TIGHT: Final = 0.9
"""D_c stands still when its scale came out between this and 1."""

SPARE: Final = 1.02
"""What a new D_c is larger by than its scale says."""

LEAVES: Final = {"may_leave_defender_set": True}

LEAST_SHARE: Final = 0.02
"""Of W, that D_c is at least: noise alone is no disturbance."""

SMALLEST: Final = 1e-9
"""Share of the largest half-width that every half-width has, for a plant without noise."""


def fit(
    tables: Mapping[str, Any], path: Path, plan: Plan, violation: float, own: Own | None = None
) -> tuple[Tables, Scenario]:
    """Fit a scenario to its plant; standard error has a line on each stage.

    Parameters
    ----------
    tables : mapping
        As TOML has them; ``defender.A``, ``defender.B`` and ``defender.disturbance`` may be
        missing. A and B that are there are kept.
    path : Path
        Their file: it stands first in each line of an error, and the files that the scenario names
        are looked for in its folder.
    plan : Plan
    violation : float
        The share of sessions that may leave D_c, for its scale.
    own : Stepped or PlantAdapter, optional
        A plant in place of the one that the tables name.

    Returns
    -------
    dict, Scenario
        The tables with model, D_c and certificate, and what they state.

    Raises
    ------
    ScenarioError
        With one line for each wrong field.
    FitError
        When the plant was not excited, or D_c does not come to rest.
    SynthesisError
        When there are no sets for what was found.
    """
    folder = path.parent
    blank = _blank(tables, str(path))
    x, u = _excited(blank, folder, plan, own)
    defender = {**tables.get("defender", {})}
    defender.pop("calibration", None)
    if not {"A", "B"} <= defender.keys():
        defender |= _identified(x, u, noisy=blank.defender.noise is not None)
    A, B = np.array(defender["A"]), np.array(defender["B"])
    noise = _of_noise(blank.defender.noise, A)

    def stated(widths: Array) -> Scenario:
        """The scenario whose D_c is what the noise leaves of these half-widths."""
        defender["disturbance"] = {"half_widths": (widths - noise).tolist()}
        return parse_scenario(_with(tables, defender), str(path))

    errors = residuals(x, u, A, B)
    _check_disturbed(template(errors), x)
    pilot = stated(_box(template(errors) * 1.1, noise))
    shape = template(residuals_under(pilot, folder, plan, range(plan.few), own))
    widths = _box(shape * SPARE, noise)
    sessions = range(plan.few)
    for number in range(1, ROUNDS + 1):
        scenario = stated(widths)
        sessions = _next(sessions, plan)
        scores = _scores(residuals_under(scenario, folder, plan, sessions, own), widths)
        scale = conformal_scale(scores.tolist(), violation)
        _tell(f"round {number}: scale {scale:.4f} of half-widths {widths.round(6).tolist()}")
        as_small_as_may_be = (_box(widths * scale, noise) > widths * scale).all()
        if scale <= 1 and (scale >= TIGHT or as_small_as_may_be):
            break
        widths = _box(widths * scale * SPARE, noise)
    else:
        raise FitError(
            f"D_c does not come to rest in {ROUNDS} rounds (last scale {scale:.3g}): the law "
            "drives the plant to where the model is worse; fit a smaller range or more weight "
            "on the inputs"
        )
    _tell("frozen; fresh sessions under this law")
    fresh = residuals_under(scenario, folder, plan, _next(sessions, plan), own)
    exceeded = int((_scores(fresh, widths) > 1 + 1e-9).sum())
    defender["calibration"] = {
        "sessions": plan.sessions,
        "steps": plan.steps,
        "exceeded": exceeded,
        "violation": violation_bound(plan.sessions, exceeded),
        "confidence": CONFIDENCE,
        "law_fingerprint": scenario.law_fingerprint(),
    }
    return _with(tables, defender), stated(widths)


def _tell(line: str) -> None:
    print(f"wyner: {line}", file=sys.stderr)


def _excited(blank: Scenario, folder: Path, plan: Plan, own: Own | None) -> tuple[Array, Array]:
    """Readings and inputs of excited sessions; they tell how long the others will take."""
    began = time.monotonic()
    x, u = excite(blank, folder, plan, own)
    pace = (time.monotonic() - began) / (plan.few * plan.excite_steps)
    follow = plan.few + 2 * plan.sessions
    _tell(
        f"{follow} sessions or more of {plan.steps} steps follow, about "
        f"{duration(follow * plan.steps * pace)}"
    )
    return x, u


def _identified(x: Array, u: Array, *, noisy: bool) -> Tables:
    """A and B; where readings are noisy by the readings before, of all steps that have one."""
    if noisy and u.shape[1] > 1:
        found = identify(x[:, 1:-1], u[:, 1:], x[:, 2:], x[:, :-2])
    else:
        found = identify(x[:, :-1], u, x[:, 1:])
    if found.dead:
        j = found.dead[0]
        raise FitError(
            f"input u_{j + 1} has no effect: B's column is within its error (the largest entry "
            f"is {float(np.abs(found.B[:, j]).max()):.2g}); connect it, leave it out of "
            "control.inputs, or excite the plant with a larger --amplitude"
        )
    steps = u.shape[0] * u.shape[1]
    _tell(f"identified A and B from {steps} steps, condition {found.condition:.3g}")
    return {"A": found.A.tolist(), "B": found.B.tolist()}


def _check_disturbed(largest: Array, x: Array) -> None:
    """Refuse a plant whose model leaves nothing but rounding."""
    if (largest > ROUNDED * np.sqrt((x[:, 1:] ** 2).mean(axis=(0, 1)))).any():
        return
    raise FitError(
        "the plant shows no disturbance: the model leaves nothing but rounding (residuals up "
        f"to {float(largest.max()):.1g}), and a D_c of that size is none; state "
        "plant.disturbance, or state defender.disturbance without a fit"
    )


def _next(sessions: range, plan: Plan) -> range:
    """As many sessions as scale D_c, after those."""
    return range(sessions.stop, sessions.stop + plan.sessions)


def _scores(left: Array, widths: Array) -> Array:
    """The largest gauge of each session's residuals, in the box of these half-widths."""
    out: Array = np.abs(left / widths).max(axis=(1, 2))
    return out


def _with(tables: Mapping[str, Any], defender: Mapping[str, Any]) -> Tables:
    """The tables with this model; what disturbs a simulated state may leave a D_c of samples."""
    plant = dict(tables["plant"])
    noise = dict(plant.get("disturbance", {}))
    if noise.get("enters", "state") == "state":
        plant["disturbance"] = {**noise, **LEAVES}
    return {**tables, "plant": plant, "defender": dict(defender)}


def _of_noise(N: NoiseSet | None, A: Array) -> Array:
    """What N and A N add to the half-widths of D_c, shape (n,)."""
    if N is None:
        return np.zeros(len(A))
    unit = ConvexSet(half_widths=(1.0,) * len(A))
    wide = widened(unit, N, tuple(map(tuple, A.tolist())))
    return np.array(wide.half_widths) - 1.0


def _box(widths: Array, noise: Array) -> Array:
    """Half-widths of W: none is zero, nor as small as the noise alone makes it."""
    largest = float(widths.max())
    box = np.maximum(widths, SMALLEST * (largest or 1.0))
    return np.maximum(box, noise + LEAST_SHARE * box)


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
