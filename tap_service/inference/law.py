"""What a smoother asks of a control law: what an offer says of its state, and what a state says
of its offer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from protocol.arrays import Array, Flags, Indices


@dataclass(frozen=True)
class Item:
    """A part of an offer, and the ways in which it may have come about: C x = y in each.

    Parameters
    ----------
    C : array, shape (ways, r, n)
    y : array, shape (ways, r)
    variance : float
        Of each reading.
    holds : callable, optional
        Whether the law answers so: of states of shape (N, places, n), a way for each N, the flags.
    """

    C: Array
    y: Array
    variance: float
    holds: Callable[[Array, Indices], Flags] | None = None


@dataclass(frozen=True)
class Form:
    """What is offered about states: u_i = G_i x + g_i, but for an error.

    Parameters
    ----------
    weight : float
        Log probability that it is.
    G : array, shape (N or 1, M, m, n)
    g : array, shape (N or 1, M, m)
    error : float
        Standard deviation.
    """

    weight: float
    G: Array
    g: Array
    error: float


class Law(Protocol):
    """A control law as far as she knows it."""

    @property
    def spread(self) -> float:
        """Standard deviation of what is offered."""
        ...

    @property
    def shared(self) -> bool:
        """Whether the candidates stand about one input."""
        ...

    @property
    def error(self) -> float:
        """Standard deviation of what it leaves."""
        ...

    def averaged(self, u: Array) -> Array:
        """An offer whose candidates share one input, each misread by itself, with that of all."""
        ...

    def items(self, offer: Array, noise: float) -> Sequence[Item]:
        """The parts of an offer, shape (M, m), that hold or fail together."""
        ...

    def forms(self, x: Array) -> Sequence[Form]:
        """What an offer about states ``x``, shape (N, n), may be; the likeliest first."""
        ...
