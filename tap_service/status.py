"""From what an eavesdropper says to what is published, logged and kept of it."""

import base64
import logging
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from math import isfinite
from operator import index
from types import MappingProxyType
from typing import Any, Final, Self

from pydantic_core import to_json

from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage, TapStatus
from protocol.text import printable, readable
from runtime.errors import GuestError
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Belief, Eavesdropper, Guess, KeysHeld, KnowledgeError

TAIL: Final = 32
"""Transitions that a status shows."""

SHOWN_TEXT: Final = 2000
"""Characters of a message that a status shows."""

SHOWN_EXPECTATION: Final = 40
"""Characters of what she expects of a message that are shown."""

LARGEST_CONFIDENCE: Final = 1.0 + 1e-9
"""A probability at most; a sum of shares may exceed 1 by a rounding."""

UNUSED: Final = ("foreign", "late", "jumped", "dropped", "malformed", "restarts")
"""What a status counts of all that the tap heard and could not use."""

ROUNDING: Final = 1e-6
"""By which the probabilities of a guess may miss a sum of 1."""


class Listener:
    """An eavesdropper with the last of her guesses and the count of her steps.

    She may be the user's: whatever she raises, or answers that is no answer, stops her and nobody
    else, and is told in ``failed``.

    Parameters
    ----------
    tap : Eavesdropper
    name : str
    size : int
        M.
    log : logging.Logger, optional
        Told when she fails.
    """

    def __init__(
        self, tap: Eavesdropper, name: str, size: int, log: logging.Logger | None = None
    ) -> None:
        self.tap = tap
        self.name = name
        self.steps = 0
        self.holes = 0
        self.failed = ""
        self.log = log
        self.tail: deque[Guess] = deque(maxlen=TAIL)
        self._size = size
        self._believed = Belief()

    @classmethod
    def of(
        cls, kind: type[Eavesdropper], knowledge: Knowledge, log: logging.Logger | None = None
    ) -> Self:
        """Make one of a kind.

        Raises
        ------
        KnowledgeError
            When she cannot be made: she lacks knowledge, or her constructor raises.
        """
        try:
            return cls(kind(knowledge), kind.name, knowledge.candidates, log)
        except KnowledgeError:
            raise
        except Exception as error:
            raise KnowledgeError(f"{kind.name}: cannot be made: {_in_short(error)}") from None

    def observe(self, transition: Transition) -> Guess | None:
        """Feed her one transition; None once she has failed, and from one who does not guess."""
        if self.failed:
            return None
        try:
            guess = sound_guess(self.tap.observe(transition), self._size)
        except Exception as error:
            self._fail(f"step {transition.k}", error)
            return None
        self.steps += 1
        self.holes += not transition.whole
        if not self.tap.guesses:
            return None
        self.tail.append(guess)
        return guess

    def hear(self, message: FieldMessage) -> None:
        """Hand her a message, if she is one to hear them."""
        if self.failed or not self.tap.hears_messages:
            return
        try:
            self.tap.hear(message)
        except Exception as error:
            self._fail("a message", error)

    def final_guesses(self) -> Sequence[Guess]:
        """Take off her last thoughts on the transitions that she has let go."""
        found = getattr(self.tap, "final_guesses", None)
        if not found or self.failed:
            return ()
        try:
            guesses = [sound_guess(g, self._size) for g in found]
            found.clear()
        except Exception as error:
            self._fail("final_guesses", error)
            return ()
        return guesses

    def review(self) -> Sequence[Guess]:
        """Her second thoughts on the transitions that she keeps."""
        if self.failed:
            return ()
        try:
            return [sound_guess(g, self._size) for g in self.tap.review()]
        except Exception as error:
            self._fail("review", error)
            return ()

    def belief(self) -> Belief:
        """What she believes by now; once she has failed, what she believed last."""
        if not self.failed:
            try:
                self._believed = sound_belief(self.tap.belief())
            except Exception as error:
                self._fail("belief", error)
        return self._believed

    def message_symbols(self) -> list[tuple[int, int]] | None:
        """What she takes for the message, in plain numbers; None once she has failed."""
        if not self.failed:
            try:
                return sound_symbols(self.tap.message_symbols())
            except Exception as error:
                self._fail("message_symbols", error)
        return None

    def _fail(self, where: str, error: Exception) -> None:
        self.failed = f"{where}: {_in_short(error)}"
        if self.log is not None:
            self.log.error("eavesdropper %s failed at %s", self.name, self.failed)


def _in_short(error: Exception) -> str:
    """An error on one line."""
    if isinstance(error, GuestError):
        return str(error)
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


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


def status_of(listener: Listener, belief: Belief, counts: Mapping[str, int]) -> TapStatus:
    """The status of one eavesdropper; ``counts`` holds the service's own figures."""
    tail = list(listener.tail)
    return TapStatus(
        name=listener.name,
        steps=listener.steps,
        lost=listener.holes,
        message=readable(belief.message)[:SHOWN_TEXT],
        confidence=belief.confidence,
        candidates_left=belief.candidates_left,
        solved_k=belief.solved_k,
        bits_left=belief.bits_left,
        given=belief.given,
        failed=printable(listener.failed)[:SHOWN_TEXT],
        A=belief.A,
        B=belief.B,
        **_of_keys(belief.keys),
        tail_k=tuple(g.k for g in tail),
        tail_symbol=tuple(g.best for g in tail),
        tail_probability=tuple(max(g.symbol) for g in tail),
        tail_agreed=tuple(g.agreed for g in tail),
        **counts,
    )


def _of_keys(keys: KeysHeld | None) -> dict[str, Any]:
    """The status's fields of keys, of one who attacks them."""
    if keys is None:
        return {}
    return {
        "key_blocks": keys.blocks,
        "key_bits_held": keys.bits,
        "copies": keys.copies,
        "copies_missed": keys.missed,
        "missed_at_most": keys.at_most,
        "missed_direction": keys.direction,
        "copies_absent": keys.absent,
        "key_steps_unplaced": keys.unplaced,
        "claim_refuted": keys.refuted,
        "misses_in_bursts": keys.bursts,
    }


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


def belief_record(
    session: str,
    listener: Listener,
    belief: Belief,
    *,
    last: bool,
    behind: int = 0,
    counts: Mapping[str, int] = MappingProxyType({}),
) -> dict[str, Any]:
    """One belief as it is written to ``beliefs.json``; payloads as base64.

    She is asked for the message symbols at the ``last`` alone; before they are None, and so they
    are of one who failed. ``behind`` counts the steps captured that she has not looked at, and
    ``counts`` has what the tap could not use of what it heard (:data:`UNUSED`).
    """
    symbols = listener.message_symbols() if last else None
    return _record(session, listener.name, listener.steps, belief) | {
        "unused": unused_of(counts),
        "failed": listener.failed,
        "behind": behind,
        "symbols": symbols,
    }


def unused_of(counts: Mapping[str, int]) -> dict[str, int]:
    """What the tap could not use, by name; 0 where it is not counted."""
    return {name: counts.get(name, 0) for name in UNUSED}


def _record(session: str, name: str, steps: int, belief: Belief) -> dict[str, Any]:
    return {
        "name": name,
        "session": session,
        "steps": steps,
        "failed": "",
        "behind": 0,
        "unused": unused_of({}),
        "message": base64.b64encode(belief.message).decode("ascii"),
        "whole": [base64.b64encode(w).decode("ascii") for w in belief.whole],
        "whole_count": belief.whole_count,
        "confidence": belief.confidence,
        "candidates_left": belief.candidates_left,
        "solved_k": belief.solved_k,
        "bits_left": belief.bits_left,
        "given": belief.given,
        "symbols": None,
        "A": belief.A,
        "B": belief.B,
        "keys": None if belief.keys is None else belief.keys.model_dump(),
    }


def absent_status(name: str) -> TapStatus:
    """The status of one who has not said anything yet."""
    return TapStatus(
        **dict.fromkeys(("seq", "t_ns", "steps", "lost", "mirrored", "dropped", "behind"), 0),
        name=name,
        malformed=0,
        message="",
        confidence=0.0,
        candidates_left=0,
        solved_k=-1,
    )


def absent_record(name: str) -> dict[str, Any]:
    """Her record."""
    return _record("", name, 0, Belief())


def beliefs_json(records: Mapping[str, dict[str, Any]]) -> bytes:
    """The content of ``beliefs.json``: one record an eavesdropper, by name."""
    return to_json(dict(records), inf_nan_mode="strings") + b"\n"
