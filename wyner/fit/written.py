"""What `wyner fit` writes and prints: a scenario from a recording, or from a plant that it ran."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from protocol.scenario import Scenario
from protocol.statistics import STATED
from wyner.fit.conformal import CONFIDENCE
from wyner.fit.first_scenario import WIDER, first_scenario
from wyner.fit.recording import PlantRecording, RecordedFit
from wyner.fit.toml import as_toml
from wyner.printout import Printout

NO_INTERVAL: Final = {"violation": STATED, "confidence": STATED}


@dataclass(frozen=True, eq=False)
class Written(Printout):
    """What is said of a scenario's file.

    Parameters
    ----------
    text : str
        What the file holds.
    """

    text: str


def from_recording(
    recording: PlantRecording, fit: RecordedFit, source: Path, output: Path, period_s: float
) -> Written:
    """A scenario whose A, B and D_c come from a recording.

    Parameters
    ----------
    recording : PlantRecording
    fit : RecordedFit
    source, output : Path
        The recording's file, and the scenario's.
    period_s : float
        Seconds from row to row.
    """
    model, steps = fit.model, fit.steps
    promise = (
        f"a step leaves D_c with probability at most {fit.violation:.3g}, confidence "
        f"{CONFIDENCE:g}: {fit.exceeded} of {steps['held_out']} steps held out did"
    )
    text, starts = first_scenario(
        output.stem,
        model.A.tolist(),
        model.B.tolist(),
        period_s,
        np.abs(recording.u).max(axis=0).tolist(),
        (fit.half_widths / WIDER).tolist(),
        f"A, B and D_c by `wyner fit` from {source.name}: states {', '.join(recording.states)}; "
        f"inputs {', '.join(recording.inputs)}.\nUnder the recorded inputs {promise}.",
    )
    warnings = [*fit.warnings]
    if not starts:
        warnings.append(f"there is no terminal set yet: `wyner design {output}` says why")
    figures = {
        "output": str(output),
        "A": model.A.tolist(),
        "B": model.B.tolist(),
        "standard_errors": model.errors.tolist(),
        "half_widths": fit.half_widths.tolist(),
        "steps": steps,
        "exceeded": fit.exceeded,
        "violation": fit.violation,
        "confidence": CONFIDENCE,
        "warnings": warnings,
        "no_interval": NO_INTERVAL,
    }
    lines = [f"A and B from {steps['identified']} steps, condition {model.condition:.3g}"]
    for i, name in enumerate(recording.states):
        row, names = [*model.A[i], *model.B[i]], [*recording.states, *recording.inputs]
        terms = " ".join(f"{v:+.5g} {of}" for v, of in zip(row, names, strict=True))
        errors = ", ".join(f"{e:.1g}" for e in model.errors[i])
        lines.append(f"  next {name} = {terms}   (standard errors {errors})")
    lines.append("D_c half-widths " + "  ".join(f"{w:.4g}" for w in fit.half_widths))
    lines += [promise, *(f"warning: {line}" for line in warnings)]
    lines.append(f"wrote {output}; `wyner design {output}` says what the loop carries")
    return Written(figures, lines, text)


def from_plant(tables: dict[str, Any], scenario: Scenario, output: Path, seed: int) -> Written:
    """A scenario whose D_c, and A and B where it had none, come from runs of its plant.

    Parameters
    ----------
    tables : dict
    scenario : Scenario
        What they state.
    output : Path
        The scenario's file.
    seed : int
        Of these runs.
    """
    certificate, N = scenario.defender.calibration, scenario.defender.noise
    widths = scenario.defender.disturbance.half_widths
    assert certificate is not None, "a fit ends with its certificate"
    assert widths is not None, "a fitted D_c is a box"
    what = "D_c" if N is None else "W = D_c + N - A N"
    promise = (
        f"a session of {certificate.steps} steps leaves {what} with probability at most "
        f"{certificate.violation:.3g}, confidence {CONFIDENCE:g}: {certificate.exceeded} of "
        f"{certificate.sessions} fresh sessions did"
    )
    if N is not None:
        promise += "; D_c itself rests on N, which is stated"
    head = f"Written by wyner fit, seed {seed}.\n{promise[0].upper()}{promise[1:]}."
    figures = {
        "output": str(output),
        "seed": seed,
        "half_widths": list(widths),
        **({} if N is None else {"noise": N.model_dump(exclude_none=True)}),
        "calibration": certificate.model_dump(),
        "no_interval": NO_INTERVAL,
    }
    lines = ["D_c half-widths " + " ".join(f"{w:.4g}" for w in widths)]
    if N is not None and N.half_widths is not None:
        lines.append("N half-widths " + " ".join(f"{w:.4g}" for w in N.half_widths))
    lines += [promise, f"wrote {output}"]
    return Written(figures, lines, as_toml(tables, head))
