"""Small numbers by session and step, in two bytes each: a run has millions of steps."""

from array import array
from collections.abc import Iterable, Iterator, MutableMapping
from typing import Any, Final

Step = tuple[str, int]

_NONE: Final = -(2**15)
_LARGEST: Final = 2**15 - 1

GAP: Final = 1 << 16
"""Steps that may lie between two: what is further away stands by itself."""


class BySteps(MutableMapping[Step, int]):
    """A mapping from (session, step) to a number, as a dict has it but for its order.

    Steps of a session come in rising order. A number that two bytes do not hold, or a step far from
    the others, takes a dict's room.

    Parameters
    ----------
    items : iterable of ((str, int), int), optional
    """

    def __init__(self, items: Iterable[tuple[Step, int]] = ()) -> None:
        self._rows: dict[str, tuple[int, array[int]]] = {}
        self._others: dict[Step, int] = {}
        self._count = 0
        for at, value in items:
            self[at] = value

    def get(self, at: Step, default: Any = None) -> Any:
        """The number of a step, or ``default``."""
        session, k = at
        first, row = self._rows.get(session, _EMPTY)
        if 0 <= k - first < len(row) and (value := row[k - first]) != _NONE:
            return value
        return self._others.get(at, default) if self._others else default

    def __contains__(self, at: object) -> bool:
        return isinstance(at, tuple) and self.get(at) is not None

    def __getitem__(self, at: Step) -> int:
        value = self.get(at)
        if value is None:
            raise KeyError(at)
        return int(value)

    def __setitem__(self, at: Step, value: int) -> None:
        session, k = at
        if session not in self._rows:
            self._rows[session] = (k, array("h"))
        first, row = self._rows[session]
        place = k - first
        if not (0 <= place < len(row) + GAP and _NONE < value <= _LARGEST):
            if 0 <= place < len(row) and row[place] != _NONE:
                row[place] = _NONE
                self._count -= 1
            self._others[at] = value
            return
        self._others.pop(at, None)
        if place >= len(row):
            row.extend([_NONE] * (place + 1 - len(row)))
        self._count += row[place] == _NONE
        row[place] = value

    def __delitem__(self, at: Step) -> None:
        if at in self._others:
            del self._others[at]
            return
        if at not in self:
            raise KeyError(at)
        first, row = self._rows[at[0]]
        row[at[1] - first] = _NONE
        self._count -= 1

    def __iter__(self) -> Iterator[Step]:
        for session, (first, row) in self._rows.items():
            for place, value in enumerate(row):
                if value != _NONE:
                    yield session, first + place
        yield from self._others

    def __len__(self) -> int:
        return self._count + len(self._others)


_EMPTY: Final[tuple[int, "array[int]"]] = (0, array("h"))
