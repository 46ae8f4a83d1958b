"""The schemes by name, as a scenario's ``[secrecy] scheme`` gives it."""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, Final, TypeVar

from protocol.agreement import NO_SYMBOL
from protocol.plugins import UnknownError, load_class
from protocol.schemes.base import Carry, Scheme

T = TypeVar("T")

EXPLORED: Final = 64
"""States of a scheme that are looked at before anybody follows it."""


def _asked(method: Callable[..., T], *arguments: object) -> T:
    """What it answers; raises UnknownError with one line where it raises anything."""
    try:
        return method(*arguments)
    except Exception as error:  # the code is the user's
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise UnknownError(f"{method.__name__}: {why}") from error


def _problems(scheme: Scheme[Any]) -> Iterator[str]:
    """What breaks a scheme's rules in its states over two symbols, the nearest ones first."""
    symbols = (NO_SYMBOL, 0, 1)
    states = [scheme.initial]
    for state in states:
        pad: object = _asked(scheme.pad, state)
        tests: object = _asked(scheme.tests, state)
        if pad not in symbols:
            yield f"pad: got {pad!r} in {state}, expected -1 to 1 for two symbols"
        if not isinstance(tests, bool):
            yield f"tests: got {tests!r} in {state}, expected True or False"
        answers: list[object] = [_asked(scheme.advance, state, v) for v in symbols]
        for verdict, answer in zip(symbols, answers, strict=True):
            told = f"advance: got {answer!r} in {state} at {verdict}, expected"
            match answer:
                case (tuple() as after, Carry() as carry) if type(after) is type(state):
                    if not all(isinstance(v, int) for v in after):
                        yield f"{told} a state of whole numbers"
                    if carry.pad != pad:
                        yield f"{told} pad {pad!r}, as pad() says"
                    if carry.agreed not in (symbols if scheme.corrects else (NO_SYMBOL, verdict)):
                        yield f"{told} agreed to be the verdict, or -1"
                    if after not in states and len(states) < EXPLORED:
                        states.append(after)
                case _:
                    yield f"{told} a state and a Carry"
        if not tests and any(answer != answers[0] for answer in answers):
            yield f"tests: got False in {state}, expected True, since a verdict makes a difference"


SCHEMES: Final = {
    "switched": "protocol.schemes.switched:Switched",
    "pipelined": "protocol.schemes.pipelined:Pipelined",
    "sealed": "protocol.schemes.sealed:Sealed",
    "reconciled": "protocol.schemes.reconciled:Reconciled",
    "reconciled-31": "protocol.schemes.reconciled:Reconciled31",
}
"""Where the shipped ones are."""


def scheme_named(name: str) -> type[Scheme[Any]]:
    """The scheme of that name, shipped or ``path/to/file.py:Name``, that both ends can follow.

    Raises
    ------
    protocol.plugins.UnknownError
        When there is none, or an end could not follow it; one line.
    """
    scheme: type[Scheme[Any]] = load_class(name, SCHEMES, Scheme)  # type: ignore[type-abstract]
    if problem := _problem(scheme):
        raise UnknownError(f"{name!r}: {problem}")
    return scheme


@cache
def _problem(scheme: type[Scheme[Any]]) -> str:
    """What an end could not follow of it, in a line; empty where there is nothing."""
    version: object = getattr(scheme, "version", None)
    initial: Any = getattr(scheme, "initial", None)
    if not isinstance(version, int):
        return f"expected a class attribute version, a whole number, got {version!r}"
    if not (
        isinstance(initial, tuple)
        and hasattr(initial, "_fields")
        and all(isinstance(v, int) for v in initial)
    ):
        return f"expected a class attribute initial, a NamedTuple of whole numbers, got {initial!r}"
    try:
        return next(_problems(_asked(scheme, 2)), "")
    except UnknownError as error:
        return str(error)


def make_scheme(name: str, alphabet: int) -> Scheme[Any]:
    """The scheme of that name over ``alphabet`` symbols.

    Raises
    ------
    protocol.plugins.UnknownError
        As :func:`scheme_named`.
    """
    return scheme_named(name)(alphabet)
