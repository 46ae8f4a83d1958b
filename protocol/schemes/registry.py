"""The schemes by name, as a scenario's ``[secrecy] scheme`` gives it."""

from typing import Any, Final

from protocol.agreement import NO_SYMBOL
from protocol.registry import Classes, UnknownError
from protocol.schemes.base import Carry, Scheme


class Schemes(Classes[Scheme[Any]]):
    """Schemes by name; one that both ends could not follow is refused here, in one line."""

    def _checked(self, name: str, found: object, class_name: str) -> type[Scheme[Any]]:
        scheme = super()._checked(name, found, class_name)
        version: object = getattr(scheme, "version", None)
        initial: Any = getattr(scheme, "initial", None)
        if not isinstance(version, int):
            raise UnknownError(
                f"{name!r}: expected a class attribute version, a whole number, got {version!r}"
            )
        named = isinstance(initial, tuple) and hasattr(initial, "_fields")
        if not (named and all(isinstance(v, int) for v in initial)):
            raise UnknownError(
                f"{name!r}: expected a class attribute initial, a NamedTuple of whole numbers, "
                f"got {initial!r}"
            )
        try:
            answer: object = scheme(2).advance(initial, NO_SYMBOL)
        except Exception as error:  # the code is the user's
            raise UnknownError(f"{name!r}: advance: {type(error).__name__}: {error}") from error
        kinds = [type(part) for part in answer] if isinstance(answer, tuple) else []
        if kinds != [type(initial), Carry]:
            raise UnknownError(f"{name!r}: advance: got {answer!r}, expected a state and a Carry")
        return scheme


SCHEMES: Final[Schemes] = Schemes(
    "scheme",
    Scheme,
    {
        "switched": "protocol.schemes.switched:Switched",
        "pipelined": "protocol.schemes.pipelined:Pipelined",
    },
)


def make_scheme(name: str, alphabet: int) -> Scheme[Any]:
    """The scheme of that name over ``alphabet`` symbols.

    Raises
    ------
    protocol.registry.UnknownError
        When there is none.
    """
    return SCHEMES[name](alphabet)
