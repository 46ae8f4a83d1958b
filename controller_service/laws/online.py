"""What the controller's service needs of a law: index and candidates of one state, from tables.

Nothing here loads numerics.
"""

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from protocol.errors import WynerError


class OutsideError(WynerError, LookupError):
    """A state outside every T_i; the message names the state, the largest set and the distance."""


class ProgramError(WynerError, LookupError):
    """A program without an answer that satisfies its constraints."""


class HasHorizon(Protocol):
    """A design, or as much as is known of it."""

    @property
    def horizon(self) -> int:
        """N, the index of the largest set."""


class OnlineLaw(Protocol):
    """A law as the controller's service asks it; see :class:`controller_service.laws.base`."""

    @property
    def design(self) -> HasHorizon: ...  # noqa: D102

    def index(self, x: Sequence[float]) -> int: ...  # noqa: D102

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]: ...  # noqa: D102


class Solver(Protocol):
    """Index and one input for each cost, of one state."""

    def index(self, x: Sequence[float]) -> int: ...  # noqa: D102

    def candidates(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]: ...  # noqa: D102

    def excess(self, x: Sequence[float]) -> float: ...  # noqa: D102


class OneState:
    """A law's path of one state, on the answers of ``programs``.

    ``inner`` has the rows of a K where every candidate at index 0 is K x, ``copies`` times.
    """

    programs: Solver
    inner: Sequence[Sequence[float]] = ()
    copies = 0
    _N: int

    def index(self, x: Sequence[float]) -> int:
        """See :meth:`controller_service.laws.base.CandidateLaw.index`."""
        i = self.programs.index(x)
        if i > self._N:
            raise self._outside(x)
        return i

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """See :meth:`controller_service.laws.base.CandidateLaw.candidates`."""
        i = self.index(x)
        try:
            return self.answers(x, i)
        except ValueError as error:
            raise ProgramError(f"at x = {list(x)}, index {i}: {error}") from None

    def answers(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        """The candidates at x of index i; ValueError when no input is left."""
        if i > 0 or not self.inner:
            return self.programs.candidates(x, i)
        u = []
        for row in self.inner:
            # From the left, product by product: to the last bit what many states get.
            total = row[0] * float(x[0])
            for k, v in zip(row[1:], x[1:], strict=True):
                total = total + k * float(v)
            u.append(total)
        return (tuple(u),) * self.copies

    def _outside(self, x: Sequence[float]) -> OutsideError:
        # The look-up's rounding and this one's differ: at an edge the excess may come out negative.
        excess = max(0.0, self.programs.excess(x))
        return OutsideError(
            f"the state {[float(v) for v in x]} is outside T_{self._N}, the largest set: it lies "
            f"{excess:.6g} beyond a facet"
        )


class Table(NamedTuple):
    """Keys and three columns beside them, as arrays whose items are plain floats.

    Lists of floats and tuples took 25 MiB for 250 sets; the arrays' own memory is read instead.
    """

    keys: "memoryview[float]"
    first: "memoryview[float]"
    second: "memoryview[float]"
    third: "memoryview[float]"


class Lookup:
    """Index and candidates of a planar plant with one input, of one state.

    The tables are those of :class:`controller_service.laws.planar.Planar`, which tells what they
    hold.
    """

    N: int
    u_min: float
    u_max: float
    _first: int  # keys of T_0
    _last: int  # rows of T_N
    _facets: Table
    _upper: Table
    _lower: Table
    _lines: Sequence[tuple[float, float, float]]
    _gains: Sequence[tuple[float, float]]

    def index(self, x: Sequence[float]) -> int:
        """i(k), or N + 1 outside every set: T_0 first, where a closed loop nearly always is."""
        x1, x2 = float(x[0]), float(x[1])
        r = abs(x1) + abs(x2)
        q = x2 / r if r > 0.0 else x2
        p = 2.0 - q if x1 < 0.0 else (4.0 + q if x2 < 0.0 else q)
        keys, a1, a2, b = self._facets
        at = bisect_right(keys, p, 0, self._first)
        if a1[at] * x1 + a2[at] * x2 <= b[at]:
            return 0
        low, high = 1, self.N + 1
        while low < high:
            i = (low + high) >> 1
            at = bisect_right(keys, 4.0 * i + p) + i
            if a1[at] * x1 + a2[at] * x2 <= b[at]:
                high = i
            else:
                low = i + 1
        return low

    def excess(self, x: Sequence[float]) -> float:
        """How far x is outside the largest set, in the unit of its h; zero or less inside."""
        _, a1, a2, b = self._facets
        x1, x2 = float(x[0]), float(x[1])
        return max(a1[at] * x1 + a2[at] * x2 - b[at] for at in range(len(b) - self._last, len(b)))

    def interval(self, x1: float, x2: float, j: int) -> tuple[float, float]:
        """Inputs in U that steer x into the tightened target j; empty when low > high."""
        l1, l2, shift = self._lines[j]
        key = (l1 * x1 + l2 * x2) + shift
        keys, q, c1, c2 = self._upper
        at = bisect_right(keys, key) + j
        high = q[at] - (c1[at] * x1 + c2[at] * x2)
        keys, q, c1, c2 = self._lower
        at = bisect_right(keys, key) + j
        low = q[at] - (c1[at] * x1 + c2[at] * x2)
        return (
            low if low > self.u_min else self.u_min,
            high if high < self.u_max else self.u_max,
        )

    def candidates(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        """One input for each cost at index i; ValueError when the interval is empty."""
        x1, x2 = float(x[0]), float(x[1])
        low, high = self.interval(x1, x2, i - 1 if i > 0 else 0)
        if not low <= high:
            raise ValueError(f"no input in [{low!r}, {high!r}]")
        out = []
        for k1, k2 in self._gains:
            u = k1 * x1 + k2 * x2
            if u < low:
                u = low
            elif u > high:
                u = high
            out.append((u,))
        return tuple(out)
