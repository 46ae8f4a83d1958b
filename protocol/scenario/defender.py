"""``[defender]``: the identified model that the agreement test asks."""

from collections.abc import Iterator

from protocol.scenario.parts import Matrix, Part, shape, shape_problem
from protocol.scenario.plant import Disturbance
from protocol.scenario.sets import ConvexSet


class Defender(Part):
    """The identified model (5): A and B (the plant's own where not given) and D_c."""

    A: Matrix | None = None
    B: Matrix | None = None
    disturbance: ConvexSet

    def problems(self, n: int, m: int) -> Iterator[str]:
        """What does not fit a plant of ``n`` states and ``m`` inputs, a line each."""
        if self.A is not None:
            yield from shape_problem("defender.A", shape(self.A), (n, n))
        if self.B is not None:
            yield from shape_problem("defender.B", shape(self.B), (n, m))
        yield from shape_problem("defender.disturbance", self.disturbance.dimension, n)

    def covers(self, d: Disturbance) -> bool:
        """Whether the box that ``d`` is drawn from lies within D_c."""
        for row, bound in zip(*self.disturbance.rows(), strict=True):
            reach = sum(abs(a) * w for a, w in zip(row, d.half_widths, strict=True))
            if reach > bound * (1 + 1e-12):
                return False
        return True
