"""The plant's steps in some 45 bytes each: what the capture is compared with."""

import struct
from array import array
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from wyner.runs.check.records import MissedLine, Shape, TracedTransition

NONE: Final = -1


class AppliedStep(NamedTuple):
    """What the plant's trace holds of step k, in short; ``j`` is -1 where it was missed."""

    j: int
    cipher: int
    pad: int
    last_applied: int
    x: int
    candidates: int
    x_next: int


class _Session:
    """The steps of one session, in order of k."""

    def __init__(self, first: int) -> None:
        self.first = first
        self.j = array("q")
        self.cipher = array("h")
        self.pad = array("h")
        self.last_applied = array("q")
        self.x = array("q")
        self.candidates = array("q")
        self.x_next = array("q")
        self.newest = NONE

    def __len__(self) -> int:
        return len(self.j)


class Steps:
    """Every step of a plant's trace, by session and k.

    Vectors are kept as 64-bit hashes of their bytes, so that a million steps take 45 MB whatever
    the plant's size.

    Parameters
    ----------
    shape : Shape
    """

    def __init__(self, shape: Shape) -> None:
        self._sessions: dict[str, _Session] = {}
        self.of_state: Callable[[Sequence[float]], int] = _hasher(shape.n)
        self._of_flat = _hasher(shape.size * shape.m)

    def of_candidates(
        self, candidates: Sequence[Sequence[float]], predictions: Sequence[Sequence[float]] = ()
    ) -> int:
        """The hash of some candidates, and of the predictions offered with them."""
        found = self._of_flat([v for u in candidates for v in u])
        return hash((found, *map(tuple, predictions))) if predictions else found

    def counted(self, t: TracedTransition, pad: int) -> None:
        """File a transition; ``pad`` is the key under which it carried a symbol, or -1."""
        session = self._at(t.session, t.k)
        if session is None:
            return
        session.j.append(t.j)
        session.cipher.append(t.cipher)
        session.pad.append(pad)
        session.x.append(self.of_state(t.x))
        session.candidates.append(self.of_candidates(t.candidates, t.predictions))
        session.x_next.append(self.of_state(t.x_next))
        session.newest = t.k

    def missed(self, step: MissedLine) -> None:
        """File a missed step."""
        session = self._at(step.session, step.k)
        if session is None:
            return
        session.j.append(NONE)
        session.cipher.append(NONE)
        session.pad.append(NONE)
        session.x.append(self.of_state(step.x))
        session.candidates.append(0)
        session.x_next.append(self.of_state(step.x_next))

    def _at(self, name: str, k: int) -> _Session | None:
        """The session whose next step is k; None where k does not follow (another check says)."""
        session = self._sessions.get(name)
        if session is None:
            session = self._sessions[name] = _Session(k)
        if k != session.first + len(session):
            return None
        session.last_applied.append(session.newest)
        return session

    def before(self, session: str, k: int) -> bool:
        """Whether step k came no later than the first that was applied, of all that are filed."""
        first = next(iter(self._sessions), None)
        if first is None or session != first:
            return session not in self._sessions
        found = self._sessions[first]
        applied = next((i for i, j in enumerate(found.j) if j != NONE), len(found))
        return k <= found.first + applied

    def knows(self, session: str) -> bool:
        """Whether the plant's trace has steps of this session."""
        return session in self._sessions

    def ends(self, session: str) -> tuple[int, int]:
        """The first step of a session, and the one after its last."""
        found = self._sessions[session]
        return found.first, found.first + len(found)

    def find(self, session: str, k: int) -> AppliedStep | None:
        """Step k of a session."""
        found = self._sessions.get(session)
        if found is None or not 0 <= k - found.first < len(found):
            return None
        i = k - found.first
        return AppliedStep(
            found.j[i],
            found.cipher[i],
            found.pad[i],
            found.last_applied[i],
            found.x[i],
            found.candidates[i],
            found.x_next[i],
        )

    def newest(self, session: str) -> int:
        """The last applied step of a session, or -1."""
        found = self._sessions.get(session)
        return NONE if found is None else found.newest

    def next_applied(self, session: str, k: int) -> int:
        """The transition that an offer for step k was made for: of the first applied k' >= k."""
        found = self._sessions.get(session)
        if found is None:
            return NONE
        i = max(k - found.first, 0)
        while i < len(found) and found.j[i] == NONE:
            i += 1
        return found.first + i if i < len(found) else NONE


def _hasher(count: int) -> Callable[[Sequence[float]], int]:
    pack = struct.Struct(f"{count}d").pack

    def digest(values: Sequence[float]) -> int:
        return hash(pack(*values))

    return digest
