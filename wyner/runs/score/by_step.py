"""Small numbers by session and step, in two bytes each: a run has millions of steps."""

from array import array
from collections.abc import Iterable, Iterator, MutableMapping
from typing import Any, Final

Step = tuple[str, int]

TOGETHER: Final = 1024
"""Steps whose numbers stand together."""

LARGEST: Final = 2**15 - 1

_NONE: Final = -(2**15)


class BySteps(MutableMapping[Step, int]):
    """A mapping from (session, step) to a number, as a dict has it but for its order.

    A number above :data:`LARGEST`, which no symbol is, is taken for that.

    Parameters
    ----------
    items : iterable of ((str, int), int), optional
    """

    def __init__(self, items: Iterable[tuple[Step, int]] = ()) -> None:
        self._rows: dict[Step, array[int]] = {}
        self._count = 0
        for at, value in items:
            self[at] = value

    def get(self, at: Step, default: Any = None) -> Any:
        """The number of a step, or ``default``."""
        row = self._rows.get((at[0], at[1] // TOGETHER))
        value = _NONE if row is None else row[at[1] % TOGETHER]
        return default if value == _NONE else value

    def __contains__(self, at: object) -> bool:
        return isinstance(at, tuple) and self.get(at) is not None

    def __getitem__(self, at: Step) -> int:
        value = self.get(at)
        if value is None:
            raise KeyError(at)
        return int(value)

    def __setitem__(self, at: Step, value: int) -> None:
        where, place = (at[0], at[1] // TOGETHER), at[1] % TOGETHER
        if where not in self._rows:
            self._rows[where] = array("h", [_NONE]) * TOGETHER
        row = self._rows[where]
        self._count += (row[place] == _NONE) - (value == _NONE)
        row[place] = min(value, LARGEST)

    def __delitem__(self, at: Step) -> None:
        if at not in self:
            raise KeyError(at)
        self[at] = _NONE

    def __iter__(self) -> Iterator[Step]:
        for (session, number), row in self._rows.items():
            for place, value in enumerate(row):
                if value != _NONE:
                    yield session, number * TOGETHER + place

    def __len__(self) -> int:
        return self._count
