"""From what an eavesdropper says to what is published, logged and kept of it."""

import base64
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from pydantic_core import to_json

from protocol.messages import TapStatus
from tap_service.eavesdroppers.interface import Belief, Eavesdropper, Guess
from tap_service.transcript import Transition

TAIL: Final = 32
"""Transitions that a status shows."""

SHOWN_TEXT: Final = 2000
"""Characters of a message that a status shows."""


@dataclass(slots=True)
class Listener:
    """An eavesdropper with the last of her guesses and the count of her steps."""

    tap: Eavesdropper
    name: str
    steps: int = 0
    holes: int = 0
    failed: str = ""
    tail: deque[Guess] = field(default_factory=lambda: deque(maxlen=TAIL))

    def observe(self, transition: Transition) -> Guess | None:
        """Feed her one transition; None once she has failed, which stops her and nobody else."""
        if self.failed:
            return None
        try:
            guess = self.tap.observe(transition)
        except Exception as error:  # she may be the user's: one eavesdropper never stops the tap
            self.failed = f"step {transition.k}: {type(error).__name__}: {error}"
            return None
        self.steps += 1
        self.holes += not transition.whole
        self.tail.append(guess)
        return guess

    def review(self) -> Sequence[Guess]:
        """Her second thoughts."""
        if self.failed:
            return ()
        try:
            return self.tap.review()
        except Exception as error:
            self.failed = f"review: {type(error).__name__}: {error}"
            return ()

    def belief(self) -> Belief:
        """What she believes by now."""
        if self.failed:
            return Belief()
        try:
            return self.tap.belief()
        except Exception as error:
            self.failed = f"belief: {type(error).__name__}: {error}"
            return Belief()


def printable(message: bytes) -> str:
    """A message as text on one line; what cannot be shown becomes a middle dot."""
    text = message.decode("utf-8", errors="replace")
    return "".join(c if c.isprintable() and c != "\ufffd" else "·" for c in text)[:SHOWN_TEXT]


def status_of(listener: Listener, belief: Belief, counts: Mapping[str, int]) -> TapStatus:
    """The status of one eavesdropper; ``counts`` holds the service's own figures."""
    tail = list(listener.tail)
    return TapStatus(
        name=listener.name,
        steps=listener.steps,
        lost=listener.holes,
        message=f"stopped: {listener.failed}" if listener.failed else printable(belief.message),
        whole_messages=belief.whole_count,
        confidence=belief.confidence,
        candidates_left=belief.candidates_left,
        solved_k=belief.solved_k,
        A=belief.A,
        B=belief.B,
        tail_k=tuple(g.k for g in tail),
        tail_symbol=tuple(g.best for g in tail),
        tail_probability=tuple(max(g.symbol) for g in tail),
        tail_agreed=tuple(g.agreed for g in tail),
        **counts,
    )


def guess_line(session: str, name: str, guess: Guess, event: str = "guess") -> bytes:
    """The log line of one guess: step, likeliest symbol and its probability, agreement's."""
    p = max(guess.symbol)
    text = (
        f'{{"event":"{event}","name":"{name}","session":"{session}","k":{guess.k},'
        f'"symbol":{guess.symbol.index(p)},"p":{p:.6g},"agreed":{guess.agreed:.6g}}}'
    )
    return text.encode()


def belief_record(name: str, session: str, listener: Listener, belief: Belief) -> dict[str, Any]:
    """One belief as it is written to ``beliefs.json``; payloads as base64."""
    return {
        "name": name,
        "session": session,
        "steps": listener.steps,
        "failed": listener.failed,
        "message": base64.b64encode(belief.message).decode("ascii"),
        "whole": [base64.b64encode(w).decode("ascii") for w in belief.whole],
        "whole_count": belief.whole_count,
        "confidence": belief.confidence,
        "candidates_left": belief.candidates_left,
        "solved_k": belief.solved_k,
        "symbols": belief.symbols,
        "A": belief.A,
        "B": belief.B,
    }


def beliefs_json(records: Mapping[str, dict[str, Any]]) -> bytes:
    """The content of ``beliefs.json``: one record an eavesdropper, by name."""
    return to_json(dict(records), inf_nan_mode="strings") + b"\n"
