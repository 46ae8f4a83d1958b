"""How likely each next character of an English sentence is, or of a sentence in another language.

A text is counted after the last characters, after the word so far, and after the word before it;
of what was never seen after a context the more general one below it tells.

English is counted after the last one to five characters, after the beginning of the word in a list
of words by their frequency, then in a text, and after the beginning of the word and the word before
it, in a list of pairs and then in the text. The other languages are counted in lists of words alone
by their frequency. The counts are made from the shipped files when they are first needed, which
takes some seconds; NOTICE says where the texts and lists are from.
"""

import lzma
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Indices

Codes = NDArray[np.int64]

FIRST, LAST = 32, 126
CLASSES: Final = LAST - FIRST + 2
"""The printable characters of ASCII, and one class for all other bytes."""

OTHER: Final = CLASSES - 1

LONGEST: Final = 5
"""Characters before the next one that a context has at most."""

BASE: Final = 128
PRIME: Final = 1_000_003
MASK: Final = (1 << 61) - 1

STRENGTH: Final = 4.0
"""Of the level below, over Witten and Bell's own."""

SPACE: Final = 0

NO_WORD: Final = 0
"""Number of the word before, where none is known, as after a comma."""

SENTENCE: Final = 1
"""The same at the beginning of a sentence."""

STOPS: Final = ".?!"
"""Marks that end a sentence."""


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
        known, packed = np.unique(contexts, return_inverse=True)
        keys = packed * BASE + following
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        at = np.flatnonzero(np.diff(keys, prepend=-1))
        each = np.ones(len(keys)) if weights is None else weights[order]
        counts = np.add.reduceat(each, at)
        pair_contexts = keys[at] // BASE
        begin = np.flatnonzero(np.diff(pair_contexts, prepend=-1))
        size = np.diff(begin, append=len(at))
        total = np.add.reduceat(counts, begin)
        rest = strength * size if below is None else below[order][at][begin]
        weight = total / (total + rest)
        share = counts * np.repeat(weight / total, size)
        return cls(known[pair_contexts[begin]], begin, size, weight, keys[at] % BASE, share)

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


@dataclass(frozen=True, slots=True)
class Contexts:
    """Where texts stand, a row each: the last characters, the word so far, the word before.

    Attributes
    ----------
    last, word, before : integer arrays, shape (H,)
    """

    last: Codes
    word: Codes
    before: Codes

    @classmethod
    def start(cls, count: int) -> Self:
        """At the beginning of a text, which is like the beginning of a sentence."""
        at = cls(*(np.zeros(count, dtype=np.int64) for _ in range(3)))
        for byte in b"e. ":
            at = at.after(np.full(count, byte))
        return at

    def take(self, rows: Indices) -> Self:
        """Those of some rows."""
        return type(self)(self.last[rows], self.word[rows], self.before[rows])

    def after(self, values: NDArray[np.integer]) -> Self:
        """After one more byte each."""
        c = class_of(values)
        last = (self.last * BASE + c) & (BASE**LONGEST - 1)
        letter = letters()[c]
        inside = letter >= 0
        word = np.where(inside, (self.word * PRIME + letter + 1) & MASK, 0)
        ended = np.where(inside | (self.word == 0), self.before, self.word)
        before = np.where(inside | (c == SPACE), ended, np.where(stops()[c], SENTENCE, NO_WORD))
        return type(self)(last, word, before)

    def seen_as(self, classes: Codes) -> Self:
        """With each of the last characters taken for another class."""
        last = np.zeros_like(self.last)
        for place in range(LONGEST):
            last += classes[self.last // BASE**place % BASE] * BASE**place
        return type(self)(last, self.word, self.before)

    @property
    def placed(self) -> Codes:
        """The word so far; between words the mark or the space, and what the space is after."""
        c, mark = self.last % BASE, self.last // BASE % BASE
        mark = np.where((c == SPACE) & (letters()[mark] < 0), mark + 1, 0)
        return np.where(self.word == 0, -2 - c - BASE * mark, self.word)

    @property
    def paired(self) -> Codes:
        """A number for the word before and the place in the next; -1 where it is not known."""
        return paired(self.before, self.placed)


def paired(before: Codes, word: Codes) -> Codes:
    """A number for a word and what comes after it; -1 where the word is not known."""
    return np.where(before == NO_WORD, -1, (before * PRIME + word) & MASK)


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


Kind = Callable[[Contexts], Codes]
"""Which context of a text a level counts after."""


def order(count: int) -> Kind:
    """The last ``count`` characters."""
    return lambda at: at.last % BASE**count


def contexts_in(codes: Codes) -> Contexts:
    """Where each character of a text stands."""
    last = np.zeros(len(codes), dtype=np.int64)
    for back in range(1, LONGEST + 1):
        last[back:] += codes[:-back] * BASE ** (back - 1)
    between = letters()[codes] < 0
    words = so_far(letters()[codes], np.arange(len(codes)) - 1 - _last(between))
    space = codes == SPACE
    after = np.where(space, words, np.where(stops()[codes], SENTENCE, NO_WORD))
    known = _last(between & ~(space & (words == 0)))  # a space after a mark says nothing new
    return Contexts(last, words, np.where(known < 0, SENTENCE, after[known]))


def so_far(letters: Codes, place: Indices) -> Codes:
    """The word so far, as a number, where so many letters of it were before."""
    out = np.zeros(len(letters), dtype=np.int64)
    for count in range(1, int(place.max()) + 1):
        rows = np.flatnonzero(place == count)
        out[rows] = (out[rows - 1] * PRIME + letters[rows - 1] + 1) & MASK
    return out


def _last(where: Flags) -> Indices:
    """The last place before each one at which it holds, or -1."""
    places = np.where(where, np.arange(len(where)), -1)
    return np.append(-1, np.maximum.accumulate(places)[:-1])


@dataclass(frozen=True, slots=True)
class Counted:
    """A model of a text: levels of counts, the most general first.

    Attributes
    ----------
    single : array, shape (CLASSES,)
        Probability of each class of characters, whatever was before.
    levels : sequence of (Kind, Level)
    """

    single: Array
    levels: Sequence[tuple[Kind, Level]]

    @classmethod
    def of(cls, text: bytes, orders: int, seen_as: Codes | None = None) -> Self:
        """Count what follows the last characters in a text."""
        codes = class_of(np.frombuffer(text, dtype=np.uint8))
        codes = codes if seen_as is None else seen_as[codes]
        single = np.bincount(codes, minlength=CLASSES) + 0.05
        single[OTHER] = 0.0
        at = contexts_in(codes)
        kinds = [order(n) for n in range(1, orders + 1)]
        return cls(single / single.sum(), [(k, Level.counted(k(at), codes)) for k in kinds])

    def next(self, at: Contexts) -> Array:
        """Probability of each class of characters next, shape (H, CLASSES)."""
        p = np.tile(self.single, (len(at.last), 1))
        for kind, level in self.levels:
            level.mix(p, kind(at))
        return p


@cache
def letters() -> Codes:
    """Of each class the letter, small and large alike, or an apostrophe; -1 for what is none."""
    out = np.full(CLASSES, -1, dtype=np.int64)
    for c in range(OTHER):
        character = chr(c + FIRST).lower()
        if character.isalpha() or character == "'":
            out[c] = ord(character)
    return out


@cache
def stops() -> Flags:
    """Of each class whether it ends a sentence."""
    out = np.zeros(CLASSES, dtype=bool)
    out[[ord(mark) - FIRST for mark in STOPS]] = True
    return out


@cache
def _class_table() -> Codes:
    table = np.full(256, OTHER, dtype=np.int64)
    table[FIRST : LAST + 1] = np.arange(OTHER)
    return table


def class_of(values: NDArray[np.integer]) -> Codes:
    """The class of each byte."""
    found: Codes = _class_table()[values]
    return found


def class_named(character: str) -> int:
    """The class of a printable character."""
    return ord(character) - FIRST


TEXT: Final = Path(__file__).parent / "english.txt.xz"

WORDS: Final = TEXT.with_name("words.txt.xz")

PAIRS: Final = TEXT.with_name("pairs.txt.xz")

LANGUAGES: Final = TEXT.with_name("languages.txt.xz")

WORD_STRENGTH: Final = 12.0
"""Of the level below the beginning of a word, of which the list knows more than the text."""

LISTED: Final = 0.98
"""Share of the list's answer within a word over that of the last characters."""

FEWEST_OTHERS: Final = 0.05
"""Share of the words that follow another and are not on the list of pairs, at least."""

ENDINGS: Final = ((" ", 0.82), (",", 0.09), (".", 0.09))
"""What comes after a word of a list, and how often."""

CLASS: Final = 5.0
"""Frequency classes of the lists in a decade."""

DRAWN: Final = 6000
"""Words drawn from a language's list to count what follows the last characters."""


class Spellings:
    """How each of many words is spelt, a row a character and one for each ending.

    Parameters
    ----------
    words : sequence of str
        Small letters and apostrophes.
    """

    def __init__(self, words: Sequence[str]) -> None:
        lengths = np.array([len(word) for word in words])
        endings = np.array([ord(c) - FIRST for c, _ in ENDINGS])
        self.size = lengths + len(endings)
        self.begin = np.cumsum(self.size) - self.size
        rows = np.arange(self.size.sum())
        place = rows - np.repeat(self.begin, self.size)  # in its word
        ending = place - np.repeat(lengths, self.size)  # 0, 1, ... after the last letter
        inside = ending < 0
        letters = np.frombuffer("".join(words).encode("ascii"), dtype=np.uint8).astype(np.int64)
        self.following = endings[np.maximum(ending, 0)]
        self.following[inside] = letters - FIRST
        self.share = np.array([p for _, p in ENDINGS])[np.maximum(ending, 0)]
        self.share[inside] = 1.0
        self.so_far = so_far(self.following + FIRST, np.where(ending <= 0, place, 0))
        self.whole = self.so_far[self.begin + lengths]
        self.so_far[~inside] = np.repeat(self.whole, len(endings))
        """Each word as a number."""

    def rows(self, words: Indices) -> Indices:
        """The rows of some words, one after the other."""
        size = self.size[words]
        rows: Indices = np.repeat(self.begin[words] - (np.cumsum(size) - size), size)
        return rows + np.arange(len(rows))


class WordList:
    """A list of words and how each begins.

    Parameters
    ----------
    lines : sequence of str
        A frequency class a line, its number and its words in order. Before each a capital letter
        says how many letters it has in common with the one before: A none, B one, ...
    """

    def __init__(self, lines: Sequence[str]) -> None:
        often: dict[str, float] = {}
        for line in lines:
            number, words = line.split()
            spelt = ""
            for shared, rest in re.findall(r"([A-Z])([a-z']*)", words):
                spelt = spelt[: ord(shared) - ord("A")] + rest
                often[spelt] = 10.0 ** (-int(number) / CLASS)
        self.words = list(often)
        self.often = np.array(list(often.values())) / sum(often.values())
        self.spelt = spelt_as = Spellings(self.words)
        self.weights = spelt_as.share * np.repeat(self.often, spelt_as.size)
        which = np.unique(spelt_as.so_far, return_inverse=True)[1]
        self.begun = np.bincount(which, self.weights)[which]
        """Of each row how often words begin so."""

    def level(self) -> Level:
        """What follows the beginning of a word; of what words follow the list knows nothing."""
        inside = self.spelt.so_far != 0
        return Level.counted(
            self.spelt.so_far[inside],
            self.spelt.following[inside],
            self.weights[inside],
            below=self.begun[inside] * (1 - LISTED) / LISTED,
        )

    def pairs(self, lines: Sequence[str]) -> Level:
        """What follows the beginning of a word after the word before.

        Parameters
        ----------
        lines : sequence of str
            A word a line, then how often it is followed by which, as a class and its words.
        """
        places = {word: i for i, word in enumerate(self.words)}
        first: list[int] = []
        second: list[int] = []
        p: list[float] = []
        others: list[float] = []
        for line in lines:
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
        spelt, followers = self.spelt, np.array(second)
        rows, size_of = spelt.rows(followers), spelt.size[followers]
        before = np.repeat(spelt.whole[first], size_of)
        # what else follows the word before begins as words do in general
        below: Array = np.repeat(np.array(others), size_of) * self.begun[rows]
        contexts = paired(before, spelt.so_far[rows])
        weights = spelt.share[rows] * np.repeat(np.array(p), size_of)
        return Level.counted(contexts, spelt.following[rows], weights, below=below)


def _in_word(at: Contexts) -> Codes:
    """The word so far, where one is under way."""
    return np.where(at.word == 0, -1, at.word)


def _pair(at: Contexts) -> Codes:
    """The word before and the word so far, where one may begin."""
    begun = (at.word != 0) | (at.last % BASE == SPACE)
    return np.where(begun, paired(at.before, at.word), -1)


@cache
def english() -> Counted:
    """The model of English sentences."""
    text, listed, pairs = (lzma.decompress(path.read_bytes()) for path in (TEXT, WORDS, PAIRS))
    model, words = Counted.of(text, LONGEST), WordList(listed.decode("ascii").splitlines())
    codes = class_of(np.frombuffer(text, dtype=np.uint8))
    at = contexts_in(codes)
    known = at.before != NO_WORD
    levels = (
        (_in_word, words.level()),
        (lambda at: at.placed, Level.counted(at.placed, codes, strength=WORD_STRENGTH)),
        (_pair, words.pairs(pairs.decode("ascii").splitlines())),
        (lambda at: at.paired, Level.counted(at.paired[known], codes[known])),
    )
    return Counted(model.single, [*model.levels, *levels])


@cache
def languages() -> dict[str, Counted]:
    """Models of other languages, in small letters and without accents, by name."""
    lists: dict[str, list[str]] = {}
    for line in lzma.decompress(LANGUAGES.read_bytes()).decode("ascii").splitlines():
        if line[0].isalpha():
            lines = lists[line] = []
        else:
            lines.append(line)
    return {name: _language(WordList(lines)) for name, lines in lists.items()}


def _language(words: WordList) -> Counted:
    rng = np.random.default_rng(0)
    drawn = rng.choice(len(words.words), DRAWN, p=words.often)
    marks = rng.choice(len(ENDINGS), DRAWN, p=[p for _, p in ENDINGS])
    ends = [mark.strip() + " " for mark, _ in ENDINGS]
    text = "".join(words.words[i] + ends[j] for i, j in zip(drawn, marks, strict=True))
    model = Counted.of(text.encode("ascii"), 4)
    return Counted(model.single, [*model.levels, (_in_word, words.level())])
