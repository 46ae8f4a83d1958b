"""The double integrator x+ = A x + B u with a period of 1 s, as a pythonfmu model (FMI 2.0)."""

from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class LineFmi2(Fmi2Slave):  # type: ignore[misc]
    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.u, self.place, self.speed = 0.0, -5.0, -2.0
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        for name in ("place", "speed"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, variability=Fmi2Variability.continuous)
            )

    def do_step(self, current_time: float, step_size: float) -> Any:
        place, speed, u = self.place, self.speed, self.u
        self.place = 1.0 * place + 1.0 * speed + 0.5 * u
        self.speed = 0.0 * place + 1.0 * speed + 1.0 * u
        return True
