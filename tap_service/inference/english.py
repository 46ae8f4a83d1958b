"""How likely each next byte of a message is to one who expects English, or expects nothing.

An n-gram model with words: what follows is counted after the last one to five characters, after the
beginning of the word in a list of words by their frequency, then in a text, and after the beginning
of the word and the word before it, in a list of pairs and then in the text. A level that has seen
little leaves the rest to the one below it (Witten and Bell 1991). The counts are made from
``english.txt.xz``, ``words.txt.xz`` and ``pairs.txt.xz`` when they are first needed, which takes
two seconds, and kept for the next process; NOTICE says where the texts are from.
"""

import hashlib
import io
import lzma
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Final, Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Indices
from runtime.cache_folder import cache_folder
from runtime.files import PUBLIC_FILE, write_atomically

Codes = NDArray[np.int64]

TEXT: Final = Path(__file__).parent / "english.txt.xz"

WORDS: Final = TEXT.with_name("words.txt.xz")

PAIRS: Final = TEXT.with_name("pairs.txt.xz")

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

NO_WORD: Final = 0
"""Number of the word before, where none is known, as after a comma."""

SENTENCE: Final = 1
"""The same at the beginning of a sentence."""

LISTED: Final = 0.98
"""Share of the list's answer within a word over that of the last characters."""

FEWEST_OTHERS: Final = 0.05
"""Share of the words that follow another and are not on the list of pairs, at least."""

ENDINGS: Final = ((" ", 0.82), (",", 0.09), (".", 0.09))
"""What comes after a word of the list, and how often."""

CLOSED: Final = 0.4
"""Probability that a message closes with a mark of its own."""

MARKS: Final = ((".", 0.8), ("?", 0.1), ("!", 0.1))
"""These, and how often each."""

CLASS: Final = 5.0
"""Frequency classes of the lists in a decade."""


@dataclass(frozen=True, slots=True)
class Level:
    """What followed each context of one kind.

    Attributes
    ----------
    contexts : integer array, shape (C,)
        The contexts as numbers, in order.
    begin, size : integer arrays, shape (C,)
        Where a context's rows are among all.
    weight : array, shape (C,)
        Of what was counted after a context; the level below has the rest.
    following : integer array, shape (rows,)
        Classes of characters.
    share : array, shape (rows,)
        Their probabilities, times ``weight``.
    """

    contexts: Codes
    begin: Indices
    size: Indices
    weight: Array
    following: Codes
    share: Array

    @classmethod
    def counted(
        cls,
        contexts: Codes,
        following: Codes,
        weights: Array | None = None,
        *,
        strength: float = STRENGTH,
        below: Array | None = None,
    ) -> Self:
        """Count a text.

        Parameters
        ----------
        contexts, following : integer arrays, shape (N,)
            The context of each character of the text, as a number, and the character's class.
        weights : array, shape (N,), optional
            How often each; once where not given.
        strength : float
            Of the level below.
        below : array, shape (N,), optional
            Weight of the level below in each context; by ``strength`` and how many different
            characters were counted where not given.
        """
        known, packed = contexts, contexts
        if weights is not None or contexts.max() >= _MASK // _BASE:
            # hashes leave no room for the class beside them, nor for a place
            known, packed = np.unique(contexts, return_inverse=True)
        keys = packed * _BASE + following
        order = None if weights is None else _stable_order(keys)
        keys = np.sort(keys) if order is None else keys[order]
        at = np.flatnonzero(np.diff(keys, prepend=-1))
        if weights is None:
            counts = np.diff(at, append=len(keys)).astype(float)
        else:
            counts = np.add.reduceat(weights[order], at)
        pair_contexts = keys[at] // _BASE
        begin = np.flatnonzero(np.diff(pair_contexts, prepend=-1))
        found = pair_contexts[begin]
        if known is not contexts:
            found = known[found]
        size = np.diff(begin, append=len(at))
        total = np.add.reduceat(counts, begin)
        rest = strength * size if below is None else below[order][at][begin]
        weight = total / (total + rest)
        share = counts * np.repeat(weight / total, size)
        return cls(found, begin, size, weight, keys[at] % _BASE, share)

    def mix(self, p: Array, contexts: Codes) -> None:
        """Let what followed ``contexts``, shape (R,), count in ``p``, shape (R, CLASSES)."""
        place = np.minimum(np.searchsorted(self.contexts, contexts), len(self.contexts) - 1)
        rows = np.flatnonzero(self.contexts[place] == contexts)
        if not len(rows):
            return
        place = place[rows]
        size = self.size[place]
        p[rows] *= 1.0 - self.weight[place][:, None]
        pairs = np.repeat(self.begin[place] - np.append(0, np.cumsum(size)[:-1]), size)
        pairs += np.arange(len(pairs))
        p[np.repeat(rows, size), self.following[pairs]] += self.share[pairs]  # no pair twice


def _stable_order(keys: Codes) -> Codes:
    """What sorts small numbers, equal ones by place: a sort of both as one, faster than argsort."""
    bits = len(keys).bit_length()
    return np.sort(keys << bits | np.arange(len(keys))) & ((1 << bits) - 1)


def distinct(*columns: NDArray[np.integer]) -> tuple[Indices, Indices]:
    """The rows that differ, in order: where each is first, and which one is at each place."""
    order = np.lexsort(columns[::-1])
    new = np.zeros(len(order), dtype=bool)
    new[:1] = True
    for column in columns:
        ordered = column[order]
        new[1:] |= ordered[1:] != ordered[:-1]
    which = np.empty(len(order), dtype=np.intp)
    which[order] = np.cumsum(new) - 1
    return order[new], which


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
        at = cls(*(np.zeros(count, dtype=np.int64) for _ in cls.__slots__))
        for byte in b"e. ":
            at = at.after(np.full(count, byte))
        return at

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
        ended = np.where(inside | (self.word == 0), self.before, self.word)
        before = np.where(inside | (c == SPACE), ended, np.where(_stops()[c], SENTENCE, NO_WORD))
        return Contexts(last, word, before)


@dataclass(frozen=True, slots=True)
class English:
    """The model.

    Attributes
    ----------
    single : array, shape (CLASSES,)
        Probability of each class of characters, whatever was before.
    orders : tuple of Level
        What followed the last characters, for each of :data:`ORDERS`.
    listed, listed_pair : Level
        What follows the beginning of a word in the list of words, and in that of pairs.
    word, pair : Level
        The same in the text.
    """

    expects: ClassVar[str] = "English sentences"

    single: Array
    orders: tuple[Level, ...]
    listed: Level
    listed_pair: Level
    word: Level
    pair: Level

    @classmethod
    def counted(cls, text: bytes, listed: bytes, pairs: bytes) -> Self:
        """Count a text and two lists.

        Parameters
        ----------
        text : bytes
        listed : bytes
            Words by frequency: a class a line, its number and its words in order. Before each a
            capital letter says how many letters it has in common with the one before: A none, B
            one, ...
        pairs : bytes
            Words that follow others: a word a line, then how often it is followed by which, as a
            class and its words in order.
        """
        codes = class_of(np.frombuffer(text, dtype=np.uint8)).astype(np.int64)
        last = np.zeros(len(codes), dtype=np.int64)
        for back in range(1, ORDERS[-1] + 1):
            last[back:] += codes[:-back] * _BASE ** (back - 1)
        word, before = _words(codes)
        p = np.bincount(codes, minlength=CLASSES) + 0.05
        p[OTHER] = 0.0
        word = _placed(word, last)
        known = before != NO_WORD
        return cls(
            p / p.sum(),
            tuple(Level.counted(last % _BASE**n, codes) for n in ORDERS),
            *_word_levels(listed, pairs),
            Level.counted(word, codes, strength=WORD_STRENGTH),
            Level.counted(_paired(before, word)[known], codes[known]),
        )

    def next(self, at: Contexts) -> tuple[Array, NDArray[np.intp]]:
        """Probability of each next byte: rows, shape (R, 256), and whose is which, (H,)."""
        first, back = distinct(at.last, at.word, at.before)
        last, word, before = at.last[first], at.word[first], at.before[first]
        p = np.tile(self.single, (len(last), 1))
        for n, level in zip(ORDERS, self.orders, strict=True):
            level.mix(p, last % _BASE**n)
        self.listed.mix(p, np.where(word == 0, -1, word))  # it knows nothing of what words follow
        placed = _placed(word, last)
        self.word.mix(p, placed)
        begun = (word != 0) | (last % _BASE == SPACE)
        self.listed_pair.mix(p, np.where(begun, _paired(before, word), -1))
        self.pair.mix(p, _paired(before, placed))
        p *= 1 - ANY_BYTE
        out = np.tile((p[:, OTHER:] + ANY_BYTE) / 256, 256)
        out[:, _FIRST : _LAST + 1] += p[:, :OTHER]
        return out, back

    def last(self, p: Array) -> Array:
        """The same for a message's last byte, given :meth:`next` of it."""
        out: Array = (1 - CLOSED) * p
        for mark, share in MARKS:
            out[:, ord(mark)] += CLOSED * share
        return out


class AnyBytes:
    """The model of one who expects nothing: every byte is as likely."""

    expects: ClassVar[str] = "any bytes"

    def last(self, p: Array) -> Array:
        """Probability of a message's last byte, see :meth:`English.last`."""
        return p

    def next(self, at: Contexts) -> tuple[Array, NDArray[np.intp]]:
        """Probability of each next byte, see :meth:`English.next`."""
        return np.full((1, 256), 1 / 256), np.zeros(len(at.last), dtype=np.intp)


def _placed(word: Codes, last: Codes) -> Codes:
    """The word so far; between words the mark or the space there, and what the space is after."""
    c, mark = last % _BASE, last // _BASE % _BASE
    mark = np.where((c == SPACE) & (_letters()[mark] < 0), mark + 1, 0)
    return np.where(word == 0, -2 - c - _BASE * mark, word)


def _paired(before: Codes, word: Codes) -> Codes:
    """A number for the word before and where the next one stands; -1 where that is not known."""
    return np.where(before == NO_WORD, -1, (before * _PRIME + word) & _MASK)


class Spellings:
    """How each of many words is spelt, a row a character and one for each ending.

    Parameters
    ----------
    words : sequence of str
        Small letters and apostrophes.
    """

    def __init__(self, words: Sequence[str]) -> None:
        lengths = np.array([len(word) for word in words])
        endings = np.array([ord(c) - _FIRST for c, _ in ENDINGS])
        self.size = lengths + len(endings)
        self.begin = np.cumsum(self.size) - self.size
        rows = np.arange(self.size.sum())
        place = rows - np.repeat(self.begin, self.size)  # in its word
        ending = place - np.repeat(lengths, self.size)  # 0, 1, ... after the last letter
        inside = ending < 0
        letters = np.frombuffer("".join(words).encode("ascii"), dtype=np.uint8).astype(np.int64)
        self.following = endings[np.maximum(ending, 0)]
        self.following[inside] = letters - _FIRST
        self.share = np.array([p for _, p in ENDINGS])[np.maximum(ending, 0)]
        self.share[inside] = 1.0
        self.so_far = _so_far(self.following + _FIRST, np.where(ending <= 0, place, 0))
        self.whole = self.so_far[self.begin + lengths]
        self.so_far[~inside] = np.repeat(self.whole, len(endings))
        """Each word as a number."""

    def rows(self, words: Indices) -> Indices:
        """The rows of some words, one after the other."""
        size = self.size[words]
        rows: Indices = np.repeat(self.begin[words] - (np.cumsum(size) - size), size)
        return rows + np.arange(len(rows))


def _listed(listed: bytes) -> dict[str, float]:
    """The words of a list, and how often each is any word."""
    often: dict[str, float] = {}
    for line in listed.decode("ascii").splitlines():
        number, words = line.split()
        spelt = ""
        for shared, rest in re.findall(r"([A-Z])([a-z']*)", words):
            spelt = spelt[: ord(shared) - ord("A")] + rest
            often[spelt] = 10.0 ** (-int(number) / CLASS)
    total = sum(often.values())
    return {word: p / total for word, p in often.items()}


def _word_levels(listed: bytes, pairs: bytes) -> tuple[Level, Level]:
    """What follows the beginning of a word, and the same after the word before it."""
    often = _listed(listed)
    spelt, places = Spellings(list(often)), {word: i for i, word in enumerate(often)}
    weights = spelt.share * np.repeat(np.array(list(often.values())), spelt.size)
    which = np.unique(spelt.so_far, return_inverse=True)[1]
    begun = np.bincount(which, weights)  # how often words begin so
    inside = spelt.so_far != 0  # the list does not know what words follow
    alone = Level.counted(
        spelt.so_far[inside],
        spelt.following[inside],
        weights[inside],
        below=begun[which][inside] * (1 - LISTED) / LISTED,
    )
    first: list[int] = []
    second: list[int] = []
    p: list[float] = []
    others: list[float] = []
    for line in pairs.decode("ascii").splitlines():
        word, *items = line.split()
        begin, each = len(second), 0.0
        for item in items:
            if item.isdecimal():
                each = 10.0 ** (-int(item) / CLASS)
            else:
                second.append(places[item])
                p.append(each)
        size = len(second) - begin
        first += [places[word]] * size
        others += [max(1.0 - sum(p[begin:]), FEWEST_OTHERS)] * size
    followers = np.array(second)
    rows, size_of = spelt.rows(followers), spelt.size[followers]
    before = np.repeat(spelt.whole[first], size_of)
    # what else follows the word before begins as words do in general
    below: Array = np.repeat(np.array(others), size_of) * begun[which][rows]
    contexts = _paired(before, spelt.so_far[rows])
    weights = spelt.share[rows] * np.repeat(np.array(p), size_of)
    return alone, Level.counted(contexts, spelt.following[rows], weights, below=below)


def _so_far(letters: Codes, place: Indices) -> Codes:
    """The word so far, as a number, where so many letters of it were before."""
    out = np.zeros(len(letters), dtype=np.int64)
    for count in range(1, int(place.max()) + 1):
        rows = np.flatnonzero(place == count)
        out[rows] = (out[rows - 1] * _PRIME + letters[rows - 1] + 1) & _MASK
    return out


def _last(where: Flags) -> Indices:
    """The last place before each one at which it holds, or -1."""
    places = np.where(where, np.arange(len(where)), -1)
    out: Indices = np.append(-1, np.maximum.accumulate(places)[:-1])
    return out


def _words(codes: Codes) -> tuple[Codes, Codes]:
    """The word so far and the word before, as numbers, where each character stands."""
    letters = _letters()[codes]
    between = letters < 0
    words = _so_far(letters, np.arange(len(codes)) - 1 - _last(between))
    space = codes == SPACE
    after = np.where(space, words, np.where(_stops()[codes], SENTENCE, NO_WORD))
    known = _last(between & ~(space & (words == 0)))  # a space after a mark says nothing new
    return words, np.where(known < 0, SENTENCE, after[known])


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
def _stops() -> Flags:
    """Of each class whether it ends a sentence."""
    out = np.zeros(CLASSES, dtype=bool)
    out[[ord(mark) - _FIRST for mark, _ in MARKS]] = True
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
    """The model of the text that is shipped, as it was kept once it had been counted."""
    sources = [path.read_bytes() for path in (Path(__file__), TEXT, WORDS, PAIRS)]
    name = hashlib.sha256(b"".join(sources)).hexdigest()
    path = cache_folder("english") / f"{name}.npz"
    model = _kept(path)
    if model is None:
        model = English.counted(*map(lzma.decompress, sources[1:]))
        _keep(model, path)
    return model


SMALL: Final = {"begin": np.uint32, "size": np.uint8, "following": np.uint8}
"""What a level's integers are kept as: less than half of them is left."""


def _keep(model: English, path: Path) -> None:
    """Write a model in the place of earlier ones, if it can be written."""
    levels = (*model.orders, model.listed, model.listed_pair, model.word, model.pair)
    arrays: dict[str, Any] = {
        "single": model.single,
        "contexts_of": [len(level.contexts) for level in levels],
        "rows_of": [len(level.following) for level in levels],
    }
    for name in (field.name for field in fields(Level)):
        whole = np.concatenate([getattr(level, name) for level in levels])
        arrays[name] = whole.astype(SMALL.get(name, whole.dtype))
    out = io.BytesIO()
    np.savez(out, **arrays)
    with suppress(OSError):
        write_atomically(path, out.getvalue(), PUBLIC_FILE)
        for other in path.parent.glob("*.npz"):
            if other != path:
                other.unlink()


def _kept(path: Path) -> English | None:
    """The model that was written; None where there is none, or it is damaged."""
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            columns = []
            for name in (field.name for field in fields(Level)):
                whole = file[name].astype(np.int64) if name in SMALL else file[name]
                sizes = file["rows_of" if name in ("following", "share") else "contexts_of"]
                columns.append(np.split(whole, np.cumsum(sizes)[:-1]))
            levels = [Level(*level) for level in zip(*columns, strict=True)]
            return English(file["single"], tuple(levels[: len(ORDERS)]), *levels[len(ORDERS) :])
    except (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile):
        return None


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
