"""A table of a session: what an end answers to what happens, and how it stands afterwards."""

from collections.abc import Iterable, Mapping
from typing import Generic, NamedTuple, TypeVar

S = TypeVar("S", bound=str)
A = TypeVar("A", bound=str)
Said = TypeVar("Said", bound=str)


class Row(NamedTuple, Generic[A, S]):
    """What an end answers, and how it stands afterwards."""

    answer: A
    next: S


def whole(
    states: Iterable[S],
    default: Mapping[Said, tuple[A, S | None]],
    exceptions: Mapping[tuple[S, Said], Row[A, S]],
) -> dict[tuple[S, Said], Row[A, S]]:
    """A row for each state and each thing that may happen in it.

    Parameters
    ----------
    states : iterable of str
    default : mapping
        The answer to what happens, and the state after it (None: the same).
    exceptions : mapping
        Rows of states in which that is otherwise.
    """
    return {
        (state, what): exceptions.get((state, what), Row(answer, following or state))
        for state in states
        for what, (answer, following) in default.items()
    }
