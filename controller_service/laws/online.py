"""What the controller's service needs of a law: index and candidates of one state, from tables.

Nothing here loads numerics. A law whose path of one state is :class:`OneState`'s on a planar
:class:`Lookup` leaves its tables beside the cached design, in a file of plain numbers with a
checksum; a controller that finds them starts without NumPy, and answers the same to the last bit.
"""

import hashlib
import json
import sys
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from protocol.scenario import Scenario
from runtime.cache_folder import cache_folder
from runtime.files import PUBLIC_FILE, write_atomically

MAGIC: Final = b"wyner-law-1\n"
"""Version of the tables' file; it goes up when the format changes."""


class OutsideError(LookupError):
    """A state outside every T_i; the message names the state, the largest set and the distance."""


class ProgramError(LookupError):
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


class _Horizon(NamedTuple):
    horizon: int


class StoredLaw(OneState):
    """A law read back from its tables."""

    def __init__(self, programs: Lookup, inner: Sequence[Sequence[float]], copies: int) -> None:
        self.programs = programs
        self.inner, self.copies = inner, copies
        self._N = programs.N
        self.design = _Horizon(programs.N)


def _path(scenario: Scenario, folder: Path | None) -> Path:
    """The file of a law's tables; its name says all that they depend on."""
    told = [scenario.design_fingerprint(), scenario.control.model_dump_json()]
    name = hashlib.sha256(json.dumps(told).encode()).hexdigest()
    return (folder or cache_folder("designs")) / f"{name}.law"


def store_law(law: object, scenario: Scenario, folder: Path | None = None) -> bool:
    """Write a law's tables; False where it is not one of tables alone, or cannot be written."""
    ours = (OneState.index, OneState.candidates, OneState.answers)
    if not isinstance(law, OneState) or not isinstance(law.programs, Lookup):
        return False
    if (type(law).index, type(law).candidates, type(law).answers) != ours:
        return False
    if sys.byteorder != "little":
        return False
    p = law.programs
    tables = (p._facets, p._upper, p._lower)
    head: dict[str, Any] = {
        "N": p.N,
        "u": [p.u_min, p.u_max],
        "ends": [p._first, p._last],
        "lines": p._lines,
        "gains": p._gains,
        "inner": law.inner,
        "copies": law.copies,
        "lengths": [len(column) for table in tables for column in table],
    }
    header = json.dumps(head).encode()
    columns = b"".join(column.tobytes() for table in tables for column in table)
    body = len(header).to_bytes(8, "little") + header + columns
    try:
        data = MAGIC + hashlib.sha256(body).digest() + body
        write_atomically(_path(scenario, folder), data, PUBLIC_FILE)
    except OSError:
        return False
    return True


def stored_law(scenario: Scenario, folder: Path | None = None) -> StoredLaw | None:
    """The scenario's law from its tables; None where there are none, or they are damaged."""
    try:
        data = _path(scenario, folder).read_bytes()
    except OSError:
        return None
    start = len(MAGIC) + 32
    magic, digest, body = data[: len(MAGIC)], data[len(MAGIC) : start], memoryview(data)[start:]
    if magic != MAGIC or hashlib.sha256(body).digest() != digest or sys.byteorder != "little":
        return None
    size = int.from_bytes(body[:8], "little")
    head = json.loads(bytes(body[8 : 8 + size]))
    numbers = body[8 + size :].cast("d")
    columns, at = [], 0
    for length in head["lengths"]:
        columns.append(numbers[at : at + length])
        at += length
    p = Lookup()
    p.N, (p.u_min, p.u_max), (p._first, p._last) = head["N"], head["u"], head["ends"]
    p._facets, p._upper, p._lower = (Table(*columns[i : i + 4]) for i in (0, 4, 8))
    p._lines = [tuple(line) for line in head["lines"]]
    p._gains = [tuple(gain) for gain in head["gains"]]
    return StoredLaw(p, head["inner"], head["copies"])
