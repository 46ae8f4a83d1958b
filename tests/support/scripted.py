"""A dashboard's source without a network."""

from collections.abc import Iterable, Sequence

from wyner.dashboard.model import Arrival
from wyner.dashboard.source import BusSource


class ScriptedSource(BusSource):
    """Gives prepared batches, one at each call; its clock stands at the last arrival given."""

    def __init__(self, batches: Iterable[Sequence[Arrival]]) -> None:
        self._batches = iter(batches)
        self._next = next(self._batches, None)
        self._now_ns = 0

    @property
    def exhausted(self) -> bool:
        """Whether all batches were given."""
        return self._next is None

    def drain(self) -> Sequence[Arrival]:
        """The next batch, or nothing."""
        batch = self._next or ()
        self._next = next(self._batches, None)
        if batch:
            self._now_ns = batch[-1].t_ns
        return batch

    def now_ns(self) -> int:
        """The time of the last arrival given."""
        return self._now_ns

    def problems(self) -> Sequence[str]:
        """Nothing goes wrong in a script."""
        return ()
