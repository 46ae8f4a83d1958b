"""The nonlinear quadruple tank as a pythonfmu model (FMI 2.0), with a disturbance of its own.

Written out by itself: an FMU carries its own file and nothing of the project. The pumps' voltages
are disturbed by a small generator that begins anew with every instance.
"""

from math import sqrt
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

AREAS = (28.0, 32.0, 28.0, 32.0)
OUTLETS = (0.071, 0.057, 0.071, 0.057)
SUBSTEPS = 10


class TankFmi2(Fmi2Slave):  # type: ignore[misc]
    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.v1, self.v2, self.seed = 3.0, 3.0, 1.0
        self.h1, self.h2, self.h3, self.h4 = 10.0, 10.0, 1.0, 1.0
        self.word = 0
        for name in ("v1", "v2"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        self.register_variable(
            Real("seed", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
        )
        for name in ("h1", "h2", "h3", "h4"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, variability=Fmi2Variability.continuous)
            )

    def noise(self) -> float:
        """Uniform in [-1, 1): a linear congruential generator."""
        self.word = (6364136223846793005 * self.word + int(self.seed) + 1442695040888963407) % 2**64
        return (self.word >> 11) / 2**52 - 1.0

    def do_step(self, current_time: float, step_size: float) -> bool:
        h = [self.h1, self.h2, self.h3, self.h4]
        q1 = 3.33 * (self.v1 + 0.01 * self.noise())
        q2 = 3.35 * (self.v2 + 0.01 * self.noise())
        dt = step_size / SUBSTEPS
        for _ in range(SUBSTEPS):
            out = [a * sqrt(1962.0 * max(x, 0.0)) for a, x in zip(OUTLETS, h, strict=True)]
            into = (out[2] + 0.7 * q1, out[3] + 0.6 * q2, 0.4 * q2, 0.3 * q1)
            h = [x + dt * (i - o) / area for x, i, o, area in zip(h, into, out, AREAS, strict=True)]
        self.h1, self.h2, self.h3, self.h4 = h
        return True
