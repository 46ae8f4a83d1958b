"""Feeding eavesdroppers: in the mirror's process, beside it, or afterwards.

Whatever one of them raises, or answers that is no answer, stops her alone.
"""

import logging
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from math import isfinite
from operator import index
from typing import Final, TypeVar

from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage
from protocol.messages.adversary import KeysHeld
from protocol.text import printable
from runtime.child import kill_after
from tap_service.capture.transcript import Transcript, Transition
from tap_service.eavesdroppers import named
from tap_service.eavesdroppers.base import Belief, Eavesdropper, Guess, KnowledgeError

T = TypeVar("T")
U = TypeVar("U")

TAIL: Final = 32
"""Transitions that a status shows."""

SHOWN_EXPECTATION: Final = 40
"""Characters of what she expects of a message that are shown."""

LARGEST_CONFIDENCE: Final = 1.0 + 1e-9
"""A probability at most; a sum of shares may exceed 1 by a rounding."""

ROUNDING: Final = 1e-6
"""By which the probabilities of a guess may miss a sum of 1."""


class Listener:
    """An eavesdropper with the last of her guesses and the count of her steps.

    She may be the user's: whatever she raises, or answers that is no answer, stops her and nobody
    else, and is told in ``failed``.

    Parameters
    ----------
    kind : type of Eavesdropper
    knowledge : Knowledge
        What she is told.
    log : logging.Logger, optional
        Told when she fails.
    answer_s : float
        Seconds for an answer, after which this process ends; 0: any time.

    Raises
    ------
    KnowledgeError
        When she cannot be made: she lacks knowledge, or her constructor raises.
    """

    def __init__(
        self,
        kind: type[Eavesdropper],
        knowledge: Knowledge,
        log: logging.Logger | None = None,
        *,
        answer_s: float = 0.0,
    ) -> None:
        try:
            self.tap = kind(knowledge)
        except KnowledgeError:
            raise
        except Exception as error:
            raise KnowledgeError(f"{kind.name}: cannot be made: {_in_short(error)}") from None
        self.name = kind.name
        self.log = log
        self.steps = 0
        self.holes = 0
        self.failed = ""
        self.tail: deque[Guess] = deque(maxlen=TAIL)
        self._size = knowledge.candidates
        self._answer_s = answer_s
        self._believed = Belief()

    def observe(self, transition: Transition) -> Guess | None:
        """Feed her one transition; None once she has failed, and from one who does not guess."""
        guess = self._ask(
            f"step {transition.k}",
            lambda: sound_guess(self.tap.observe(transition), self._size),
            None,
        )
        if guess is None:
            return None
        self.steps += 1
        self.holes += not transition.whole
        if not self.tap.guesses:
            return None
        self.tail.append(guess)
        return guess

    def hear(self, message: FieldMessage) -> None:
        """Hand her a message, if she is one to hear them."""
        if self.tap.hears_messages:
            self._ask("a message", lambda: self.tap.hear(message), None)

    def final_guesses(self) -> Sequence[Guess]:
        """Take off her last thoughts on the transitions that she has let go."""
        found = getattr(self.tap, "final_guesses", None)
        if not found:
            return ()
        guesses = self._ask("final_guesses", lambda: self._sound(found), ())
        found.clear()
        return guesses

    def review(self) -> Sequence[Guess]:
        """Her second thoughts on the transitions that she keeps."""
        return self._ask("review", lambda: self._sound(self.tap.review()), ())

    def _sound(self, guesses: Iterable[object]) -> Sequence[Guess]:
        return [sound_guess(guess, self._size) for guess in guesses]

    def belief(self) -> Belief:
        """What she believes by now; once she has failed, what she believed last."""
        self._believed = self._ask(
            "belief", lambda: sound_belief(self.tap.belief()), self._believed
        )
        return self._believed

    def message_symbols(self) -> list[tuple[int, int]] | None:
        """What she takes for the message, in plain numbers; None once she has failed."""
        return self._ask("message_symbols", lambda: sound_symbols(self.tap.message_symbols()), None)

    def _ask(self, what: str, question: Callable[[], T], otherwise: U) -> T | U:
        """Her answer to a question; ``otherwise`` once she has failed."""
        if self.failed:
            return otherwise
        if self._answer_s:
            kill_after(self._answer_s)
        try:
            return question()
        except Exception as error:
            self.failed = f"{what}: {_in_short(error)}"
            if self.log is not None:
                self.log.error("eavesdropper %s failed at %s", self.name, self.failed)
            return otherwise
        finally:
            if self._answer_s:
                kill_after(0.0)


def _in_short(error: Exception) -> str:
    """An error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


class Listeners:
    """Several eavesdroppers on one transcript, in the mirror's process or beside it.

    Parameters
    ----------
    told : mapping
        What each eavesdropper is told, by name or ``FILE.py:NAME``.
    write : callable
        Takes the lines of their guesses.
    log : logging.Logger, optional
        Told when one fails.
    answer_s : float
        As for :class:`Listener`.

    Raises
    ------
    KnowledgeError
        When one cannot be found or is not told enough.
    """

    def __init__(
        self,
        told: Mapping[str, Knowledge],
        write: Callable[[bytes], None],
        log: logging.Logger | None = None,
        *,
        answer_s: float = 0.0,
    ) -> None:
        self.listeners = tuple(
            Listener(named(name), knowledge, log, answer_s=answer_s)
            for name, knowledge in told.items()
        )
        self.transcript = Transcript()
        self.session = ""
        self._write = write

    def hear(self, message: FieldMessage) -> None:
        """Hand a message to those that hear them, then each transition that it settles to all."""
        for listener in self.listeners:
            listener.hear(message)
        self._feed(self.transcript.hear(message))

    def finish(self) -> None:
        """Nothing more comes: settle what is left, and take their second thoughts."""
        self._feed(self.transcript.flush())
        for listener in self.listeners:
            self._note(listener, listener.review())

    def _feed(self, transitions: Iterable[Transition]) -> None:
        for transition in transitions:
            self.session = transition.session
            for listener in self.listeners:
                guess = listener.observe(transition)
                if guess is not None:
                    session, whole = transition.session, transition.whole
                    self._write(guess_line(session, listener.name, guess, whole=whole))
                self._note(listener, listener.final_guesses())

    def _note(self, listener: Listener, thoughts: Iterable[Guess]) -> None:
        for guess in thoughts:
            self._write(guess_line(self.session, listener.name, guess, "review"))


def guess_line(
    session: str, name: str, guess: Guess, event: str = "guess", *, whole: bool = True
) -> bytes:
    """The log line of one guess: step, likeliest symbol and its probability, agreement's.

    ``session`` is the newest, for a guess that names none. Where the tap lacked a message of the
    step, it was not ``whole``, and the line says so.
    """
    p = max(guess.symbol)
    hole = "" if whole else ',"hole":true'
    text = (
        f'{{"event":"{event}","name":"{name}","session":"{guess.session or session}","k":{guess.k},'
        f'"symbol":{guess.symbol.index(p)},"p":{p:.6g},"agreed":{guess.agreed:.6g}{hole}}}'
    )
    return text.encode()


def sound_guess(guess: object, size: int) -> Guess:
    """The guess, in plain numbers.

    Raises
    ------
    TypeError, ValueError
        When it is none, or not of M probabilities.
    """
    if not isinstance(guess, Guess):
        raise TypeError(f"expected a Guess, got {guess!r}")
    symbol = tuple(map(float, guess.symbol))
    agreed = float(guess.agreed)
    shares = len(symbol) == size and min(symbol) >= 0.0 and abs(sum(symbol) - 1.0) <= ROUNDING
    if not (shares and 0.0 <= agreed <= LARGEST_CONFIDENCE):
        raise ValueError(
            f"expected {size} probabilities that sum to 1, and that of an agreement, got {guess}"
        )
    return Guess(index(guess.k), symbol, agreed, str(guess.session))


def sound_belief(belief: object) -> Belief:
    """The belief, in plain numbers.

    Raises
    ------
    TypeError, ValueError
        When it is none, or a part of it is not what it should be.
    """
    if not isinstance(belief, Belief):
        raise TypeError(f"expected a Belief, got {belief!r}")
    for payload in (belief.message, *belief.whole):
        if not isinstance(payload, bytes):
            raise TypeError(f"expected messages as bytes, got {payload!r}")
    confidence = float(belief.confidence)
    if not 0.0 <= confidence <= LARGEST_CONFIDENCE:
        raise ValueError(f"expected a confidence from 0 to 1, got {confidence}")
    left = None if belief.bits_left is None else float(belief.bits_left)
    if left is not None and not (isfinite(left) and left >= 0.0):
        raise ValueError(f"expected bits left of 0 or more, got {left}")
    A = tuple(tuple(map(float, row)) for row in belief.A)
    B = tuple(tuple(map(float, row)) for row in belief.B)
    if not all(map(isfinite, chain.from_iterable((*A, *B)))):
        raise ValueError(f"expected a finite model, got A {A}, B {B}")
    if not isinstance(belief.keys, KeysHeld | None):
        raise TypeError(f"expected KeysHeld, got {belief.keys!r}")
    return Belief(
        message=belief.message,
        whole=tuple(belief.whole),
        whole_count=max(index(belief.whole_count), len(belief.whole)),
        confidence=confidence,
        candidates_left=max(index(belief.candidates_left), 0),
        solved_k=max(index(belief.solved_k), -1),
        A=A,
        B=B,
        bits_left=left,
        given=printable(str(belief.given))[:SHOWN_EXPECTATION],
        keys=belief.keys,
    )


def sound_symbols(symbols: object) -> list[tuple[int, int]]:
    """Steps and message symbols, in plain numbers.

    Raises
    ------
    TypeError, ValueError
        When they are no pairs of whole numbers.
    """
    if not isinstance(symbols, Iterable):
        raise TypeError(f"expected steps and symbols, got {symbols!r}")
    try:
        return [(index(k), index(symbol)) for k, symbol in symbols]
    except ValueError:
        raise ValueError("expected pairs of step and symbol") from None
