"""The ladder of eavesdroppers, from the paper's own to the oracle, and how to find one by name.

``named("list-decoder")`` gives a class of the ladder; ``named("path/to/file.py:Name")`` one of the
user's own. Modules are loaded when they are asked for.
"""

from typing import Final

from protocol.knowledge import Knowledge
from protocol.plugins import UnknownError, checked_class, load_class
from protocol.schemes.registry import scheme_named
from protocol.secret.blocks import schedule_of
from tap_service.eavesdroppers.base import Belief, Eavesdropper, Guess, KnowledgeError

__all__ = [
    "LADDER",
    "Belief",
    "Eavesdropper",
    "Guess",
    "KnowledgeError",
    "default_names",
    "named",
]

LADDER: Final[dict[str, str]] = {
    "set-membership": "tap_service.eavesdroppers.set_membership:SetMembership",
    "nearest-centre": "tap_service.eavesdroppers.nearest_centre:NearestCentre",
    "list-decoder": "tap_service.eavesdroppers.list_decoder:ListDecoder",
    "learning": "tap_service.eavesdroppers.learning:Learning",
    "text": "tap_service.eavesdroppers.text:Text",
    "oracle": "tap_service.eavesdroppers.oracle:Oracle",
    "key-solver": "tap_service.eavesdroppers.key_solver:KeySolver",
}
"""Each name with its module and class, weakest first; the last goes for the keys alone."""

ORACLE: Final = "oracle"
"""The one that must be told alpha."""

DEFAULT: Final = ("set-membership", "nearest-centre", "list-decoder", "text")
"""Without a choice: the strongest, whatever is heard, and those it is compared with."""

DEFAULT_CORRECTED: Final = ("set-membership", "nearest-centre")
"""The same where the scheme corrects words: the others do not follow it."""


KEY_SOLVER: Final = "key-solver"
"""The one who goes for keys: she listens by default where any are made."""


def default_names(knowledge: Knowledge) -> tuple[str, ...]:
    """Who listens where nobody was named."""
    names = DEFAULT_CORRECTED if scheme_named(knowledge.scheme).corrects else DEFAULT
    makes_keys = knowledge.keys is not None and schedule_of(knowledge.keys) is not None
    return (*names, KEY_SOLVER) if makes_keys else names


def named(name: str) -> type[Eavesdropper]:
    """The class of an eavesdropper, by its name in the ladder or as ``FILE.py:NAME``.

    Raises
    ------
    KnowledgeError
        With one line, when there is no such eavesdropper.
    """
    try:
        return load_class(name, LADDER, Eavesdropper)  # type: ignore[type-abstract]
    except UnknownError as error:
        raise KnowledgeError(str(error)) from None


def sound(one: str | type[Eavesdropper]) -> type[Eavesdropper]:
    """A class of an eavesdropper, as it is or by its name, that has all that it needs.

    Raises
    ------
    KnowledgeError
        With one line, when there is no such eavesdropper, or the class lacks a name or a method.
    """
    if isinstance(one, str):
        return named(one)
    try:
        return checked_class(one, one.__name__, Eavesdropper)  # type: ignore[type-abstract]
    except UnknownError as error:
        raise KnowledgeError(str(error)) from None
