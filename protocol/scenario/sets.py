"""Compact convex sets as a scenario file states them."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Annotated, Final, Self

from pydantic import BeforeValidator, model_validator

from protocol.knowledge import NotNegative
from protocol.scenario.parts import Positive, ScenarioTable, check_matrix, shape_problem
from protocol.vectors import FiniteMatrix, FiniteVector

BOX_ROUNDING: Final = 1e-12
"""Relative error that the reach of a box may have."""

CORNER_ROUNDING: Final = 1e-9
"""Relative error that computed corners may have."""


class SetTable(ScenarioTable):
    """A compact convex set with the origin in it: a box, or the polytope { v : H v <= h }."""

    half_widths: tuple[NotNegative, ...] | None = None
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

    def corners(self) -> tuple[FiniteVector, ...]:
        """The polytope's corners, in a fixed order."""
        assert self.H is not None
        assert self.h is not None
        return _corners(self.H, self.h)

    def reach(self, row: Sequence[float]) -> float:
        """How far the set reaches along ``row``: the largest row v."""
        if self.half_widths is not None:
            return sum(abs(a) * w for a, w in zip(row, self.half_widths, strict=True))
        return max(
            sum(a * v for a, v in zip(row, corner, strict=True)) for corner in self.corners()
        )

    def contains(self, other: "SetTable") -> bool:
        """Whether ``other`` lies within this set, to rounding."""
        rounding = CORNER_ROUNDING if other.half_widths is None else BOX_ROUNDING
        return all(
            other.reach(row) <= bound * (1 + rounding)
            for row, bound in zip(*self.rows(), strict=True)
        )


class ConvexSet(SetTable):
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

    def scaled(self, factor: float) -> "ConvexSet":
        """The set ``factor`` times as large."""
        if self.half_widths is not None:
            return ConvexSet(half_widths=tuple(factor * w for w in self.half_widths))
        assert self.h is not None
        return ConvexSet(H=self.H, h=tuple(factor * b for b in self.h))


def _not_flat(value: object) -> object:
    """Refuse a box of width 0 with what to write instead."""
    if isinstance(value, dict) and 0 in (value.get("half_widths") or ()):
        raise ValueError(
            "expected every half-width greater than 0: for a state that nothing disturbs a small "
            "one, such as a thousandth of what it moves by in a step"
        )
    return value


Resisted = Annotated[ConvexSet, BeforeValidator(_not_flat)]
"""A set of disturbances that the law's sets resist."""


def set_problem(field: str, s: SetTable | None, n: int) -> Iterator[str]:
    """A line where a set is of other vectors, and where a polytope has no interior or no bound."""
    if s is None:
        return
    yield from shape_problem(field, s.dimension, n)
    if s.half_widths is not None:
        return
    from protocol.convex import SetError

    try:
        s.corners()
    except SetError as error:
        yield f"{field}: {error}, expected a compact one"


@cache
def _corners(H: FiniteMatrix, h: FiniteVector) -> tuple[FiniteVector, ...]:
    from protocol.convex import corners

    return tuple(sorted(tuple(v) for v in corners(H, h).tolist()))
