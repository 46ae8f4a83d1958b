"""The double integrator x+ = A x + B u with a period of 1 s, as a pythonfmu3 model (FMI 3.0)."""

from typing import Any

from pythonfmu3 import (
    Float64,
    Fmi3Causality,
    Fmi3Slave,
    Fmi3Status,
    Fmi3StepResult,
    Fmi3Variability,
)


class LineFmi3(Fmi3Slave):  # type: ignore[misc]
    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.time, self.u, self.place, self.speed = 0.0, 0.0, -5.0, -2.0
        self.register_variable(
            Float64(
                "time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous
            )
        )
        self.register_variable(Float64("u", causality=Fmi3Causality.input))
        for name in ("place", "speed"):
            self.register_variable(
                Float64(
                    name, causality=Fmi3Causality.output, variability=Fmi3Variability.continuous
                )
            )

    def do_step(self, current_time: float, step_size: float) -> Any:
        place, speed, u = self.place, self.speed, self.u
        self.place = 1.0 * place + 1.0 * speed + 0.5 * u
        self.speed = 0.0 * place + 1.0 * speed + 1.0 * u
        return Fmi3StepResult(status=Fmi3Status.ok)
