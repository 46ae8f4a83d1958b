"""What a sensor adds to a reading: y = x + n, with n in N, and what that does to the test.

The controller sees y alone, and so does the test: y(k+1) - A y(k) - B u = d + n(k+1) - A n(k) is
in W = D_c + N - A N. W takes the place of D_c in the defender's half of the test and in the sets.
"""

from collections.abc import Sequence
from typing import Literal, Self

from pydantic import model_validator

from protocol.knowledge import NotNegative
from protocol.scenario.sets import ConvexSet, SetTable
from protocol.vectors import FiniteMatrix, FiniteVector


class NoiseSet(SetTable):
    """N, what the sensors add to a reading: a box, flat where one is exact, or a polytope."""

    half_widths: tuple[NotNegative, ...] | None = None
    """The box of noises with abs(n_i) at most this; 0 for an exact sensor; or H and h."""


class SensorNoise(NoiseSet):
    """n(k), drawn anew in each step: ``uniform`` from a box, or one of the set's ``corners``."""

    kind: Literal["uniform", "corners"] = "uniform"
    """How n(k) is drawn; of a polytope its corners."""

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        if self.half_widths is None and self.kind != "corners":
            raise ValueError(f"kind: got {self.kind!r}, expected 'corners' for a polytope")
        return self

    def drawn(self, uniforms: Sequence[float]) -> FiniteVector:
        """n from as many uniform numbers as it has components."""
        if self.half_widths is None:
            corners = self.corners()
            return corners[int(uniforms[0] * len(corners))]
        pairs = zip(uniforms, self.half_widths, strict=True)
        if self.kind == "corners":
            return tuple([w if v >= 0.5 else -w for v, w in pairs])
        return tuple([(2.0 * v - 1.0) * w for v, w in pairs])


def widened(D_c: ConvexSet, N: NoiseSet, A: FiniteMatrix) -> ConvexSet:
    """A set with D_c's rows that holds D_c + N - A N; both ends come to the same numbers.

    A corner's last digits may differ between machines, and so each bound is raised to six digits
    where N is a polytope.
    """
    H, h = D_c.rows()
    n = len(A)
    bounds = []
    for row, bound in zip(H, h, strict=True):
        moved = [-sum(row[i] * A[i][j] for i in range(n)) for j in range(n)]
        total = bound + N.reach(row) + N.reach(moved)
        bounds.append(total if N.half_widths is not None else float(f"{total * 1.000001:.5e}"))
    if D_c.half_widths is not None:
        both = zip(bounds[::2], bounds[1::2], strict=True)
        return ConvexSet(half_widths=tuple(max(pair) for pair in both))
    return ConvexSet(H=H, h=tuple(bounds))
