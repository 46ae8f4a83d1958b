"""Seeded streams of random numbers, for experiments; what is drawn live is the shell's matter.

Draws are indexed, so that a process that was killed and a vectorised engine both find the numbers
where they belong: the disturbance of step k is draw k, the coin and the random cipher symbol of
transition j are draws j. Every kind takes the same number of draws whatever the automaton's state.
"""

from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    import numpy as np

DISTURBANCE: Final = 0
COIN: Final = 1
CIPHER: Final = 2
SENSOR: Final = 3

BLOCK: Final = 256


def generator(seed: int, run: int, stream: int) -> "np.random.Generator":
    """The generator of one stream of one run, spawned from the experiment's seed.

    Draw i of width w is ``generator.random((count, w))[i]``.
    """
    import numpy as np

    sequence = np.random.SeedSequence(seed, spawn_key=(run, stream))
    return np.random.Generator(np.random.PCG64(sequence))


class Stream:
    """Uniform numbers in [0, 1), ``width`` a draw, by index; near-sequential access is cheap."""

    def __init__(self, seed: int, stream: int, *, width: int = 1, run: int = 0) -> None:
        self._seed = (seed, run, stream)
        self._width = width
        self._block = -1
        self._values: list[tuple[float, ...]] = []

    def at(self, index: int) -> tuple[float, ...]:
        """Draw number ``index``, shape (width,)."""
        block, place = divmod(index, BLOCK)
        if block != self._block:
            source = generator(*self._seed)
            source.bit_generator.advance(block * BLOCK * self._width)  # type: ignore[attr-defined]
            rows = source.random((BLOCK, self._width)).tolist()
            self._values = [tuple(row) for row in rows]
            self._block = block
        return self._values[place]


class SymbolSource(Protocol):
    """Gives the random symbol that belongs to a transition."""

    def symbol(self, transition: int, size: int) -> int:
        """A symbol in range(size)."""


class SeededSymbols:
    """Symbols of a seeded stream, for experiments only."""

    def __init__(self, seed: int, stream: int, *, run: int = 0) -> None:
        self._stream = Stream(seed, stream, run=run)

    def symbol(self, transition: int, size: int) -> int:
        """Symbol number ``transition`` of the stream, in range(size)."""
        return int(self._stream.at(transition)[0] * size)
