"""What the plant applies on a missed step (rule 4), by itself and to the last bit the same."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from protocol.agreement import Gauge
from protocol.scenario import Scenario
from protocol.vectors import Matrix, Vector


def clip(u: Sequence[float], inputs: Gauge) -> Vector:
    """The input nearest to ``u`` in a box U, by component; in another U, ``u`` made shorter."""
    if inputs.half_widths is not None:
        widths = inputs.half_widths
        return tuple([min(max(v, -w), w) for v, w in zip(u, widths, strict=True)])
    g = inputs(u)
    return tuple(u) if g <= 1 else tuple([v / g for v in u])


@dataclass(frozen=True, slots=True)
class Fallback:
    """The fallback of ``[link]``.

    Parameters
    ----------
    kind : {"hold", "zero", "regulator"}
    inputs : Gauge
        Of U.
    gain : tuple of tuple of float, shape (m, n), optional
        K of the regulator.
    """

    kind: Literal["hold", "zero", "regulator"]
    inputs: Gauge
    gain: Matrix | None = None

    @classmethod
    def of(cls, scenario: Scenario) -> "Fallback":
        """A scenario's."""
        inputs = Gauge.from_rows(*scenario.control.inputs.rows())
        return cls(scenario.link.fallback, inputs, scenario.control.gain)

    def input(self, x: Vector, in_force: Vector) -> Vector:
        """The input of a missed step at state ``x``, with ``in_force`` applied before it."""
        if self.kind == "hold":
            return in_force
        if self.kind == "zero":
            return (0.0,) * len(in_force)
        assert self.gain is not None, "validated"
        u = []
        for row in self.gain:
            total = row[0] * x[0]
            for j in range(1, len(row)):
                total += row[j] * x[j]
            u.append(total)
        return clip(u, self.inputs)
