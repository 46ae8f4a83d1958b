"""Compact convex sets as a scenario file states them."""

from typing import Self

from pydantic import model_validator

from protocol.scenario.parts import Positive, ScenarioTable, check_matrix
from protocol.vectors import FiniteMatrix, FiniteVector


class ConvexSet(ScenarioTable):
    """A compact convex set with the origin inside: a box or the polytope { v : H v <= h }.

    Parameters
    ----------
    half_widths : tuple of float, shape (n,), optional
        The box of vectors with ``abs(v_i) <= half_widths_i``.
    H, h : tuple, shapes (rows, n) and (rows,), optional
        The polytope; every entry of ``h`` positive, so that the origin is inside.
    """

    half_widths: tuple[Positive, ...] | None = None
    """The box of vectors with abs(v_i) at most this; or H and h."""
    H: FiniteMatrix | None = None
    """Rows of { v : H v <= h }."""
    h: tuple[Positive, ...] | None = None
    """Right-hand sides, each above 0."""

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.half_widths is not None:
            if self.H is not None or self.h is not None:
                raise ValueError("expected half_widths, or H and h, and not both")
            if not self.half_widths:
                raise ValueError("expected at least one half-width")
            return self
        if self.H is None or self.h is None:
            raise ValueError("expected half_widths = [...], or H = [[...], ...] and h = [...]")
        check_matrix(self.H)
        if len(self.H) != len(self.h):
            raise ValueError(f"expected as many entries in h as rows in H ({len(self.H)})")
        return self

    @property
    def dimension(self) -> int:
        """Number of components of the set's vectors."""
        if self.half_widths is not None:
            return len(self.half_widths)
        assert self.H is not None
        return len(self.H[0])

    def rows(self) -> tuple[FiniteMatrix, FiniteVector]:
        """The set as (H, h) with H v <= h, for a box the rows e_i and -e_i in turn."""
        if self.half_widths is None:
            assert self.H is not None
            assert self.h is not None
            return self.H, self.h
        n = len(self.half_widths)
        unit = [tuple(1.0 if j == i else 0.0 for j in range(n)) for i in range(n)]
        rows = [row for e in unit for row in (e, tuple(-v for v in e))]
        return tuple(rows), tuple(w for w in self.half_widths for _ in range(2))

    def contains(self, other: "ConvexSet") -> bool:
        """Whether ``other`` lies within this set, to rounding."""
        if other.half_widths is not None:
            for row, bound in zip(*self.rows(), strict=True):
                reach = sum(abs(a) * w for a, w in zip(row, other.half_widths, strict=True))
                if reach > bound * (1 + 1e-12):
                    return False
            return True
        from protocol.convex import corners

        H, h = self.rows()
        points = corners(*other.rows()).tolist()
        return all(
            sum(a * v for a, v in zip(row, point, strict=True)) <= bound * (1 + 1e-9)
            for row, bound in zip(H, h, strict=True)
            for point in points
        )

    def scaled(self, factor: float) -> "ConvexSet":
        """The set ``factor`` times as large."""
        if self.half_widths is not None:
            return ConvexSet(half_widths=tuple(factor * w for w in self.half_widths))
        assert self.h is not None
        return ConvexSet(H=self.H, h=tuple(factor * b for b in self.h))
