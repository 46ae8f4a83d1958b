"""What Eve expects of a message: a mixture of kinds of text, each a model of the next byte.

Each kind has a share before anything is heard. With every byte the shares become what Bayes' rule
says, so what is known of a message tells its kind, and the kind the rest. Now and then a text goes
on as another kind does: prose has a name or a number in it. The last kind is any bytes at all, so
that what nobody thought of has a place too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Indices
from tap_service.inference.english import (
    BASE,
    CLASSES,
    FIRST,
    LAST,
    OTHER,
    SPACE,
    Codes,
    Contexts,
    Counted,
    class_named,
    distinct,
    english,
    languages,
)

ANY_BYTE: Final = 0.002
"""Probability that a byte of prose is any byte at all."""

CLOSED: Final = 0.4
"""Probability that a message closes with a mark of its own."""

MARKS: Final = ((".", 0.8), ("?", 0.1), ("!", 0.1))
"""These, and how often each."""

LEAVES: Final = 0.004
"""Probability that a text goes on as printable characters of any kind after a byte."""

RETURNS: Final = 0.1
"""Probability that these are followed by a kind of text again, each by its share."""

LEAST: Final = 2e-4
"""Share of a kind from which its model is asked."""

STRANGE: Final = 1e-4
"""Probability that a kind gives a byte at least where it is asked which kind a text is."""

UNEXPECTED: Final = 0.02
"""Probability of a character that is none of a set of which a text is made."""

FORMS: Final = """\
+00 00 0000 0000; +0 000 000 0000; (000) 000-0000; 0000 000 000; +00 000 000 00 00; 000-000-0000
00.0000 N, 0.0000 E; -00.0000, 000.0000; 00 00 00 N 000 00 00 E; lat 00.000 lon -0.000; N 00.00
0000-00-00 00:00; 0000-00-00T00:00:00Z; 00 Jan 0000 at 00:00 UTC; Tue 0 March 0000; 00/00/0000
00.00.0000, 00:00; Friday 00:00; 0:00 pm; 00 000; 0.00; 00000; 000.00 EUR; 000.000.0.00; 00 %
Mon 0 Feb, 00.00; Wed 00 April 0000 00:00:00 +0000; 00 Sep 0000 (Sat); Thu 00.00.; Sun, 0 Oct 0000
00 Dec 00, 0 May; June 00; 0 July; 00 Aug 0000 0000Z; 0 Nov; 00'00" S, 000'00" W; -0.0 0.0; 0/0
"""
"""Forms of numbers, with a nought for any digit: dates, places, telephones, amounts."""


class Kind(NamedTuple):
    """One kind of text.

    Parameters
    ----------
    name : str
        As it is told.
    share : float
        Probability before anything is heard.
    next : callable
        Probability of each next byte, shape (H, 256), by the contexts.
    leaves : float
        Probability that the text goes on as another kind.
    sentences : bool
        Whether such a message may close with a mark.
    """

    name: str
    share: float
    next: Callable[[Contexts], Array]
    leaves: float = 0.0
    sentences: bool = False


ByKind = dict[int, NDArray[np.float32]]
"""Probability of each next byte by kinds, shape (H, 256) each; a kind of no share has none."""


class State(NamedTuple):
    """Where hypotheses stand in their texts, and the share of each kind, shape (H, kinds)."""

    at: Contexts
    shares: Array

    def take(self, rows: Indices) -> "State":
        """Those of some hypotheses."""
        return State(self.at.take(rows), self.shares[rows])


@dataclass(frozen=True, slots=True)
class Expectation:
    """A mixture of kinds; kinds of the same name count as one when it is told.

    Attributes
    ----------
    kinds : sequence of Kind
    moves : array, shape (kinds, kinds)
        Probability that a text of one kind goes on as another after a byte.
    """

    kinds: Sequence[Kind]
    moves: Array

    @classmethod
    def of(cls, kinds: Sequence[Kind]) -> Self:
        """Any kind may be left for ``any bytes``, which every kind may follow by its share."""
        shares = np.array([kind.share for kind in kinds])
        moves = np.diag([1.0 - kind.leaves for kind in kinds])
        hub = next((i for i, kind in enumerate(kinds) if kind.name == ANY), 0)
        moves[:, hub] += [kind.leaves for kind in kinds]
        moves[hub] = (1 - RETURNS) * np.eye(len(kinds))[hub] + RETURNS * shares / shares.sum()
        return cls(kinds, moves)

    def start(self, count: int) -> State:
        """At the beginning of a message."""
        shares = np.array([kind.share for kind in self.kinds])
        return State(Contexts.start(count), np.tile(shares / shares.sum(), (count, 1)))

    def named(self, shares: Array) -> str:
        """The kind that is likelier than all others together; else that it is not known."""
        together: dict[str, float] = {}
        for kind, share in zip(self.kinds, shares.tolist(), strict=True):
            together[kind.name] = together.get(kind.name, 0.0) + share
        likeliest = max(together, key=together.__getitem__)
        return likeliest if together[likeliest] > 0.5 else UNKNOWN

    def next(self, state: State, last: Flags) -> tuple[Array, ByKind]:
        """Probability of each next byte, shape (H, 256), and the same by each kind.

        A kind of which hardly anything is left counts nothing.

        Parameters
        ----------
        state : State
        last : bool array, shape (H,)
            Whether it is the message's last byte.
        """
        shares = np.where(state.shares > LEAST, state.shares, 0.0)
        shares /= shares.sum(axis=1, keepdims=True)
        by_kind: ByKind = {}
        whole = np.zeros((len(shares), 256))
        for i in np.flatnonzero(shares.any(axis=0)).tolist():
            kind, rows = self.kinds[i], np.flatnonzero(shares[:, i])
            at = state.at.take(rows)
            first, back = distinct(at.last, at.word, at.before)
            each = by_kind[i] = np.zeros((len(shares), 256), dtype=np.float32)
            each[rows] = kind.next(at.take(first))[back]
            if kind.sentences:
                closing = rows[last[rows]]
                each[closing] *= 1 - CLOSED
                for mark, share in MARKS:
                    each[closing, ord(mark)] += CLOSED * share
            whole[rows] += shares[rows, i, None] * each[rows]
        return whole, by_kind

    def after(self, state: State, values: Indices, by_kind: ByKind, rows: Indices) -> State:
        """After one more byte each, given what :meth:`next` said of these rows."""
        shares = np.zeros_like(state.shares)
        for i, p in by_kind.items():
            shares[:, i] = state.shares[:, i] * p[rows, values]
        shares /= shares.sum(axis=1, keepdims=True)
        return State(state.at.after(values), shares @ self.moves)

    def weighed(self, texts: Sequence[bytes], *, ended: bool = True) -> tuple[Array, list[str]]:
        """Log2 probability of texts, their lengths given, and what kind each is (:meth:`named`).

        Texts that are not ``ended`` are beginnings of messages.
        """
        lengths = np.array([len(text) for text in texts])
        table = np.zeros((len(texts), int(lengths.max(initial=0))), dtype=np.intp)
        for row, text in zip(table, texts, strict=True):
            row[: len(text)] = list(text)
        total, state = np.zeros(len(texts)), self.start(len(texts))
        each, going = np.log2(state.shares), np.arange(len(texts))
        for place in range(table.shape[1]):
            longer = np.flatnonzero(lengths[going] > place)
            going, state = going[longer], state.take(longer)
            rows, values = np.arange(len(going)), table[going, place]
            p, by_kind = self.next(state, ended & (lengths[going] == place + 1))
            total[going] += np.log2(p[rows, values])
            for i in range(len(self.kinds)):
                said = by_kind[i][rows, values] if i in by_kind else np.zeros(len(going))
                each[going, i] += np.log2(np.maximum(said, STRANGE))
            state = self.after(state, values, by_kind, rows)
        share = np.exp2(each - each.max(axis=1, keepdims=True))
        return total, [self.named(row) for row in share / share.sum(axis=1, keepdims=True)]


ANY: Final = "any bytes"

UNKNOWN: Final = "a kind not known"
"""Told of a text where no kind is likelier than all others together."""


def _bytes_of(p: Array, unexpected: float) -> Array:
    """Probability of bytes by that of classes, but for a share of them that are any bytes."""
    out = np.tile((1 - unexpected) * p[:, OTHER:] / 161 + unexpected / 256, 256)
    out[:, FIRST : LAST + 1] = (1 - unexpected) * p[:, :OTHER] + unexpected / 256
    return out


_CAPITALS: Final = np.array([class_named(chr(c)) for c in range(ord("A"), ord("Z") + 1)])
_SMALL: Final = _CAPITALS + 32
_DIGITS: Final = np.array([class_named(c) for c in "0123456789"])


def _seen_as(classes: Codes, others: Codes | int) -> Codes:
    out = np.arange(CLASSES)
    out[classes] = others
    return out


def _prose(model: Counted) -> Callable[[Contexts], Array]:
    return lambda at: _bytes_of(model.next(at), ANY_BYTE)


def _cased(
    model: Counted, at_first: float, within: float, after_capital: float
) -> Callable[[Contexts], Array]:
    """A model of small letters, some of them capitals: a word's first, within it, after one."""
    capital = np.full(CLASSES, within)
    capital[_CAPITALS] = after_capital
    capital[SPACE] = at_first
    small = _seen_as(_CAPITALS, _SMALL)

    def following(at: Contexts) -> Array:
        p = model.next(at.seen_as(small))
        both, share = p[:, _CAPITALS] + p[:, _SMALL], capital[at.last % BASE][:, None]
        p[:, _CAPITALS], p[:, _SMALL] = both * share, both * (1 - share)
        return _bytes_of(p, ANY_BYTE)

    return following


def _numbers() -> Callable[[Contexts], Array]:
    noughts = _seen_as(_DIGITS, _DIGITS[0])
    forms = "; ".join(FORMS.splitlines()) + "; "
    model = Counted.of(forms.encode("ascii"), 4, noughts)

    def following(at: Contexts) -> Array:
        p = model.next(at.seen_as(noughts))
        p[:, _DIGITS] = p[:, _DIGITS].sum(axis=1, keepdims=True) / 10
        return _bytes_of(p, UNEXPECTED)

    return following


def _made_of(characters: str, unexpected: float = UNEXPECTED) -> Callable[[Contexts], Array]:
    p = np.zeros((1, CLASSES))
    p[0, [class_named(c) for c in characters]] = 1 / len(characters)
    row = _bytes_of(p, unexpected)
    return lambda at: np.broadcast_to(row, (len(at.last), 256))


DIGITS: Final = "0123456789"
LETTERS: Final = "abcdefghijklmnopqrstuvwxyz"
PRINTABLE: Final = "".join(map(chr, range(FIRST, LAST + 1)))


@cache
def expected() -> Expectation:
    """The mixture that Eve expects."""
    prose, others = english(), languages()
    capitals = _cased(prose, 0.99, 0.99, 0.99)
    foreign = {name: _cased(model, 0.2, 0.005, 0.3) for name, model in others.items()}
    alphanumeric = DIGITS + LETTERS + LETTERS.upper()
    return Expectation.of(
        [
            Kind("English sentences", 0.45, _prose(prose), LEAVES, sentences=True),
            Kind("English in capitals", 0.08, capitals, LEAVES, sentences=True),
            *(
                Kind(name, 0.12 / len(foreign), following, LEAVES, sentences=True)
                for name, following in foreign.items()
            ),
            Kind("digits and signs", 0.12, _numbers(), LEAVES),
            Kind("hexadecimal", 0.03, _made_of(DIGITS + LETTERS[:6])),
            Kind("hexadecimal", 0.02, _made_of(DIGITS + LETTERS[:6].upper())),
            Kind("base64", 0.04, _made_of(alphanumeric + "+/=")),
            Kind(ANY, 0.07, _made_of(PRINTABLE, 0.05)),
            Kind(ANY, 0.07, _made_of(PRINTABLE, 1.0)),
        ]
    )
