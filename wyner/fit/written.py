"""What `wyner fit` writes and prints: a scenario from a recording, or from a plant that it ran."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from protocol.scenario.defender import Calibration
from protocol.statistics import STATED
from wyner.fit.first_scenario import WIDER, FirstScenario
from wyner.fit.fitting import Fit, Plan
from wyner.fit.recording import RecordedFit, Recording
from wyner.fit.toml import as_toml

NO_INTERVAL = {"violation": STATED, "confidence": STATED}


@dataclass(frozen=True, eq=False)
class FromRecording:
    """A scenario whose A, B and D_c come from a recording.

    Parameters
    ----------
    source, output : Path
        The recording, and the scenario's file.
    period_s : float
        Seconds from row to row.
    recording : Recording
    fit : RecordedFit
    """

    source: Path
    output: Path
    period_s: float
    recording: Recording
    fit: RecordedFit

    @property
    def promise(self) -> str:
        """How often a step leaves D_c."""
        f = self.fit
        return (
            f"a step leaves D_c with probability at most {f.violation:.3g}, confidence "
            f"{f.confidence:g}: {f.exceeded} of {f.steps[2]} steps held out did"
        )

    @cached_property
    def _written(self) -> tuple[str, bool]:
        r, f = self.recording, self.fit
        origin = (
            f"A, B and D_c by `wyner fit` from {self.source.name}: states {', '.join(r.states)}; "
            f"inputs {', '.join(r.inputs)}.\nUnder the recorded inputs {self.promise}."
        )
        A, B = f.model.A.tolist(), f.model.B.tolist()
        widths = (f.half_widths / WIDER).tolist()
        bounds = f.bounds.tolist()
        first = FirstScenario(self.output.stem, A, B, self.period_s, bounds, widths, origin)
        return first.text()

    @property
    def text(self) -> str:
        """The file's text."""
        return self._written[0]

    @property
    def warnings(self) -> list[str]:
        """What weakens the promise, or keeps the scenario from having a design."""
        found = self.fit.warnings()
        if not self._written[1]:
            found.append(f"there is no terminal set yet: `wyner design {self.output}` says why")
        return found

    def to_json(self) -> dict[str, Any]:
        """The model, D_c and how well they hold."""
        f = self.fit
        identified, scaled, held_out = f.steps
        return {
            "output": str(self.output),
            "A": f.model.A.tolist(),
            "B": f.model.B.tolist(),
            "standard_errors": f.model.errors.tolist(),
            "half_widths": f.half_widths.tolist(),
            "steps": {"identified": identified, "scaled": scaled, "held_out": held_out},
            "exceeded": f.exceeded,
            "violation": f.violation,
            "confidence": f.confidence,
            "warnings": self.warnings,
            "no_interval": NO_INTERVAL,
        }

    def __str__(self) -> str:
        """The model as an equation for each state, D_c, the promise and warnings."""
        model, names = self.fit.model, (*self.recording.states, *self.recording.inputs)
        lines = [f"A and B from {self.fit.steps[0]} steps, condition {model.condition:.3g}"]
        for i, name in enumerate(self.recording.states):
            row = [*model.A[i].tolist(), *model.B[i].tolist()]
            terms = " ".join(f"{v:+.5g} {of}" for v, of in zip(row, names, strict=True))
            errors = ", ".join(f"{e:.1g}" for e in model.errors[i])
            lines.append(f"  next {name} = {terms}   (standard errors {errors})")
        lines.append("D_c half-widths " + "  ".join(f"{w:.4g}" for w in self.fit.half_widths))
        lines += [self.promise, *(f"warning: {line}" for line in self.warnings)]
        end = f"wrote {self.output}; `wyner design {self.output}` says what the loop carries"
        return "\n".join([*lines, end])


@dataclass(frozen=True, eq=False)
class FromPlant:
    """A scenario whose D_c, and A and B where it had none, come from runs of its plant.

    Parameters
    ----------
    output : Path
        The scenario's file.
    fit : Fit
    plan : Plan
    """

    output: Path
    fit: Fit
    plan: Plan

    @property
    def _calibration(self) -> Calibration:
        found = self.fit.scenario.defender.calibration
        assert found is not None, "a fit ends with its certificate"
        return found

    @property
    def _widths(self) -> tuple[float, ...]:
        found = self.fit.scenario.defender.disturbance.half_widths
        assert found is not None, "a fitted D_c is a box"
        return found

    @property
    def promise(self) -> str:
        """How often a session leaves D_c."""
        c, N = self._calibration, self.fit.scenario.defender.noise
        what = "D_c" if N is None else "W = D_c + N - A N"
        text = (
            f"a session of {c.steps} steps leaves {what} with probability at most "
            f"{c.violation:.3g}, confidence {c.confidence:g}: {c.exceeded} of {c.sessions} fresh "
            "sessions did"
        )
        if N is None:
            return text
        return f"{text}; D_c itself rests on N, which is stated"

    @property
    def text(self) -> str:
        """The file's text."""
        promise = f"{self.promise[0].upper()}{self.promise[1:]}."
        head = f"Written by wyner fit, seed {self.plan.seed}.\n{promise}"
        return as_toml(self.fit.tables, head)

    def to_json(self) -> dict[str, Any]:
        """D_c, N where sensors are noisy, and the certificate."""
        N = self.fit.scenario.defender.noise
        noise = {} if N is None else {"noise": N.model_dump(exclude_none=True)}
        return {
            "output": str(self.output),
            "seed": self.plan.seed,
            "half_widths": list(self._widths),
            **noise,
            "calibration": self._calibration.model_dump(),
            "no_interval": NO_INTERVAL,
        }

    def __str__(self) -> str:
        """D_c, N and the promise."""
        N = self.fit.scenario.defender.noise
        lines = ["D_c half-widths " + " ".join(f"{w:.4g}" for w in self._widths)]
        if N is not None and N.half_widths is not None:
            lines.append("N half-widths " + " ".join(f"{w:.4g}" for w in N.half_widths))
        return "\n".join([*lines, self.promise, f"wrote {self.output}"])
