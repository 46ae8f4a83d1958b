"""How likely each next byte of a message is to one who expects English, or expects nothing.

An n-gram model with words: what follows is counted after the last one to five characters, after the
beginning of the word in a list of words by their frequency, then in a text, and after the beginning
of the word and the word before it. A level that has seen little leaves the rest to the one below it
(Witten and Bell 1991). The counts are made from ``english.txt.xz`` and ``words.txt.xz`` when they
are first needed; docs/eavesdroppers.md says where these are from.
"""

import lzma
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array

Codes = NDArray[np.int64]

TEXT: Final = Path(__file__).parent / "english.txt.xz"

WORDS: Final = TEXT.with_name("words.txt.xz")

_FIRST, _LAST = 32, 126
CLASSES: Final = _LAST - _FIRST + 2
"""The printable characters of ASCII, and one class for all other bytes."""

OTHER: Final = CLASSES - 1

ORDERS: Final = (1, 2, 3, 4, 5)
"""Characters before the next one after which it is counted."""

_BASE: Final = 128
_PRIME: Final = 1_000_003
_MASK: Final = (1 << 61) - 1

ANY_BYTE: Final = 0.002
"""Probability that a byte of a text is any byte at all."""

STRENGTH: Final = 4.0
"""Of the level below, over Witten and Bell's own."""

WORD_STRENGTH: Final = 12.0
"""The same for the beginning of a word, of which the list below knows more than the text."""

SPACE: Final = 0

LISTED: Final = 0.9
"""Share of the list's answer within a word over that of the last characters."""

ENDINGS: Final = ((" ", 0.82), (",", 0.09), (".", 0.09))
"""What comes after a word of the list, and how often."""

CLOSED: Final = 0.4
"""Probability that a message closes with a mark of its own."""

MARKS: Final = ((".", 0.8), ("?", 0.1), ("!", 0.1))
"""These, and how often each."""

CLASS: Final = 5.0
"""Frequency classes of the list in a decade."""


class Level:
    """What followed each context of one kind.

    Parameters
    ----------
    contexts, following : integer arrays, shape (N,)
        The context of each character of the text, as a number, and the character's class.
    weights : array, shape (N,), optional
        How often each; once where not given.
    strength : float
        Of the level below.
    share : float, optional
        Of what was counted, over the level below; by how much was counted where not given.
    """

    def __init__(
        self,
        contexts: Codes,
        following: Codes,
        weights: Array | None = None,
        *,
        strength: float = STRENGTH,
        share: float | None = None,
    ) -> None:
        order = np.lexsort((following, contexts))
        c, f = contexts[order], following[order]
        first = np.ones(len(c), dtype=bool)
        first[1:] = (c[1:] != c[:-1]) | (f[1:] != f[:-1])
        at = np.flatnonzero(first)
        each = np.ones(len(c)) if weights is None else weights[order]
        counts = np.add.reduceat(each, at)
        self._following = f[at]
        pair_contexts = c[at]
        begin = np.ones(len(at), dtype=bool)
        begin[1:] = pair_contexts[1:] != pair_contexts[:-1]
        self._begin = np.flatnonzero(begin)
        self._contexts = pair_contexts[self._begin]
        self._size = np.diff(np.append(self._begin, len(at)))
        total = np.add.reduceat(counts, self._begin)
        weight = total / (total + strength * self._size)
        if share is not None:
            weight = np.full(len(total), share)
        self._weight = weight
        self._share = counts * np.repeat(weight / total, self._size)

    def mix(self, p: Array, contexts: Codes) -> None:
        """Let what followed ``contexts``, shape (R,), count in ``p``, shape (R, CLASSES)."""
        place = np.minimum(np.searchsorted(self._contexts, contexts), len(self._contexts) - 1)
        rows = np.flatnonzero(self._contexts[place] == contexts)
        if not len(rows):
            return
        place = place[rows]
        size = self._size[place]
        p[rows] *= 1.0 - self._weight[place][:, None]
        pairs = np.repeat(self._begin[place] - np.append(0, np.cumsum(size)[:-1]), size)
        pairs += np.arange(len(pairs))
        p[np.repeat(rows, size), self._following[pairs]] += self._share[pairs]  # no pair twice


class Contexts:
    """Where hypotheses stand in their texts: the last characters, the word so far, the word before.

    All are integer arrays of shape (H,).
    """

    __slots__ = ("before", "last", "word")

    def __init__(self, last: Codes, word: Codes, before: Codes) -> None:
        self.last, self.word, self.before = last, word, before

    @classmethod
    def start(cls, count: int) -> "Contexts":
        """At the beginning of a text, which is like the beginning of a sentence."""
        last, word, before = 0, 0, 0
        for byte in b". ":
            last, word, before = _after(last, word, before, byte - _FIRST)
        return cls(*(np.full(count, v, dtype=np.int64) for v in (last, word, before)))

    def take(self, rows: NDArray[np.intp]) -> "Contexts":
        """Those of some hypotheses."""
        return Contexts(self.last[rows], self.word[rows], self.before[rows])

    def after(self, values: NDArray[np.integer]) -> "Contexts":
        """After one more byte each."""
        c = class_of(values)
        last = (self.last * _BASE + c) & (_BASE ** ORDERS[-1] - 1)
        letter = _letters()[c]
        inside = letter >= 0
        word = np.where(inside, (self.word * _PRIME + letter + 1) & _MASK, 0)
        ended = ~inside & (self.word != 0)
        before = np.where(ended, self.word, np.where(inside | (c == SPACE), self.before, 0))
        return Contexts(last, word, before)


def _after(last: int, word: int, before: int, c: int) -> tuple[int, int, int]:
    """`Contexts.after` for one."""
    one = Contexts(*(np.array([v], dtype=np.int64) for v in (last, word, before)))
    code = c + _FIRST if c < OTHER else 0
    one = one.after(np.array([code]))
    return int(one.last[0]), int(one.word[0]), int(one.before[0])


class English:
    """The model.

    Parameters
    ----------
    text : bytes
        What it is counted from.
    listed : bytes
        Words by frequency: a class a line, its number and its words in order. Before each a capital
        letter says how many letters it has in common with the one before: A none, B one, ...
    """

    def __init__(self, text: bytes, listed: bytes) -> None:
        codes = class_of(np.frombuffer(text, dtype=np.uint8)).astype(np.int64)
        last = np.zeros(len(codes), dtype=np.int64)
        for back in range(1, ORDERS[-1] + 1):
            last[back:] += codes[:-back] * _BASE ** (back - 1)
        word, before = _words(codes)
        p = np.bincount(codes, minlength=CLASSES) + 0.05
        p[OTHER] = 0.0
        self._single = p / p.sum()
        self._levels = [Level(last % _BASE**n, codes) for n in ORDERS]
        self._listed = Level(*_spelt(listed), share=LISTED)
        word = _placed(word, last)
        self._word = Level(word, codes, strength=WORD_STRENGTH)
        self._pair = Level((before * _PRIME + word) & _MASK, codes)

    def next(self, at: Contexts) -> tuple[Array, NDArray[np.intp]]:
        """Probability of each next byte: rows, shape (R, 256), and whose is which, (H,)."""
        key = np.stack([at.last, at.word, at.before])
        distinct, back = np.unique(key, axis=1, return_inverse=True)
        last, word, before = distinct
        p = np.tile(self._single, (len(last), 1))
        for n, level in zip(ORDERS, self._levels, strict=True):
            level.mix(p, last % _BASE**n)
        self._listed.mix(p, np.where(word == 0, -1, word))  # it knows nothing of what words follow
        word = _placed(word, last)
        self._word.mix(p, word)
        self._pair.mix(p, (before * _PRIME + word) & _MASK)
        p *= 1 - ANY_BYTE
        out = np.tile((p[:, OTHER:] + ANY_BYTE) / 256, 256)
        out[:, _FIRST : _LAST + 1] += p[:, :OTHER]
        return out, back.reshape(-1)

    def last(self, p: Array) -> Array:
        """The same for a message's last byte, given :meth:`next` of it."""
        out: Array = (1 - CLOSED) * p
        for mark, share in MARKS:
            out[:, ord(mark)] += CLOSED * share
        return out


class AnyBytes:
    """The model of one who expects nothing: every byte is as likely."""

    def last(self, p: Array) -> Array:
        """Probability of a message's last byte, see :meth:`English.last`."""
        return p

    def next(self, at: Contexts) -> tuple[Array, NDArray[np.intp]]:
        """Probability of each next byte, see :meth:`English.next`."""
        return np.full((1, 256), 1 / 256), np.zeros(len(at.last), dtype=np.intp)


def _placed(word: Codes, last: Codes) -> Codes:
    """The word so far, and between words what stands there."""
    return np.where(word == 0, -2 - last % _BASE, word)


def _spelt(listed: bytes) -> tuple[Codes, Codes, Array]:
    """How the words of a list go on: the word so far, the next character, how often."""
    share: dict[tuple[int, int], float] = {}
    endings = [(ord(c) - _FIRST, p) for c, p in ENDINGS]
    for line in listed.decode("ascii").splitlines():
        number, words = line.split()
        often = 10.0 ** (-int(number) / CLASS)
        spelt = ""
        for shared, rest in re.findall(r"([A-Z])([a-z']*)", words):
            spelt = spelt[: ord(shared) - ord("A")] + rest
            word = 0
            for place, letter in enumerate(map(ord, spelt)):
                if place:
                    key = (word, letter - _FIRST)
                    share[key] = share.get(key, 0.0) + often
                word = (word * _PRIME + letter + 1) & _MASK
            for c, p in endings:
                share[word, c] = share.get((word, c), 0.0) + often * p
    pairs = np.array(list(share), dtype=np.int64)
    return pairs[:, 0], pairs[:, 1], np.array(list(share.values()))


def _words(codes: Codes) -> tuple[Codes, Codes]:
    """The word so far and the word before, as numbers, where each character stands."""
    letters = _letters()[codes].tolist()
    spaces = (codes == SPACE).tolist()
    words, befores = [], []
    word = before = 0
    for letter, space in zip(letters, spaces, strict=True):
        words.append(word)
        befores.append(before)
        if letter >= 0:
            word = (word * _PRIME + letter + 1) & _MASK
            continue
        if word:
            before, word = word, 0
        elif not space:
            before = 0
    return np.array(words, dtype=np.int64), np.array(befores, dtype=np.int64)


@cache
def _letters() -> Codes:
    """Of each class the letter, small and large alike, or an apostrophe; -1 for what is none."""
    out = np.full(CLASSES, -1, dtype=np.int64)
    for c in range(OTHER):
        character = chr(c + _FIRST).lower()
        if character.isalpha() or character == "'":
            out[c] = ord(character)
    return out


@cache
def _class_table() -> Codes:
    table = np.full(256, OTHER, dtype=np.int64)
    table[_FIRST : _LAST + 1] = np.arange(OTHER)
    return table


def class_of(values: NDArray[np.integer]) -> Codes:
    """The class of each byte."""
    out: Codes = _class_table()[values]
    return out


@cache
def english() -> English:
    """The model of the text that is shipped."""
    return English(*(lzma.decompress(path.read_bytes()) for path in (TEXT, WORDS)))


def log2_probability(model: English | AnyBytes, text: bytes) -> float:
    """Of a whole text, its length given."""
    total, at = 0.0, Contexts.start(1)
    for place, byte in enumerate(text, 1):
        p = model.next(at)[0]
        p = model.last(p) if place == len(text) else p
        total += float(np.log2(p[0, byte]))
        at = at.after(np.array([byte]))
    return total


def texts(model: English, prompts: Sequence[str], rng: np.random.Generator, size: int) -> list[str]:
    """Texts drawn from the model, to look at."""
    out = []
    for prompt in prompts:
        text, at = bytearray(prompt.encode()), Contexts.start(1)
        for byte in text:
            at = at.after(np.array([byte]))
        for _ in range(size):
            text.append(int(rng.choice(256, p=model.next(at)[0][0])))
            at = at.after(np.array([text[-1]]))
        out.append(bytes(text).decode("latin-1"))
    return out
