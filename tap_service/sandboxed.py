"""A user's eavesdropper in a bounded process of its own (:class:`runtime.child.Guest`).

It stops itself alone: whatever it does is told by a line in its status, and the tap goes on.
"""

import base64
import sys
import weakref
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage
from runtime.child import START_S, Guest, serve
from runtime.errors import GuestError
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import LADDER, Belief, Eavesdropper, Guess, KnowledgeError, named
from tap_service.eavesdroppers.base import KeysHeld, MessageSymbols
from tap_service.status import sound_symbols

LIGHT_S: Final = 2.0
"""Seconds that a light one has for an answer: the mirror waits for her."""

HEAVY_S: Final = 15.0
"""Seconds that a heavy one has for an answer."""

LACKS: Final = "lacks"
TOLD: Final = ("name", "heavy", "told_model", "hears_messages", "guesses", "reads_outputs")


class SandboxedEavesdropper(Eavesdropper):
    """A user's eavesdropper as the tap sees it: every question goes to its own process."""

    source = ""

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._within_s = HEAVY_S if self.heavy else LIGHT_S
        self._guest = Guest(__name__, (self.source,))
        weakref.finalize(self, self._guest.end)
        try:
            self._guest.ask("make", knowledge.model_dump_json(), START_S)
        except GuestError as error:
            self._guest.end()
            if error.kind == LACKS:
                raise KnowledgeError(str(error)) from None
            raise

    def _ask(self, what: str, argument: object = None) -> Any:
        return self._guest.ask(what, argument, self._within_s)

    def observe(self, transition: Transition) -> Guess:
        """Her guess of it; her last thoughts on what she lets go come with it."""
        guess, final_guesses = self._ask("observe", transition)
        self.final_guesses += map(_guess, final_guesses)
        return _guess(guess)

    def hear(self, message: FieldMessage) -> None:
        """Hand her a message."""
        self._ask("hear", message)

    def belief(self) -> Belief:
        """Her best message by now."""
        told = self._ask("belief")
        told["message"] = base64.b64decode(told["message"])
        told["whole"] = tuple(map(base64.b64decode, told["whole"]))
        for name in ("A", "B"):
            told[name] = tuple(map(tuple, told[name]))
        told["keys"] = told["keys"] and KeysHeld.model_validate(told["keys"])
        return Belief(**told)

    def message_symbols(self) -> MessageSymbols:
        """What she takes for the message."""
        told: MessageSymbols = self._ask("message_symbols")
        return told

    def review(self) -> Sequence[Guess]:
        """Her second thoughts."""
        return [_guess(guess) for guess in self._ask("review")]


def _guess(told: Any) -> Guess:
    k, symbol, agreed, session = told
    return Guess(int(k), tuple(symbol), agreed, str(session))


@cache
def sandboxed(name: str) -> type[Eavesdropper]:
    """The class of an eavesdropper; one of the user's own as a :class:`SandboxedEavesdropper`.

    Raises
    ------
    KnowledgeError
        With one line, when there is no such eavesdropper or she cannot be loaded.
    """
    if name in LADDER or ":" not in name:
        return named(name)
    guest = Guest(__name__, (name,))
    try:
        told = guest.ask("who", None, START_S)
    except GuestError as error:
        if error.kind == LACKS:
            raise KnowledgeError(str(error)) from None
        raise KnowledgeError(f"{name}: cannot be loaded: {error}") from None
    finally:
        guest.end()
    attributes = {
        "source": name,
        "name": str(told["name"]),
        "heavy": bool(told["heavy"]),
        "told_model": bool(told["told_model"]),
        "hears_messages": bool(told["hears_messages"]),
        "guesses": bool(told["guesses"]),
        "reads_outputs": bool(told["reads_outputs"]),
    }
    return type("SandboxedEavesdropper", (SandboxedEavesdropper,), attributes)


def each_once(names: Sequence[str]) -> tuple[str, ...]:
    """The eavesdroppers without those that are named again.

    Raises
    ------
    KnowledgeError
        When two have one name: nobody could tell their guesses apart.
    """
    found: dict[str, str] = {}
    for name in names:
        its = sandboxed(name).name
        if found.setdefault(its, name) != name:
            raise KnowledgeError(f"{found[its]} and {name} are both named {its!r}")
    return tuple(dict.fromkeys(names))


# --- her side -------------------------------------------------------------------------------------


class EavesdropperServer:
    """The eavesdropper, once she was made."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._tap: Eavesdropper | None = None

    def answer(self, what: str, argument: Any) -> object:
        """What the eavesdropper's code says when it is asked."""
        kind = named(self._name)
        if what == "who":
            return {attribute: getattr(kind, attribute) for attribute in TOLD}
        if what == "make":
            self._tap = kind(Knowledge.model_validate_json(argument))
            return None
        assert self._tap is not None
        return _answer(self._tap, what, argument)


def _answer(tap: Eavesdropper, what: str, argument: Any) -> object:
    if what == "observe":
        guess = _told(tap.observe(argument))
        final_guesses = [_told(one) for one in getattr(tap, "final_guesses", ())]
        if final_guesses:
            tap.final_guesses.clear()
        return guess, final_guesses
    if what == "review":
        return [_told(one) for one in tap.review()]
    if what == "message_symbols":
        return sound_symbols(tap.message_symbols())
    if what == "hear":
        tap.hear(argument)
        return None
    belief = tap.belief()
    if not isinstance(belief, Belief):
        raise TypeError(f"expected a Belief, got {belief!r}")
    return {
        **{name: getattr(belief, name) for name in Belief.__slots__},
        "message": base64.b64encode(belief.message).decode(),
        "whole": [base64.b64encode(bytes(whole)).decode() for whole in belief.whole],
        "keys": None if belief.keys is None else belief.keys.model_dump(),
    }


def _told(guess: object) -> object:
    if not isinstance(guess, Guess):
        raise TypeError(f"expected a Guess, got {guess!r}")
    return [guess.k, [float(p) for p in guess.symbol], float(guess.agreed), guess.session]


if __name__ == "__main__":
    serve(EavesdropperServer(sys.argv[1]).answer, ((KnowledgeError, LACKS),))
