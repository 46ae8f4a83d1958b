"""What `fitted-box`, `learning` and `smoother` do where some outputs alone are read.

They keep what they heard, and each time they have heard so much more they make their model anew
from all of it, follow it from the beginning, and decode under every number of steps that the two
ends may have lost (:mod:`tap_service.inference.opening`). They differ in how the model is made.
Which transitions agreed nobody tells them: they take all others for agreed.
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any, Self

from protocol.schemes.base import Scheme
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Belief, Guess, MessageSymbols, even, nearest
from tap_service.eavesdroppers.list_decoder import Collected, decode_known
from tap_service.inference.list_decoding import ListDecoding
from tap_service.inference.opening import Known, Opening
from tap_service.inference.output_fit import refitted
from tap_service.inference.output_model import OutputModel

Make = Callable[[Sequence[Transition], "OutputModel | None"], "OutputModel | None"]
"""Makes a model of what was heard, and of the model before; None where it is too little."""


class ByReadings:
    """Keeps readings and offers, and decodes them again and again.

    Parameters
    ----------
    scheme : Scheme
    make : callable
        See :data:`Make`.
    told : OutputModel, optional
        The model that she was told.
    first : int
        Transitions before the first model.
    growth : float
        She makes a new one when she has heard this many times as much.
    kept : int
        Transitions that are kept; at this many the older half goes, decoded for good.

    Attributes
    ----------
    model : OutputModel or None
        The newest.
    final_guesses : list of Guess
        Of the transitions that went; whoever feeds her takes them off.
    """

    def __init__(
        self,
        scheme: Scheme[Any],
        make: Make,
        *,
        told: OutputModel | None = None,
        first: int,
        growth: float,
        kept: int,
    ) -> None:
        self._scheme, self._make = scheme, make
        self._growth, self._most = growth, kept
        self._size = scheme.alphabet
        self._even = even(self._size)
        self.model = None if told is None else told.anew()
        self.final_guesses: list[Guess] = []
        self._kept: list[Transition] = []
        self._known: list[Known] = []
        self._before: ListDecoding | None = None
        self._decoding = self._new_decoding()
        self._collected = Collected()
        self._heard = self._decoded = 0
        self._next = first

    @classmethod
    def refitting(
        cls,
        scheme: Scheme[Any],
        told: OutputModel,
        *,
        each: bool,
        first: int,
        growth: float,
        kept: int,
    ) -> Self:
        """Of one who keeps the model that she was told, and fits how far all of it scatters.

        ``each`` is whether each coordinate of the disturbance has a width of its own.
        """
        return cls(
            scheme,
            lambda heard, _: refitted(told, heard, each=each),
            told=told,
            first=first,
            growth=growth,
            kept=kept,
        )

    def _new_decoding(self) -> ListDecoding:
        return ListDecoding(self._scheme, edge=1.0, certain=True)

    def observe(self, t: Transition) -> Guess:
        """The nearest candidate by the model so far; evenly where there is none."""
        self._kept.append(t)
        self._heard += 1
        gauges = None if self.model is None else self.model.observe(t)
        if self._heard >= self._next:
            self.decode()
            self._next = max(self._heard + 1, int(self._heard * self._growth))
        if len(self._kept) >= self._most:
            self._let_go(self._most // 2)
        if gauges is None or self.model is None:
            return Guess(t.k, self._even, 0.5)
        return Guess(t.k, nearest(gauges), float(self.model.settled))

    def decode(self) -> None:
        """Make a model of all that is kept, and decode it from where what went leaves off."""
        if self._decoded == self._heard:
            return
        self._decoded = self._heard
        model = self._make(self._kept, self.model)
        if model is None:
            return
        self.model = model = model.anew()
        opening = Opening(model, self._size)
        self._known = [one for t in self._kept for one in opening.take(t)[0]] + opening.flush()
        self._decoding = self._follow(self._known)
        self._collected.take(self._decoding, self._kept[-1].k)

    def _follow(self, known: Sequence[Known]) -> ListDecoding:
        decoding = self._new_decoding() if self._before is None else deepcopy(self._before)
        for one in known:
            decode_known(decoding, one, None if one.symbol is None else one.shares)
        return decoding

    def _let_go(self, count: int) -> None:
        self.decode()
        if self._known:
            self._before = self._follow(self._known[:count])
        self.final_guesses += self._thoughts()[:count]
        self._kept, self._known = self._kept[count:], self._known[count:]

    def _thoughts(self) -> list[Guess]:
        if not self._known:
            return [Guess(t.k, self._even, 0.5, t.session) for t in self._kept]
        return [
            Guess(one.transition.k, one.shares or self._even, 0.5, one.transition.session)
            for one in self._known
        ]

    def review(self) -> Sequence[Guess]:
        """What she takes each kept step for, with what came after it."""
        self.decode()
        return self._thoughts()

    def belief(self) -> Belief:
        """The last whole message, else what the best decoding spells so far."""
        if self._collected.solved_k < 0:
            self.decode()
        return self._collected.belief(self._decoding, self.model)

    def message_symbols(self) -> MessageSymbols:
        """Those of the newest decoding."""
        return self._decoding.message_symbols()
