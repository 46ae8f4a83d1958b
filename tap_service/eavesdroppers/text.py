"""`text`: reads the message itself, by all that a frame and a language say of unreliable symbols.

What was missed is inferred as exactly as the law allows (:mod:`tap_service.inference.front`), and
nothing is decided step by step: each step keeps its probabilities, and a search over whole messages
weighs them together with what is expected of a text
(:mod:`tap_service.inference.expectation`), the frame's length, the silence after it and its check
(:mod:`tap_service.inference.message_search`), under the thresholds that are likely
(:mod:`tap_service.inference.thresholds`). She says how sure she is, and how many bits are
left. She has to hear what came after before she can infer what was lost, so she reads all that she
keeps anew each time she has heard twice as much as before and when a message should be over; where
that cannot be told, when she has heard a quarter more, and half more where it is over. Where
outputs alone are read she infers nothing of what was missed, and weighs how many of a session's
first steps the ends lost.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, Final

from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Guess,
    MessageSymbols,
    Model,
    even,
    nearest,
)
from tap_service.inference.expectation import Expectation, expected
from tap_service.inference.from_outputs import inferred
from tap_service.inference.front import Inference
from tap_service.inference.inferred import Inferred
from tap_service.inference.kept import KEPT_MESSAGES, KEPT_SYMBOLS
from tap_service.inference.message_reader import SURE, Message, MessageReader
from tap_service.inference.message_search import BEAM
from tap_service.inference.output_model import OutputModel
from tap_service.inference.verdicts import verdicts_of

KEPT: Final = 4096
"""Transitions that she keeps; at this many she lets the older half go."""

FIRST: Final = 96
"""Transitions before she reads for the first time."""

GROWTH: Final = 2.0
"""She reads anew when she has heard this many times as much."""

SOON: Final = 8
"""Transitions after the end of a message at which she reads it."""

SETTLED: Final = 512
"""Transitions after the end of a message from which what she hears says nothing more of it."""


class Text(Eavesdropper):
    """Reads whole messages, and says what is left of them.

    Parameters
    ----------
    knowledge : Knowledge
    language : Expectation, optional
        What she expects of a message; by default :func:`~.expectation.expected`.
    live : bool
        Whether she reads as she listens, or when she is asked alone.
    beam : int
        Beginnings of a message that are followed at once.
    """

    name: ClassVar[str] = "text"
    heavy: ClassVar[bool] = True

    def __init__(
        self,
        knowledge: Knowledge,
        language: Expectation | None = None,
        *,
        live: bool = True,
        beam: int = BEAM,
    ) -> None:
        super().__init__(knowledge)
        self._model = Model.of(knowledge, self.name)
        self._even = even(self.size)
        self._inference = Inference(knowledge)
        self._reads = self._model if isinstance(self._model, OutputModel) else None
        self._sure = self.certain and self._reads is None  # else but for a session's first steps
        self._language, self._beam = language, beam
        self._live = live
        self._kept: list[Transition] = []
        self._inferred = Inferred([], (0.0, 1.0))
        self._thoughts: dict[tuple[str, int], Guess] = {}
        self._symbols: dict[tuple[str, int], int] = {}
        self._past: dict[tuple[str, int], Message] = {}
        self._after: dict[str, int] = {}
        self._open: list[Message] = []
        self._count = 0
        self._bits = 0.0  # left of the messages that she is done with
        self._solved_k = -1
        self._heard = self._decoded = 0
        self._next = FIRST

    @cached_property
    def _reader(self) -> MessageReader:
        """Made when she first reads: who only names her needs no model of a text."""
        return MessageReader(
            self.scheme, self._language or expected(), certain=self._sure, beam=self._beam
        )

    def observe(self, transition: Transition) -> Guess:
        """Take the nearest candidate where the step was heard; what was lost must wait."""
        t = transition
        self._kept.append(t)
        self._heard += 1
        if self._live and self._heard >= self._next:
            self.decode()
        if len(self._kept) >= KEPT:
            self._let_go(KEPT // 2)
        if t.x is None or t.candidates is None or t.x_next is None:
            return Guess(t.k, self._even, 0.5)
        gauges = None if self._reads else self._inference.gauges(t)
        if gauges is None:
            told = self._model
            measure = told.along_the_widest if self.knowledge.noisy else told.gauges
            gauges = measure(t.x, t.candidates, t.x_next, t.predictions)
        agreed = 1.0 if self.certain else (0.5 if max(gauges) <= 1.0 else 0.0)
        return Guess(t.k, nearest(gauges), agreed)

    def decode(self) -> None:
        """Infer and read all that is kept."""
        if self._decoded == self._heard:
            return
        self._decoded = self._heard
        more = min(int(self._heard * (GROWTH - 1)), KEPT // 2)
        self._next = self._heard + max(more, 1)
        if self._reads is None:
            self._inferred = self._inference.infer(self._kept)
        else:
            self._inferred = inferred(self._reads.anew(), self.size, self._kept)
        steps, among = self._inferred.steps, self._inferred.among
        self._open = []
        final_guesses = dict(self._after)
        messages = self._reader.read(steps, among, self._after)
        done = {m.session: m.k for m in messages if self._is_done(m)}
        for message in messages:
            if message.k <= done.get(message.session, -1):
                self._take(message)
            else:
                self._open.append(message)
                # of a message that is over, little more is said by what comes after
                due = self._heard // (2 if message.whole and not message.refuted else 4)
                if not message.whole and message.due_k >= 0:
                    due = min(self._heard // 2, message.due_k - self._kept[-1].k + SOON)
                self._next = min(self._next, self._heard + max(due, SOON))
        verdicts, _ = verdicts_of(steps, among, self.size, certain=self._sure)
        for step, row in zip(steps, verdicts.tolist(), strict=True):
            if step.transition.k > final_guesses.get(step.transition.session, -1):
                self._think(step.transition.session, step.transition.k, row)
        for stretch in self._reader.stretches:
            for k, row in zip(stretch.ks, stretch.verdicts.tolist(), strict=True):
                self._think(stretch.session, k, row)
            likeliest = stretch.symbols.argmax(axis=1)
            for k, symbol in zip(stretch.ks, likeliest.tolist(), strict=True):
                at = (stretch.session, k)
                self._symbols.pop(at, None)
                if symbol:
                    self._symbols[at] = symbol - 1

    def _think(self, session: str, k: int, verdict: Sequence[float]) -> None:
        """Note what she thinks of a step, given its verdict's probabilities."""
        agreed = sum(verdict[1:])
        share = [p / agreed for p in verdict[1:]] if agreed > 0 else self._even
        self._thoughts[session, k] = Guess(k, tuple(share), min(agreed, 1.0), session)

    def _is_done(self, message: Message) -> bool:
        """Whether a message need not be read again: she is sure of it, or will hear no more."""
        if not message.whole:
            return False
        newest = self._kept[-1]
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
                self._solved_k = self._kept[-1].k
        while len(self._past) > KEPT_MESSAGES:
            del self._past[next(iter(self._past))]

    def _let_go(self, count: int) -> None:
        """Her last thoughts on the oldest."""
        self.decode()
        for t in self._kept[:count]:
            guess = self._thoughts.pop((t.session, t.k), None)
            self.final_guesses.append(guess or Guess(t.k, self._even, 0.5, t.session))
        self._kept = self._kept[count:]
        sessions = {t.session for t in self._kept}
        self._after = {name: k for name, k in self._after.items() if name in sessions}
        while len(self._symbols) > KEPT_SYMBOLS:
            del self._symbols[next(iter(self._symbols))]

    def review(self) -> Sequence[Guess]:
        """What she takes each step for, with what came after it and the messages carried."""
        self.decode()
        return [self._thoughts[t.session, t.k] for t in self._kept]

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
            A=self._model.A,
            B=self._model.B,
            bits_left=self._bits + sum(m.bits_left for m in self._open) if newest else None,
            given=newest[0].kind if newest else "",
        )

    def message_symbols(self) -> MessageSymbols:
        """The likeliest, of the newest session."""
        session = self._kept[-1].session if self._kept else ""
        symbols = sorted((k, s) for (at, k), s in self._symbols.items() if at == session)
        return symbols[-KEPT_SYMBOLS:]
