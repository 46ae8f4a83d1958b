"""What a sensor adds to a reading: y = x + n, with n in N, and what that does to the test.

The controller sees y alone, and so does the test: y(k+1) - A y(k) - B u = d + n(k+1) - A n(k) is
in W = D_c + N - A N. W takes the place of D_c in the defender's half of the test and in the sets.
"""

from collections.abc import Sequence
from functools import cache
from typing import Literal, Self

from pydantic import model_validator

from protocol.knowledge import NotNegative
from protocol.scenario.parts import Positive, ScenarioTable, check_matrix
from protocol.scenario.sets import ConvexSet
from protocol.vectors import FiniteMatrix, FiniteVector


class NoiseSet(ScenarioTable):
    """N, what the sensors add to a reading: a box, flat where one is exact, or a polytope."""

    half_widths: tuple[NotNegative, ...] | None = None
    """The box of noises with abs(n_i) at most this; 0 for an exact sensor; or H and h."""
    H: FiniteMatrix | None = None
    """Rows of { n : H n <= h }."""
    h: tuple[Positive, ...] | None = None
    """Right-hand sides, each above 0."""

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.half_widths is None) == (self.H is None or self.h is None):
            raise ValueError("expected half_widths = [...], or H = [[...], ...] and h = [...]")
        if self.H is not None and self.h is not None:
            check_matrix(self.H)
            if len(self.H) != len(self.h):
                raise ValueError(f"expected as many entries in h as rows in H ({len(self.H)})")
        return self

    @property
    def dimension(self) -> int:
        """Number of components."""
        if self.half_widths is not None:
            return len(self.half_widths)
        assert self.H is not None
        return len(self.H[0])

    def corners(self) -> tuple[FiniteVector, ...]:
        """The polytope's corners, in a fixed order."""
        assert self.H is not None
        assert self.h is not None
        return _corners(self.H, self.h)

    def reach(self, row: Sequence[float]) -> float:
        """How far N reaches along ``row``: the largest row n."""
        if self.half_widths is not None:
            return sum(abs(a) * w for a, w in zip(row, self.half_widths, strict=True))
        return max(
            sum(a * v for a, v in zip(row, corner, strict=True)) for corner in self.corners()
        )

    def within(self, other: "NoiseSet") -> bool:
        """Whether this set lies in ``other``, to rounding."""
        if other.half_widths is not None:
            n = len(other.half_widths)
            pairs = [
                (tuple(sign if j == i else 0.0 for j in range(n)), width)
                for i, width in enumerate(other.half_widths)
                for sign in (1.0, -1.0)
            ]
        else:
            assert other.H is not None
            assert other.h is not None
            pairs = list(zip(other.H, other.h, strict=True))
        return all(self.reach(row) <= bound * (1 + 1e-12) for row, bound in pairs)


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


@cache
def _corners(H: FiniteMatrix, h: FiniteVector) -> tuple[FiniteVector, ...]:
    from protocol.convex import corners

    return tuple(sorted(tuple(v) for v in corners(H, h).tolist()))


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
