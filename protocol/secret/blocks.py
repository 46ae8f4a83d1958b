"""Key blocks: which transitions make one, and what its keys are made of.

Block b is N_b = min(N, N_0 2^b) transitions. Block 0 begins after the session's first transition:
a jammer may have chosen that one, so it does not count. All of this follows from the transitions'
numbers, which both ends count alike.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

from protocol.secret.bound import Assumption, least
from protocol.secret.nonces import Contribution

LARGEST_BLOCK: Final = 16384
"""Most transitions of a block: their two nonces each, and the rows, fit the field."""

LARGEST_BY_WORDS: Final = 1024
"""The same where each of the nonces' 16 words is a column."""

ROWS_ENOUGH: Final = 64
"""Blocks grow until they yield so many rows. Longer ones gain little and come later."""

TAG_DIGITS: Final = 32
NO_TAG: Final = "0" * TAG_DIGITS


@dataclass(frozen=True, slots=True)
class Schedule:
    """Where blocks begin, from the assumption alone.

    Parameters
    ----------
    assumption : Assumption
    first : int
        N_0, the least number of transitions that makes a key where nothing is lost.
    largest : int
        N, the least power of two that makes 64 rows.
    """

    assumption: Assumption
    first: int
    largest: int

    @property
    def growing(self) -> int:
        """How many blocks are shorter than N: N_b is N_0 2^b for those, and N from there on."""
        return (-(-self.largest // self.first) - 1).bit_length()

    def length(self, number: int) -> int:
        """N_b: transitions of block ``number``."""
        return self.first << number if number < self.growing else self.largest

    def begins(self, number: int) -> int:
        """The first transition of block ``number``."""
        grown = min(number, self.growing)
        return 1 + self.first * ((1 << grown) - 1) + (number - grown) * self.largest

    @property
    def first_use(self) -> int:
        """The first step of a session that can have a digit of the key stream.

        Block 0 is over with the measurement of step ``begins(1)``, and is extracted. Each end
        announces it after one more transition. The plant confirms it by the offer of that step, the
        controller by the measurement after that, and then names a digit.
        """
        return self.begins(1) + 3

    def block_of(self, j: int) -> int:
        """The block of transition ``j``; -1 for the session's first."""
        if j < 1:
            return -1
        grown = self.growing
        b = ((j - 1) // self.first + 1).bit_length() - 1  # N_0 (2^b - 1) came before it
        return b if b < grown else grown + (j - self.begins(grown)) // self.largest


@cache
def schedule_of(assumption: Assumption) -> Schedule | None:
    """The schedule, or None where the assumption makes no key in any block."""

    def enough(rows: int, n: int) -> bool:
        return assumption.rows(n, n, assumption.copies * n) >= rows

    most = LARGEST_BY_WORDS if assumption.by_words else LARGEST_BLOCK
    first = least(lambda n: enough(2, n), most)
    if first is None:
        return None
    largest = 1
    while largest < most and not enough(ROWS_ENOUGH, largest):
        largest *= 2
    return Schedule(assumption, first, max(largest, first))


class ClosedBlock(NamedTuple):
    """A block whose last transition has been counted, with all that its keys are made of.

    Parameters
    ----------
    session, number
        Session and number of the block.
    transitions, steps, counted : int
        Transitions N, steps (missed ones included), and copies 0 that count.
    rows : int
        R. Below 2 the block makes no key.
    pattern : str
        A digit a transition: 0 no copy counts, 1 the offer's, 2 the measurement's, 3 both.
    nonces : tuple of bytes
        Nonces that count, in the order of transitions, an offer's before its measurement's.
    last : int
        Number of the block's last transition.
    by_words : bool
        The matrix works on words of 16 bits in place of whole nonces.
    """

    session: str
    number: int
    transitions: int
    steps: int
    counted: int
    rows: int
    pattern: str
    nonces: tuple[bytes, ...]
    last: int
    by_words: bool = False

    @property
    def makes_keys(self) -> bool:
        """Whether there are rows for a tag and a key."""
        return self.rows >= 2


class OpenBlock:
    """A block under way. It takes rows as they come, so its last step costs no more than others.

    Attributes
    ----------
    pattern : list of str
        That of the closed block, as far as it goes; empty as long as it has no row.
    """

    def __init__(self, assumption: Assumption) -> None:
        self._assumption = assumption
        self._offers, self._measurements = assumption.counting(1) > 0, assumption.counting(2) > 0
        self._steps = 0
        self._nonces: list[bytes] = []
        self.pattern: list[str] = []

    def add(self, contribution: Contribution) -> None:
        """Add the row of the next transition."""
        _, steps, offer, measurement = contribution
        counts = 0
        if offer is not None and self._offers:
            self._nonces.append(offer)
            counts = 1
        if measurement is not None and self._measurements:
            self._nonces.append(measurement)
            counts += 2
        self.pattern.append("0123"[counts])
        self._steps += steps

    def close(self, session: str, number: int, last: int) -> ClosedBlock:
        """The closed block ``number``; the row of transition ``last`` was its last one."""
        n, steps, counted = len(self.pattern), self._steps, len(self._nonces)
        return ClosedBlock(
            session,
            number,
            n,
            steps,
            counted,
            self._assumption.rows(n, steps, counted),
            "".join(self.pattern),
            tuple(self._nonces),
            last,
            self._assumption.by_words,
        )


class ExtractedBlock(NamedTuple):
    """The tag and the keys of a block, the same at both ends where their rows are the same.

    Parameters
    ----------
    session, number
        Session and number of the block.
    tag : str
        16 bytes of row 0, in hexadecimal digits. A chance fault passes with probability 2^-128.
    keys : tuple of bytes
        The other rows, 32 bytes each.
    """

    session: str
    number: int
    tag: str
    keys: tuple[bytes, ...]

    def __repr__(self) -> str:
        return f"ExtractedBlock({self.session}/{self.number})"


class ExtractionFailed(NamedTuple):
    """No block can be extracted any more; the loop goes on without new keys."""

    reason: str
