"""`list-decoder`: sweeps the hidden threshold and keeps every decoding that is consistent.

She knows f_c and D_e (model 10), so t_e = 1 in units of D_e, and only t_c = 1 / alpha is hidden.
Over N steps at most about N + 1 thresholds give different decodings. She keeps them all
(:mod:`tap_service.inference.list_decoding`), and the frame's check picks the one: where there is no
frame, English does. The key symbols are the nearest candidates', as for `nearest-centre`. Where
outputs alone are read and every transition agrees but some at a session's beginning and after a
stretch of missed steps, no threshold is hidden but how many those are: she keeps a decoding for
each number.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Guess,
    Measuring,
    MessageSymbols,
    Model,
    even,
    nearest,
    opening_of,
)
from tap_service.inference.kept import KEPT_MESSAGES
from tap_service.inference.list_decoding import ListDecoding
from tap_service.inference.opening import Known, Opening


class ListDecoder(Eavesdropper):
    """Follows every threshold at once and ranks by frame check and plausibility.

    Parameters
    ----------
    knowledge : Knowledge
    framed : bool
        Whether messages come in frames; otherwise they are raw bytes of English text.
    """

    name: ClassVar[str] = "list-decoder"
    heavy: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge, *, framed: bool = True) -> None:
        super().__init__(knowledge)
        self._model = Model.of(knowledge, self.name)
        self._even = even(self.size)
        self._opening = opening_of(self._model, self.size, certain=self.certain)
        self.decoding = ListDecoding(self.scheme, edge=1.0, framed=framed, certain=self.certain)

    def observe(self, transition: Transition) -> Guess:
        """Cut the list by this step's gauges; the nearest candidate is the guess."""
        t = transition
        if self._opening is not None:
            return self._observe_outputs(self._opening, t)
        if t.start or t.gap:
            self.decoding.restart()
        self.decoding.session = t.session
        if t.x is None or t.candidates is None or t.x_next is None or t.cipher is None:
            self.decoding.step_missed(t.k, t.cipher)
            return Guess(t.k, self._even, 0.5)
        gauges = self._model.gauges(t.x, t.candidates, t.x_next, t.predictions)
        agreed = agreement_probability(self.decoding, gauges)
        self.decoding.step(t.k, gauges, t.cipher)
        return Guess(t.k, nearest(gauges), agreed)

    def _observe_outputs(self, opening: Opening, transition: Transition) -> Guess:
        """Decode what she knows by now, under every number of steps that the ends lost."""
        known, gauges = opening.take(transition)
        for one in known:
            decode_known(self.decoding, one, None if one.symbol is None else one.sure(self.size))
        if gauges is None:
            return Guess(transition.k, self._even, 0.5)
        return Guess(transition.k, nearest(gauges), 1.0 if self.decoding.testing() else 0.0)

    def belief(self) -> Belief:
        """The last message whose check held, else what the best decoding spells so far."""
        return belief_of(self.decoding, self._model)

    def message_symbols(self) -> MessageSymbols:
        """Those along the best hypothesis."""
        return self.decoding.message_symbols()


def decode_known(decoding: ListDecoding, one: Known, shares: Sequence[float] | None) -> None:
    """Count a transition of a plant that is read through outputs, as she knows it."""
    t = one.transition
    if t.start or t.gap:
        decoding.restart()
    elif one.again and not one.place:
        decoding.doubt()
    decoding.session = t.session
    if one.doubtful:
        decoding.step_doubtful(t.k, shares, t.cipher, one.loss)
    else:
        decoding.step_known(t.k, shares, t.cipher)


def agreement_probability(decoding: ListDecoding, gauges: list[float]) -> float:
    """Whether the best hypothesis, before this step, tests it and finds an agreement."""
    if not decoding.testing():
        return 0.0
    if decoding.certain:
        return 1.0
    lo, hi, edge_lo, edge_hi = decoding.thresholds()
    ordered = sorted(gauges)
    if ordered[0] >= hi or ordered[1] <= lo or ordered[-1] >= edge_hi:
        return 0.0
    certain = ordered[0] <= lo and ordered[1] >= hi and ordered[-1] <= edge_lo
    return 1.0 if certain else 0.5


def belief_of(decoding: ListDecoding, model: Measuring | None) -> Belief:
    """What a decoding gives as a belief."""
    whole = tuple(decoding.whole)
    return Belief(
        message=whole[-1] if whole else decoding.under_way(),
        whole=whole,
        whole_count=decoding.whole_count,
        confidence=1.0 if whole else decoding.confidence(),
        candidates_left=decoding.candidates(),
        solved_k=decoding.solved_k,
        A=() if model is None else model.A,
        B=() if model is None else model.B,
    )


class Collected:
    """The whole messages of one who decodes her past again and again, each once."""

    def __init__(self) -> None:
        self._whole: dict[tuple[str, int], bytes] = {}
        self._count = 0
        self.solved_k = -1

    def take(self, decoding: ListDecoding, k: int) -> None:
        """Take those of a decoding, up to step ``k``; the newest are kept."""
        for at, payload in decoding.whole_at:
            if at not in self._whole:
                self._whole[at] = payload
                self._count += 1
                if self.solved_k < 0:
                    self.solved_k = k
        while len(self._whole) > KEPT_MESSAGES:
            del self._whole[next(iter(self._whole))]

    def belief(self, decoding: ListDecoding, model: Measuring | None) -> Belief:
        """What a decoding gives, with the messages of those before it, which count as certain."""
        now, whole = belief_of(decoding, model), tuple(self._whole.values())
        return replace(
            now,
            message=whole[-1] if whole else now.message,
            whole=whole,
            whole_count=self._count,
            confidence=1.0 if whole else now.confidence,
            solved_k=self.solved_k,
        )
