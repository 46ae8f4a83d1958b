"""A search for messages under each threshold that is likely, and what all of them come to together.

The defender's threshold is one for all steps. So each interval of thresholds has a lattice of its
own, and a message weighs what it weighs under all of them. Nodes have a row for each interval.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.inference.english import AnyBytes, English
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_search import (
    KEPT,
    AnyMessage,
    Found,
    MessageSearch,
)

ENOUGH: Final = 12.0
"""Log ratio by which a message must outweigh all that is under thresholds not searched by then."""

CLEARLY: Final = float(np.log(20))
"""Log ratio by which silence must be likelier than a message for none to be searched."""

NOTHING: Final = -np.inf

TINY: Final = 1e-300


class SharedSearch:
    """Searches one frame under every likely threshold.

    Parameters
    ----------
    lattices : sequence of Lattice
        Of the same steps, one an interval of thresholds.
    beam : int

    Attributes
    ----------
    beam : int
        Hypotheses kept from symbol to symbol in each.
    """

    def __init__(self, lattices: Sequence[Lattice], beam: int) -> None:
        self._lattices = lattices
        self._searches = [MessageSearch(lattice, beam) for lattice in lattices]
        self._found: list[Found | None] = []
        self._unsearched = NOTHING
        self.beam = beam

    def begin(self, entry: Array, shares: Sequence[float]) -> Array:
        """Log weights of nodes before the first step, shape (intervals, K + 1, E).

        Parameters
        ----------
        entry : array, shape (E,)
            Probability of the scheme's state.
        shares : sequence of float
            Of each interval the probability.
        """
        out = np.full((len(self._lattices), self._lattices[0].steps + 1, len(entry)), NOTHING)
        with np.errstate(divide="ignore"):
            out[:, 0] = np.log(np.outer(shares, entry))
        return out

    def none_after(self, begin: Array) -> float:
        """See :meth:`Lattice.none_after`."""
        each = [one.none_after(b) for one, b in zip(self._lattices, begin, strict=True)]
        return float(np.logaddexp.reduce(each))

    def shares(self, begin: Array) -> Array:
        """Of each interval the probability, by all that may follow ``begin``."""
        none = [one.none_after(b) for one, b in zip(self._lattices, begin, strict=True)]
        weights = np.logaddexp(self._messages(begin), none)
        if not np.isfinite(weights.max()):
            return np.full(len(weights), 1 / len(weights))
        out: Array = np.exp(weights - np.logaddexp.reduce(weights))
        return out

    def silent(self, begin: Array) -> bool:
        """Whether silence alone after ``begin`` is clearly likelier than a message."""
        message = float(np.logaddexp.reduce(self._messages(begin)))
        return self.none_after(begin) > message + CLEARLY

    def _messages(self, begin: Array) -> Array:
        """Log weight of messages of any bytes, under each interval."""
        return np.array([s.message(b) for s, b in zip(self._searches, begin, strict=True)])

    def find(self, begin: Array, language: English | AnyBytes, beam: int) -> Found | None:
        """Search the frame that comes next after ``begin``, log weights of nodes.

        The likeliest intervals first, until a message clearly outweighs what is under the others.
        """
        self.beam = beam
        weights = self._messages(begin)
        self._found = [None] * len(weights)
        best, rest = NOTHING, list(np.argsort(-weights))
        while rest and best <= np.logaddexp.reduce(weights[rest]) + ENOUGH:
            i = rest.pop(0)
            one = self._found[i] = self._searches[i].find(begin[i], language, beam)
            best = max(best, NOTHING if one is None else float(one.weights.max(initial=NOTHING)))
        self._unsearched = float(np.logaddexp.reduce(weights[rest], initial=NOTHING))
        return together(self._found, begin.shape, self._unsearched)

    def find_wider(self, begin: Array, language: English | AnyBytes, beam: int) -> Found | None:
        """Search again, more widely, where as much as anywhere was let go."""
        self.beam = beam
        lost = [NOTHING if f is None else f.lost for f in self._found]
        for i in np.flatnonzero(np.array(lost) > max(lost) - 1.0).tolist():
            self._found[i] = self._searches[i].find(begin[i], language, beam)
        return together(self._found, begin.shape, self._unsearched)

    def any_bytes(self, begin: Array, rng: np.random.Generator) -> AnyMessage:
        """What is known of a message of any bytes, under the interval that is likeliest for one."""
        best = int(np.argmax(self._messages(begin)))
        found, ends = self._searches[best].any_bytes(begin[best], rng), np.full_like(begin, NOTHING)
        ends[best] = found.ends
        return replace(found, ends=ends)


def together(
    founds: Sequence[Found | None], shape: tuple[int, ...], unsearched: float
) -> Found | None:
    """What searches under each threshold come to together.

    Parameters
    ----------
    founds : sequence of Found
        None where there is no message to be found.
    shape : tuple of int
        Of what follows: log weights of nodes, a row for each of ``founds``.
    unsearched : float
        Log weight of messages under other thresholds, which counts as let go.
    """
    here = [(i, f) for i, f in enumerate(founds) if f is not None]
    if not here:
        return None
    weights: dict[bytes, float] = {}
    for _, f in here:
        for payload, weight in zip(f.payloads, f.weights.tolist(), strict=True):
            weights[payload] = float(np.logaddexp(weights.get(payload, NOTHING), weight))
    payloads = sorted(weights, key=lambda one: -weights[one])[:KEPT]
    ends = np.full(shape, NOTHING)
    for i, f in here:
        # where another is likelier, this one's end is not looked for
        if payloads and f.payloads[:1] == (payloads[0],):
            ends[i] = f.ends
    plain = float(np.logaddexp.reduce([unsearched, *(f.plain for _, f in here)]))
    share = np.exp([f.plain - plain if np.isfinite(plain) else NOTHING for _, f in here])
    kept = float(share @ [f.kept for _, f in here])
    said = [f.surprise for _, f in here] - np.log2(np.maximum(share, TINY))
    of_any = np.array([f.any for _, f in here])
    open_ = max((f for _, f in here), key=lambda f: f.open)
    at, likeliest = max(here, key=lambda one: one[1].plain)
    unchecked = np.full(shape, NOTHING)
    unchecked[at] = likeliest.unchecked_ends
    length = np.exp(of_any - np.logaddexp.reduce(of_any))
    return Found(
        tuple(payloads),
        np.array([weights[payload] for payload in payloads]),
        plain,
        kept,
        float(share @ said),
        ends,
        float(np.logaddexp.reduce([unsearched, *of_any])),
        open_.under_way,
        float(np.logaddexp.reduce([f.open for _, f in here])),
        open_.missing,
        open_.unsent,
        float(length @ [f.longest for _, f in here]),
        likeliest.unchecked,
        unchecked,
    )
