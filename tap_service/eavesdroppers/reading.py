"""What the eavesdroppers have in common that read whole messages of what they keep.

Eve keeps transitions, infers what each step may have been, and reads all of it anew as it grows:
where every step is known but for the thresholds, by every decoding that these leave possible
(:mod:`tap_service.inference.list_decoding`), elsewhere by a search over whole messages
(:mod:`tap_service.inference.message_reader`). Eavesdroppers differ in how they infer. Where outputs
alone are read it is how many of a session's first steps the two ends lost that is not known.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, Final

import numpy as np

from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    KEPT_MESSAGES,
    KEPT_SYMBOLS,
    Belief,
    Eavesdropper,
    Guess,
    MessageSymbols,
    Model,
    even,
    nearest,
)
from tap_service.inference.expectation import expected
from tap_service.inference.list_decoding import ListDecoding
from tap_service.inference.message_reader import SURE, Message, MessageReader, Stretch
from tap_service.inference.message_search import BEAM
from tap_service.inference.opening import inferred
from tap_service.inference.output_model import OutputModel
from tap_service.inference.verdicts import Inferred, InferredStep, Interval, verdicts_of

KEPT: Final = 4096
"""Transitions that are kept; at this many the older half goes."""

SOON: Final = 8
"""Transitions after the end of a message at which it is read."""

SETTLED: Final = 512
"""Transitions after the end of a message from which what is heard says nothing more of it."""


class Reading(Eavesdropper):
    """Keeps what she heard, infers it and reads it again and again.

    Parameters
    ----------
    knowledge : Knowledge
    live : bool
        Whether she reads as she listens, or when she is asked alone.
    beam : int
        Beginnings of a message that are followed at once.
    """

    heavy: ClassVar[bool] = True
    searches: ClassVar[bool] = False
    """Whether she searches messages where a step is not known."""

    follows: ClassVar[bool] = False
    """Whether :meth:`gauges` stay as they are, so that the best decoding can be followed on."""

    first: ClassVar[int] = 24
    """Transitions before she reads for the first time."""

    growth: ClassVar[float] = 1.25
    """She reads anew when she has heard this many times as much."""

    among: ClassVar[Interval] = (0.0, 1.0)
    """t_c from and to, in units of the gauges, where :meth:`infer` is not another."""

    edges: ClassVar[Interval] = (1.0, 1.0)
    """The same of t_e."""

    def __init__(
        self,
        knowledge: Knowledge,
        *,
        live: bool = True,
        beam: int = BEAM,
    ) -> None:
        super().__init__(knowledge)
        self.even = even(self.size)
        self.model: Model | OutputModel | None = None
        """The newest."""
        self._beam, self._live = beam, live
        # where outputs are read every step agrees but for a session's first
        self._sure = self.certain and knowledge.C is None
        self.kept: list[Transition] = []
        self._inferred = Inferred([], (0.0, 1.0))
        self._thoughts: dict[tuple[str, int], Guess] = {}
        self._symbols: dict[tuple[str, int], int] = {}
        self._past: dict[tuple[str, int], Message] = {}
        self._after: dict[str, int] = {}
        self._open: list[Message] = []
        self._listed = False
        self._count = 0
        self._bits = 0.0  # left of the messages that she is done with
        self._solved_k = -1
        self._heard = self._decoded = 0
        self._next = self.first

    # --- how she infers ---------------------------------------------------------------------------

    def infer(self) -> Inferred:
        """What each step of :attr:`kept` may have been: as it was heard, if it was heard whole."""
        return Inferred([_as_heard(t, self.gauges(t)) for t in self.kept], self.among)

    def output_model(self) -> OutputModel | None:
        """Her model of what is kept, where outputs are read; None where that is too little."""
        return self.model if isinstance(self.model, OutputModel) else None

    def gauges(self, transition: Transition) -> list[float] | None:
        """How far each candidate of a step is from what was heard; None where that is not known."""
        t, model = transition, self.model
        if t.x is None or t.candidates is None or t.x_next is None or model is None:
            return None
        return model.gauges(t.x, t.candidates, t.x_next, t.predictions)

    # --- reading ----------------------------------------------------------------------------------

    @cached_property
    def _reader(self) -> MessageReader:
        """Made when she first searches: it takes a model of a text."""
        return MessageReader(self.scheme, expected(), certain=self._sure, beam=self._beam)

    @cached_property
    def _lists(self) -> ListDecoding:
        """Asks what a text is like where several are possible alone."""
        return ListDecoding(self.scheme, expected, certain=self.certain)

    def observe(self, transition: Transition) -> Guess:
        """Take the nearest candidate where the step was heard; what was lost must wait."""
        t, model = transition, self.model
        self.kept.append(t)
        self._heard += 1
        gauges = model.observe(t) if isinstance(model, OutputModel) else self.gauges(t)
        followed = self._live and self._listed and self.follows
        if followed and self._lists.ends(_as_heard(t, gauges)):
            self._next = self._heard
        if self._live and self._heard >= self._next:
            self.decode()
        if len(self.kept) >= KEPT:
            self._let_go(KEPT // 2)
        if gauges is None:
            return Guess(t.k, self.even, 0.5)
        agreed = 1.0 if self.certain else (0.5 if max(gauges) <= 1.0 else 0.0)
        if isinstance(model, OutputModel):
            agreed = float(model.settled)
        return Guess(t.k, nearest(gauges), agreed)

    def decode(self) -> None:
        """Infer and read all that is kept."""
        if self._decoded == self._heard:
            return
        self._decoded = self._heard
        more = min(int(self._heard * (self.growth - 1)), KEPT // 2)
        self._next = self._heard + max(more, 1)
        found = self.infer() if self.knowledge.C is None else self._from_outputs()
        if found is None:
            return
        self._inferred = found
        messages, stretches = self._read(found)
        done = {m.session: m.k for m in messages if self._is_done(m)}
        self._open = []
        for message in messages:
            if message.k <= done.get(message.session, -1):
                self._take(message)
            else:
                self._open.append(message)
                self._next = min(self._next, self._heard + self._due(message))
        for stretch in stretches:
            self._think_of(stretch)

    def _from_outputs(self) -> Inferred | None:
        """What the newest model of outputs, made of all that is kept, makes of it."""
        model = self.output_model()
        if model is None:
            return None
        self.model = model = model.anew()
        return inferred(model, self.size, self.kept)

    def _read(self, found: Inferred) -> tuple[list[Message], list[Stretch]]:
        """The messages in what was inferred, and what is thought of the steps."""
        steps, after = found.steps, dict(self._after)
        exact = all(s.samples is None or len(s.samples) == 1 for s in steps)
        whole = all(s.samples is not None and s.transition.cipher is not None for s in steps)
        self._listed = exact and (whole or not self.searches) and self.knowledge.C is None
        if self._listed:
            return self._lists.read(found, after, self.edges), self._lists.stretches
        if all(s.transition.cipher is None for s in steps):
            messages = []  # the message is safe from her
        else:
            messages = self._reader.read(steps, found.among, after)
        verdicts, _ = verdicts_of(steps, found.among, self.size, certain=self._sure)
        at = [(s.transition.session, s.transition.k) for s in steps]
        open_ = [i for i, (session, k) in enumerate(at) if k > after.get(session, -1)]
        alone = Stretch([at[i] for i in open_], verdicts[open_], None)
        return messages, [alone, *self._reader.stretches]

    def _due(self, message: Message) -> int:
        """Transitions until a message that is not done is read again."""
        if not message.whole and message.due_k >= 0:
            return max(min(self._heard // 2, message.due_k - self.kept[-1].k + SOON), SOON)
        # of a message that is over, little more is said by what comes after
        return max(self._heard // (2 if message.whole and not message.refuted else 4), SOON)

    def _think_of(self, stretch: Stretch) -> None:
        """Note what she thinks of steps, given their verdicts' probabilities, and their symbols."""
        for (session, k), verdict in zip(stretch.at, stretch.verdicts.tolist(), strict=True):
            agreed = sum(verdict[1:])
            share = [p / agreed for p in verdict[1:]] if agreed > 0 else self.even
            self._thoughts[session, k] = Guess(k, tuple(share), min(agreed, 1.0), session)
        if stretch.symbols is None:
            return
        for at, symbol in zip(stretch.at, stretch.symbols.argmax(axis=1).tolist(), strict=True):
            self._symbols.pop(at, None)
            if symbol:
                self._symbols[at] = symbol - 1

    def _is_done(self, message: Message) -> bool:
        """Whether a message need not be read again: she is sure of it, or will hear no more."""
        if not message.whole:
            return False
        newest = self.kept[-1]
        over = newest.session != message.session or newest.k - message.k > SETTLED
        return over or message.probability >= SURE

    def _take(self, message: Message) -> None:
        """Be done with a message; one that she is sure of counts as read."""
        self._past[message.session, message.k] = message
        self._after[message.session] = message.k
        self._bits += message.bits_left
        if message.whole and message.probability >= SURE:
            self._count += 1
            if self._solved_k < 0:
                self._solved_k = self.kept[-1].k
        while len(self._past) > KEPT_MESSAGES:
            del self._past[next(iter(self._past))]

    def _let_go(self, count: int) -> None:
        """Her last thoughts on the oldest."""
        self.decode()
        for t in self.kept[:count]:
            guess = self._thoughts.pop((t.session, t.k), None)
            self.final_guesses.append(guess or Guess(t.k, self.even, 0.5, t.session))
        if self._listed:
            self._lists.let_go(self._inferred.steps[:count])
        else:
            self._lists.forget()
        self.kept = self.kept[count:]
        sessions = {t.session for t in self.kept}
        self._after = {name: k for name, k in self._after.items() if name in sessions}
        while len(self._symbols) > KEPT_SYMBOLS:
            del self._symbols[next(iter(self._symbols))]

    @property
    def decodings(self) -> int:
        """Decodings of all thresholds that differed, at most so far."""
        return self._lists.peak

    # --- what she says ----------------------------------------------------------------------------

    def review(self) -> Sequence[Guess]:
        """What she takes each step for, with what came after it and the messages carried."""
        self.decode()
        blank = [Guess(t.k, self.even, 0.5, t.session) for t in self.kept]
        return [self._thoughts.get((g.session, g.k), g) for g in blank]

    def belief(self) -> Belief:
        """The newest message, how sure she is of it, and what is left of all."""
        read = tuple(m.payload for m in self._past.values() if m.probability >= SURE)
        newest = (*self._past.values(), *self._open)[-1:]
        return Belief(
            message=newest[0].payload if newest else b"",
            whole=read,
            whole_count=self._count,
            confidence=newest[0].probability if newest else 0.0,
            candidates_left=newest[0].rivals if newest else 0,
            solved_k=self._solved_k,
            A=() if self.model is None else self.model.A,
            B=() if self.model is None else self.model.B,
            bits_left=self._bits + sum(m.bits_left for m in self._open) if newest else None,
            given=newest[0].kind if newest else "",
        )

    def message_symbols(self) -> MessageSymbols:
        """The likeliest, of the newest session."""
        session = self.kept[-1].session if self.kept else ""
        symbols = sorted((k, s) for (at, k), s in self._symbols.items() if at == session)
        return symbols[-KEPT_SYMBOLS:]


def _as_heard(t: Transition, gauges: list[float] | None) -> InferredStep:
    return InferredStep(t, None if gauges is None else np.array([gauges]))
