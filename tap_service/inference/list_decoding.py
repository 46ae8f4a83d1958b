"""Every decoding that hidden thresholds leave possible, where the gauges of the steps are known.

A key is agreed when exactly one gauge is at most t_c and all are at most t_e. Over N steps the
gauges cut the range of t_c into at most 2N + 1 pieces, and within a piece every step comes out the
same. So the steps are decoded once for each piece, side by side, and what the pieces give is read
as frames. A frame whose check holds settles it; before that silence and the beginning of a text do.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Indices
from protocol.schemes.base import Scheme
from protocol.schemes.framing import (
    CHECK_BYTES,
    IDLE,
    LENGTH_BYTES,
    START,
    blocks,
    digits_of,
    frame_length,
)
from protocol.schemes.table import StateTable
from tap_service.inference.english import FIRST, LAST
from tap_service.inference.expectation import Expectation
from tap_service.inference.lattice import BEGINS, SHORT_SHARE
from tap_service.inference.message_reader import Message, Stretch
from tap_service.inference.verdicts import DOUBT, Inferred, InferredStep, Interval, Run, weights_of

DECODED: Final = 6000
"""Pairs of thresholds that are decoded; of more those that silence and frames speak for."""

MOST_DECODED: Final = 60_000
"""The same where silence and frames do not tell them apart."""

WEIGHED_PAIRS: Final = 900
"""Pairs that are weighed by silence and frames at once."""

SIDE: Final = 30
"""Values of t_c among these where t_e is hidden too."""

FAR_OFF: Final = 15.0
"""Log ratio behind the best at which a pair is left out."""

SHRUNK: Final = 0.5
"""Share of the pairs that may remain for the rest to be weighed anew."""

WEIGHED: Final = 32
"""Texts under way that are weighed."""

UNEXPECTED: Final = 1e-6
"""Probability of a symbol between messages that neither is idle nor begins one."""

REFUSED: Final = -25.0
"""Log ratio of a frame whose check does not hold: no end ever sends one."""

OUTSIDE: Final = -0.5
"""Log ratio of a step whose every gauge exceeds t_c: the disturbance would have left D_c."""

BEHIND: Final = 30.0
"""Log ratio behind the best up to which a decoding counts as one that is left."""

PRIME: Final = np.uint64(0x9E3779B97F4A7C15)
"""By which a sequence of symbols becomes a number."""

NOTHING: Final = -1
"""In the place of a symbol where none was carried."""

ANY_EDGE: Final = (0.0, np.inf)

PRINTABLE: Final = bytes(range(FIRST, LAST + 1))

Symbols = NDArray[np.int8]


class Parsed(NamedTuple):
    """What symbols say as frames.

    Parameters
    ----------
    score : float
        Log ratio to random symbols; text is not looked at.
    whole : list of (int, bytes)
        The messages whose check holds, and after how many symbols each ended.
    text : bytes
        What is known of the payload under way.
    missing : int
        Symbols that the frame under way lacks; 0 where none is.
    begun : int
        Symbols before the frame under way, or all.
    """

    score: float
    whole: list[tuple[int, bytes]]
    text: bytes = b""
    missing: int = 0
    begun: int = 0

    @property
    def newest(self) -> bytes:
        """The text under way, else the last that is whole."""
        return self.whole[-1][1] if self.whole and not self.missing else self.text


def parsed(symbols: bytes, size: int) -> Parsed:
    """Read symbols in range(M), a byte each, as idle ones and frames."""
    digits = bytes.maketrans(bytes(range(size)), b"0123456789abcdefghijklmnopqrstuvwxyz"[:size])
    written = symbols.translate(digits)  # as Python writes numbers to a base
    header = digits_of(LENGTH_BYTES, size)
    score, whole, at = 0.0, list[tuple[int, bytes]](), 0
    while True:
        start = symbols.find(START, at)
        idle = symbols[at:] if start < 0 else symbols[at:start]
        quiet = idle.count(IDLE)
        score += quiet * float(np.log(size * (1 - BEGINS)))
        score += (len(idle) - quiet) * float(np.log(size * UNEXPECTED))
        if start < 0:
            return Parsed(score, whole, begun=len(symbols))
        score += float(np.log(size * BEGINS))
        at = start + 1
        if at + header > len(symbols):
            return Parsed(score, whole, b"", at + header - len(symbols), start)
        length = int(written[at : at + header], size)
        at += header
        short = SHORT_SHARE if length < 256 else (1 - SHORT_SHARE) / 255
        score += float(np.log(256 * short))
        if not 0 < length < 256**LENGTH_BYTES:
            score += REFUSED
            continue
        end = start + frame_length(length, size)
        body = bytearray(length.to_bytes(LENGTH_BYTES, "big"))
        for count in islice(blocks(length + CHECK_BYTES, size), 1, None):
            number = written[at : at + digits_of(count, size)]
            if len(number) < digits_of(count, size):
                text = bytes(body[LENGTH_BYTES:])[:length]
                return Parsed(score + printable(text), whole, text, end - len(symbols), start)
            at += len(number)
            if int(number, size) >= 256**count:
                score += REFUSED
                break
            body += int(number, size).to_bytes(count, "big")
        else:
            head, check = bytes(body[:-CHECK_BYTES]), int.from_bytes(body[-CHECK_BYTES:], "big")
            score += printable(head[LENGTH_BYTES:])
            if zlib.crc32(head) == check:
                whole.append((at, head[LENGTH_BYTES:]))
                score += 8 * CHECK_BYTES * float(np.log(2))
            else:
                score += REFUSED


def printable(text: bytes) -> float:
    """Log ratio of a text, by how much of it is printable alone, to random bytes."""
    others = len(text.translate(None, PRINTABLE))
    gain = (len(text) - others) * float(np.log(256 * 0.98 / len(PRINTABLE)))
    return gain + others * float(np.log(256 * 0.02 / (256 - len(PRINTABLE))))


@dataclass(frozen=True)
class Heard:
    """Steps in a row as arrays.

    Parameters
    ----------
    nearest, second, largest : array, shape (K,)
        The two least gauges of each step and the largest; infinite where one was not heard whole.
    choice, cipher : integer array, shape (K,)
        The nearest candidate; -1 where the cipher was missed.
    fresh : bool array, shape (K,)
        Whether a session begins, or the transcript goes on behind a gap.
    """

    nearest: Array
    second: Array
    largest: Array
    choice: Indices
    cipher: Indices
    fresh: Flags

    @classmethod
    def of(cls, steps: Sequence[InferredStep], size: int) -> "Heard":
        """The same of inferred steps, which have one sample of gauges each, or none."""
        lost = np.full(size, np.inf)
        gauges = np.array([lost if s.samples is None else s.samples[0] for s in steps])
        ordered = np.sort(gauges, axis=1)
        heard = [s.transition for s in steps]
        return cls(
            ordered[:, 0],
            ordered[:, 1],
            ordered[:, -1],
            gauges.argmin(axis=1),
            np.array([-1 if t.cipher is None else t.cipher for t in heard]),
            np.array([t.start or t.gap for t in heard]),
        )


class ListDecoding:
    """Decodes steps of known gauges, again and again as they become more.

    Parameters
    ----------
    scheme : Scheme
    language : callable
        Gives what Eve expects of a text; asked where several texts are possible.
    certain : bool
        Whether it is public that every step agrees: then no threshold is searched.

    Attributes
    ----------
    among, edges : tuple of float
        t_c and t_e of the best decoding, from and to.
    peak : int
        Decodings that differed, at most so far.
    """

    def __init__(self, scheme: Scheme[Any], language: Any, *, certain: bool) -> None:
        self._table = StateTable(scheme)
        self._size, self._states = scheme.alphabet, len(self._table.all_following())
        self._language, self._certain = language, certain
        self._state = -1
        self._past = b""  # symbols of the frame that was under way before the first step
        self.among: Interval = (0.0, np.inf)
        self.edges: Interval = ANY_EDGE
        self.peak = 1
        self.stretches: list[Stretch] = []
        self._after = self._now = np.zeros(1, dtype=np.intp)
        self._missing = 0  # symbols that the frame under way, or its length, lacks

    # --- decoding ---------------------------------------------------------------------------------

    def read(self, found: Inferred, after: dict[str, int], edges: Interval) -> list[Message]:
        """The messages of the steps; of each session those that end ``after`` a step.

        t_c lies in ``found.among``, t_e in ``edges``.
        """
        steps = found.steps
        heard = Heard.of(steps, self._size)
        t_c, t_e = self.thresholds(heard, found.among, edges)
        while len(t_c) * len(t_e) > DECODED:
            pairs = len(t_c) * len(t_e)
            t_c, t_e = self._likely(steps, heard, t_c, t_e)
            if len(t_c) * len(t_e) > SHRUNK * pairs:
                t_c = _some(t_c, max(MOST_DECODED // len(t_e), 1))
                break
        rows, which, cells = self.decoded(heard, t_c, t_e, self.entry)
        read = [self._parsed(row, heard.fresh) for row in rows]
        score = np.array([one.score for one in read]) + self._inside(heard, which, cells)
        score += self._weighed(read, score)
        best = int(score.argmax())
        self.peak = max(self.peak, len(rows))
        mine = cells[which == best]
        self.among, self.edges = _hull(t_c, mine[:, 0]), _hull(t_e, mine[:, 1])
        self.stretches = [self._stretch(steps, heard, rows[best])]
        self._now, self._missing = self._after[best : best + 1], read[best].missing
        return self._messages(steps, rows[best], read[best], score, after)

    def ends(self, step: InferredStep) -> bool:
        """Whether the frame under way, or its length, ends with the next step.

        By the best decoding of what was read last. Also where the step tells apart thresholds that
        gave this decoding alike: then it is not known any more which of them is right.
        """
        heard = Heard.of([step], self._size)
        t_c, t_e = np.array([self.among[0]]), np.array([self.edges[0]])
        rows, _, _ = self.decoded(heard, t_c, t_e, self._now)
        self._now, symbol = self._after, int(rows[0, 0])
        if heard.fresh[0]:
            self._missing = 0
        low, high = self.among
        if any(low < gauge[0] < high for gauge in (heard.nearest, heard.second)):
            return True
        if symbol == NOTHING:
            return False
        if self._missing == 0:
            self._missing = digits_of(LENGTH_BYTES, self._size) if symbol == START else 0
            return False
        self._missing -= 1
        return self._missing == 0

    @property
    def entry(self) -> Indices:
        """States in which the first step may begin."""
        return np.arange(self._states) if self._state < 0 else np.array([self._state])

    def thresholds(self, heard: Heard, among: Interval, edges: Interval) -> tuple[Array, Array]:
        """Values of t_c and of t_e of which no two leave every step the same."""
        if self._certain:
            return np.zeros(1), np.zeros(1)
        t_e = heard.largest[np.isfinite(heard.largest)]
        t_e = np.append(edges[0], t_e[(t_e > edges[0]) & (t_e <= edges[1])])
        tells = heard.largest <= t_e.max()
        t_c = np.concatenate([heard.nearest[tells], heard.second[tells]])
        t_c = np.append(among[0], t_c[(t_c > among[0]) & (t_c <= among[1])])
        return np.unique(t_c), np.unique(t_e)

    def _likely(
        self, steps: Sequence[InferredStep], heard: Heard, t_c: Array, t_e: Array
    ) -> tuple[Array, Array]:
        """The thresholds about those under which silence and the heads of frames are likeliest."""
        some_e = _some(t_e, WEIGHED_PAIRS // min(len(t_c), SIDE))
        some_c = _some(t_c, WEIGHED_PAIRS // len(some_e))
        low, edge = (part.ravel() for part in np.meshgrid(some_c, some_e, indexing="ij"))
        agreed = (heard.nearest[:, None] <= low) & (low < heard.second[:, None])
        agreed &= heard.largest[:, None] <= edge
        verdicts = np.zeros((*agreed.shape, 1 + self._size))
        verdicts[..., 0] = ~agreed
        rows = np.arange(len(agreed))[:, None]
        verdicts[rows, np.arange(len(low)), 1 + heard.choice[:, None]] += agreed
        verdicts = (1 - DOUBT) * verdicts + DOUBT / (1 + self._size)
        weight = OUTSIDE * (heard.nearest[:, None] > low).sum(axis=0)
        begins = [0, *np.flatnonzero(heard.fresh[1:]) + 1, len(steps)]
        for first, last in pairwise(begins):
            known = 0 if heard.fresh[first] else (self._state if first == 0 else -1)
            entry = np.full(self._states, 1 / self._states)
            entry = entry if known < 0 else np.eye(self._states)[known]
            run = Run(steps[first:last], entry, np.ones(last - first))
            weight += weights_of(self._table, run, verdicts[first:last])
        best = weight > weight.max() - FAR_OFF
        return _about(t_c, some_c, low[best]), _about(t_e, some_e, edge[best])

    def decoded(
        self, heard: Heard, t_c: Array, t_e: Array, entry: Indices
    ) -> tuple[Symbols, Indices, Array]:
        """The decodings that differ, which of them each pair of thresholds gives, and the pairs.

        Symbols have shape (decodings, K). The first step begins in one of the states ``entry``.
        """
        pairs = np.array([(c, e, s) for c in t_c for e in t_e for s in entry])
        low, edge, state = pairs[:, 0], pairs[:, 1], pairs[:, 2].astype(np.intp)
        symbols = np.full((len(heard.cipher), len(pairs)), NOTHING, dtype=np.int8)
        number = np.zeros(len(pairs), dtype=np.uint64)  # of all symbols so far
        table, none = self._table, np.full(len(pairs), NOTHING)
        steps = zip(
            heard.nearest.tolist(), heard.second.tolist(), heard.largest.tolist(),
            heard.choice.tolist(), heard.cipher.tolist(), heard.fresh.tolist(), strict=True,
        )  # fmt: skip
        for k, (nearest, second, largest, choice, cipher, fresh) in enumerate(steps):
            if fresh:
                state = np.zeros_like(state)
            verdict = none
            if self._certain:
                verdict = np.full(len(pairs), choice)
            elif nearest < np.inf:
                agreed = (nearest <= low) & (low < second) & (largest <= edge)
                verdict = np.where(agreed, choice, NOTHING)
            pads = table.pad[state]
            value = IDLE if cipher < 0 else (cipher - pads) % self._size
            symbols[k] = np.where(pads == NOTHING, NOTHING, value)
            number = number * PRIME + symbols[k].astype(np.uint64)
            state = table.following(state, verdict).astype(np.intp)
        _, first, which = np.unique(number, return_index=True, return_inverse=True)
        self._after = state[first]
        return symbols[:, first].T, which.reshape(-1), pairs[:, :2]

    def _inside(self, heard: Heard, which: Indices, cells: Array) -> Array:
        """What the steps say that lie outside of D_c, by decoding."""
        nearest = np.sort(heard.nearest[np.isfinite(heard.nearest)])
        outside = len(nearest) - np.searchsorted(nearest, cells[:, 0], side="right")
        out = np.full(int(which.max()) + 1, -np.inf)
        np.maximum.at(out, which, 0.0 if self._certain else OUTSIDE * outside)
        return out

    def _parsed(self, row: Symbols, fresh: Flags) -> Parsed:
        """A decoding as frames; those of several sessions one after the other."""
        found = Parsed(0.0, [])
        edges = [0, *np.flatnonzero(fresh[1:]) + 1, len(row)]
        count = 0
        for begin, end in pairwise(edges):
            part = row[begin:end]
            symbols = part[part != NOTHING].tobytes()
            before = self._past if begin == 0 and not fresh[0] else b""
            now = parsed(before + symbols, self._size)
            moved = count - len(before)
            whole = [(at + moved, payload) for at, payload in now.whole]
            found = now._replace(
                score=found.score + now.score,
                whole=found.whole + whole,
                begun=now.begun + moved,
            )
            count += len(symbols)
        return found

    def _weighed(self, found: Sequence[Parsed], score: Array) -> Array:
        """What the newest texts add to the scores, log ratios to random bytes.

        That of a message that is whole too: else a rival whose text is under way would lead.
        """
        texts = [one.newest for one in found]
        out = np.zeros(len(score))
        if len(found) < 2 or not any(texts):
            return out
        language: Expectation = self._language()
        likely = dict.fromkeys(texts[i] for i in np.argsort(-score).tolist() if texts[i])
        chosen = list(likely)[:WEIGHED]
        bits, _ = language.weighed(chosen, ended=False)
        gain = dict(zip(chosen, bits + 8.0 * np.array([len(t) for t in chosen]), strict=True))
        for i, text in enumerate(texts):
            out[i] = np.log(2) * gain[text] - printable(text) if text in gain else 0.0
        return out

    def _messages(
        self,
        steps: Sequence[InferredStep],
        row: Symbols,
        found: Parsed,
        score: Array,
        after: dict[str, int],
    ) -> list[Message]:
        carriers = np.flatnonzero(row != NOTHING)
        out: list[Message] = []
        for end, payload in found.whole:
            t = steps[int(carriers[end - 1])].transition
            if t.k > after.get(t.session, -1):
                out.append(Message(t.session, t.k, payload, 1.0, 0.0, True, 1))
        if found.missing:
            t = steps[-1].transition
            share = np.exp(score - np.logaddexp.reduce(score))
            left = -float(share @ np.log2(np.maximum(share, 1e-300)))
            unsent = max(found.missing - digits_of(CHECK_BYTES, self._size), 0)
            left += unsent * float(np.log2(self._size))
            rivals = int((score > score.max() - BEHIND).sum())
            due = t.k + found.missing
            sure = float(share.max())
            out.append(Message(t.session, t.k, found.text, sure, left, False, rivals, due))
        return out

    def _stretch(self, steps: Sequence[InferredStep], heard: Heard, row: Symbols) -> Stretch:
        """The steps under the thresholds of the best decoding."""
        count, size = len(steps), self._size
        agreed = heard.nearest <= self.among[0]
        agreed &= (self.among[0] < heard.second) & (heard.largest <= self.edges[0])
        known = np.isfinite(heard.nearest)
        sure = np.where(agreed | self._certain, 1.0 - DOUBT, DOUBT)
        verdicts = np.full((count, 1 + size), 1.0 / (1 + size))
        verdicts[known, 0], verdicts[known, 1:] = 1.0 - sure[known], 0.0
        verdicts[known, 1 + heard.choice[known]] = sure[known]
        symbols = np.zeros((count, 1 + size))
        symbols[np.arange(count), 1 + row.astype(np.intp)] = 1.0
        at = [(s.transition.session, s.transition.k) for s in steps]
        return Stretch(at, verdicts, symbols)

    # --- what is let go ---------------------------------------------------------------------------

    def let_go(self, steps: Sequence[InferredStep]) -> None:
        """Take the best decoding of the first steps of what was read last for granted."""
        heard = Heard.of(steps, self._size)
        t_c, t_e = np.array([self.among[0]]), np.array([self.edges[0]])
        rows, _, _ = self.decoded(heard, t_c, t_e, self.entry)
        read = [self._parsed(row, heard.fresh) for row in rows]
        best = int(np.argmax([one.score for one in read]))
        past = b"" if heard.fresh[0] else self._past
        symbols = past + rows[best][rows[best] != NOTHING].tobytes()
        self._past = symbols[len(past) + read[best].begun :]
        self._state = int(self._after[best])

    def forget(self) -> None:
        """What comes next goes on from where is not known."""
        self._state, self._past = -1, b""


def _some(values: Array, most: int) -> Array:
    if len(values) <= most:
        return values
    at = np.unique(np.linspace(0, len(values) - 1, most).astype(int))
    found: Array = values[at]
    return found


def _about(values: Array, some: Array, best: Array) -> Array:
    """The ``values`` from below the least of ``best`` to above the largest, as ``some`` tells."""
    low = np.searchsorted(some, best.min()) - 1
    high = np.searchsorted(some, best.max()) + 1
    first = some[max(low, 0)]
    last = some[high] if high < len(some) else values[-1]
    found: Array = values[(values >= first) & (values <= last)]
    return found


def _hull(values: Array, best: Array) -> Interval:
    """From the least of ``best`` to the value after the largest."""
    high = int(np.searchsorted(values, best.max(), side="right"))
    return float(best.min()), float(values[high]) if high < len(values) else np.inf
