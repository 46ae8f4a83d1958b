"""How likely each next character of an English sentence is, or of a sentence in another language.

English is counted after the last one to five characters, after the beginning of the word in a list
of words by their frequency, then in a text, and after the beginning of the word and the word before
it, in a list of pairs and then in the text. The other languages are counted in lists of words alone
by their frequency. The counts are made from the shipped files when they are first needed, which
takes some seconds; NOTICE says where the texts and lists are from.
"""

import lzma
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from protocol.arrays import Array, Indices
from tap_service.inference.counts import (
    BASE,
    FIRST,
    LONGEST,
    NO_WORD,
    SPACE,
    Codes,
    Contexts,
    Counted,
    Level,
    class_of,
    contexts_in,
    paired,
    so_far,
)

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
