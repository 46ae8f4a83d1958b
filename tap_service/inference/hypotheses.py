"""Many hypotheses side by side, a column for each thing that is kept of them."""

from typing import Final

import numpy as np

from protocol.arrays import Array, Indices

_REALS: Final = ("lo", "hi", "edge_lo", "edge_hi", "score", "mark")
_COUNTS: Final = (
    "state",
    "node",
    "phase",
    "count",
    "value",
    "bytes",
    "length",
    "before",
    "last",
    "crc",
    "passed",
)


class Hypotheses:
    """A list whose first ``n`` entries count. A step reads a few columns of all of them.

    Parameters
    ----------
    room : int
        Entries that there is room for; it grows.

    Attributes
    ----------
    lo, hi, edge_lo, edge_hi : float arrays
        The rectangle: t_c from and to, t_e from and to.
    score : float array
        Log ratio of the symbols as a message over random ones.
    mark : float array
        What the score was when the check of the frame under way began.
    state : integer array
        The scheme's, as its table numbers them.
    node : integer array
        Where the path of message symbols ends, -1 for none.
    phase, count, value, bytes, length, crc : integer arrays
        Of the frame under way: 0 outside and 1 inside, digits of the next byte and what they say so
        far, bytes, the payload's length once it is known, else -1, and the running check.
    before, last : integer arrays
        The classes of the last two bytes of text.
    passed : integer array
        Frames whose check held.
    """

    lo: Array
    hi: Array
    edge_lo: Array
    edge_hi: Array
    score: Array
    mark: Array
    state: Indices
    node: Indices
    phase: Indices
    count: Indices
    value: Indices
    bytes: Indices
    length: Indices
    before: Indices
    last: Indices
    crc: Indices
    passed: Indices

    def __init__(self, room: int) -> None:
        self.n = 1
        self._take_room(np.zeros((len(_REALS), room)), np.zeros((len(_COUNTS), room), np.intp))

    def _take_room(self, reals: Array, counts: Indices) -> None:
        self._reals, self._counts = reals, counts
        for names, columns in ((_REALS, reals), (_COUNTS, counts)):
            for name, column in zip(names, columns, strict=True):
                setattr(self, name, column)

    def __deepcopy__(self, memo: dict[int, object]) -> "Hypotheses":
        whole = Hypotheses(0)
        whole.n = self.n
        # the columns are views of these two, which copies made one by one would not be
        whole._take_room(self._reals.copy(), self._counts.copy())
        return whole

    def copy(self, which: Indices) -> Indices:
        """Add copies of some at the end; where they are."""
        n, after = self.n, self.n + len(which)
        if after > self._reals.shape[1]:
            more = ((0, 0), (0, 2 * after - self._reals.shape[1]))
            self._take_room(np.pad(self._reals, more), np.pad(self._counts, more))
        self._reals[:, n:after] = self._reals[:, which]
        self._counts[:, n:after] = self._counts[:, which]
        self.n = after
        return np.arange(n, after)

    def keep(self, which: Indices) -> None:
        """Drop all others; those that stay come in the order given."""
        self.n = len(which)
        self._reals[:, : self.n] = self._reals[:, which]
        self._counts[:, : self.n] = self._counts[:, which]

    @property
    def best(self) -> int:
        """The most plausible one."""
        return int(self.score[: self.n].argmax())
