"""A law in a file of the user's: each of its answers is looked at before anybody acts on it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike

from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import OutsideError, ProgramError
from controller_service.sets.design import Design
from protocol.agreement import INSIDE
from protocol.arrays import Array, Indices
from protocol.scenario import Scenario
from runtime.user_code import UserCodeError


class OwnLaw:
    """A user's law as everybody asks it; see :class:`controller_service.laws.base.CandidateLaw`.

    Every method raises ``OutsideError`` and ``ProgramError`` where the law does: these are a law's
    own words for a state without candidates. For anything else that the law raises, and for an
    answer that is not M candidates of m inputs in U, it raises ``UserCodeError`` with one line.

    Parameters
    ----------
    name : str
        As ``control.law`` gives it, for the line.
    law : CandidateLaw
    scenario : Scenario
    """

    def __init__(self, name: str, law: CandidateLaw, scenario: Scenario) -> None:
        self._name = f"control.law: {name}"
        self._law = law
        self._shape = (scenario.secrecy.candidates, scenario.m)
        H, h = scenario.control.inputs.rows()
        self._H, self._h = np.array(H), np.array(h) * INSIDE

    @property
    def design(self) -> Design:
        """The design that the law is on."""
        return self._law.design

    def index(self, x: Sequence[float]) -> int:
        """See :meth:`CandidateLaw.index`."""
        with self._asked(f"index at x = {list(x)}"):
            return int(self._law.index(x))

    def indices(self, X: ArrayLike) -> Indices:
        """See :meth:`CandidateLaw.indices`."""
        with self._asked("indices"):
            return self._law.indices(X)

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """See :meth:`CandidateLaw.candidates`."""
        with self._asked(f"candidates for one state, x = {list(x)}"):
            found = np.array(self._law.candidates(x), dtype=float)
        self._judge("candidates for one state", found[np.newaxis], np.array([x]), one=True)
        return tuple(map(tuple, found.tolist()))

    def candidates_many(self, X: ArrayLike, indices: Indices | None = None) -> Array:
        """See :meth:`CandidateLaw.candidates_many`."""
        with self._asked("candidates for many states"):
            found = np.array(self._law.candidates_many(X, indices), dtype=float)
        self._judge("candidates for many states", found, np.asarray(X, dtype=float), one=False)
        return found

    def gain(self, i: int) -> Array | None:
        """See :meth:`CandidateLaw.gain`."""
        with self._asked(f"gain of index {i}"):
            return self._law.gain(i)

    @contextmanager
    def _asked(self, what: str) -> Iterator[None]:
        try:
            yield
        except (OutsideError, ProgramError):
            raise
        except Exception as error:  # the code is the user's
            why = " ".join(f"{type(error).__name__}: {error}".split())
            raise UserCodeError(f"{self._name}: {what}: {why}") from error

    def _judge(self, what: str, found: Array, X: Array, *, one: bool) -> None:
        """Refuse what has another shape than (R, M, m), R states; or a candidate outside U."""
        shape = (len(X), *self._shape)
        if found.shape != shape:
            raise UserCodeError(
                f"{self._name}: {what}: got shape {found.shape[one:]}, expected {shape[one:]}, M "
                "candidates of m inputs"
            )
        outside = np.argwhere(~(found @ self._H.T <= self._h).all(axis=-1))
        if len(outside):
            state, candidate = outside[0]
            raise UserCodeError(
                f"{self._name}: {what}, x = {X[state].tolist()}: got "
                f"{found[state, candidate].tolist()}, expected each in control.inputs"
            )


def try_at_origin(law: OwnLaw, scenario: Scenario) -> None:
    """Ask a user's law once before anything runs under it, for one state and for many.

    Raises
    ------
    ProgramError
        With one line, when it raises what no law may, its answer is no M candidates in U, or that
        for one state differs from that for many.
    """
    x = (0.0,) * scenario.n
    try:
        one = law.candidates(x)
        many = law.candidates_many([x])[0].tolist()
    except (OutsideError, ProgramError):
        return  # the law's own word, told to whoever asks at a state of the loop
    except UserCodeError as error:
        raise ProgramError(str(error)) from error.__cause__
    if list(map(list, one)) != many:
        raise ProgramError(
            f"control.law: {scenario.control.law}: candidates at x = {list(x)}: got "
            f"{list(map(list, one))} for one state and {many} for many, expected the same"
        )
