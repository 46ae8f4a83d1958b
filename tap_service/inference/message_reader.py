"""All messages of a transcript, one after the other, each with its probability and what it leaves.

Steps as they were inferred become verdicts under each likely threshold
(:mod:`tap_service.inference.thresholds`), verdicts and ciphertext symbols a lattice, and the
lattices are searched for one frame after another. What she claims for a message is its share of all
that she considers: the others on the list, those that the search let go, messages of any bytes
whatever, one that is still under way, and none at all. A step of which she did not hear whether it
was made may be none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from protocol.arrays import Array, Integers
from protocol.schemes.base import Scheme
from protocol.schemes.framing import START, encode_frame
from protocol.schemes.table import StateTable
from tap_service.capture.transcript import transitions_in_a_row
from tap_service.inference.alignment import align
from tap_service.inference.english import AnyBytes, English
from tap_service.inference.inferred import InferredStep
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_search import BEAM, REFUTED, Found
from tap_service.inference.message_sets import SharedSearch
from tap_service.inference.thresholds import Interval, Run, likely_thresholds
from tap_service.inference.verdicts import made_of, verdicts_of

NOT_TEXT: Final = 0.02
"""Probability that a message is of any bytes at all."""

SURE: Final = 0.9
"""Probability from which a message counts as read."""

MISSED: Final = 0.05
"""Probability that the search let the message go, from which it is searched more widely."""

WIDER: Final = (4,)
"""Times as many hypotheses are then followed."""

MOST_MESSAGES: Final = 64
"""Messages looked for in one stretch."""

SLIGHT: Final = 0.01
"""Probability of thresholds up to which steps are not aligned by them."""

TINY: Final = 1e-300


@dataclass(frozen=True)
class Message:
    """One message as she has it.

    Parameters
    ----------
    session : str
    k : int
        The step at which it ends, or the last one where it is under way.
    payload : bytes
        The likeliest.
    probability : float
        That this is it, whole.
    bits_left : float
        Entropy of it, given all that she heard.
    whole : bool
        Whether it is more likely whole than under way.
    rivals : int
        Messages on her list that have a thousandth of the likeliest one's weight.
    due_k : int
        The step at which one under way should end, or -1.
    refuted : bool
        Whether no message that she takes for possible has its check, so that what she takes the
        steps for is wrong somewhere.
    """

    session: str
    k: int
    payload: bytes
    probability: float
    bits_left: float
    whole: bool
    rivals: int
    due_k: int = -1
    refuted: bool = False


@dataclass(frozen=True)
class Stretch:
    """Transitions in a row as she reads them.

    Parameters
    ----------
    session : str
    ks : list of int
        Their steps.
    verdicts : array, shape (K, 1 + M)
        Probability of each step's verdict (none, symbol 0, 1, ...), the messages known.
    symbols : array, shape (K, 1 + M)
        Of the message symbol carried: none, 0, 1, ...
    """

    session: str
    ks: list[int]
    verdicts: Array
    symbols: Array


@dataclass(frozen=True)
class _Judged:
    """What a search's findings come to.

    Parameters
    ----------
    message : Message
    ends : array, shape (intervals, K + 1, E)
        Log weight that it ends at each node.
    searching : bool
        Whether a wider search may find more.
    any : float
        Probability that it is of any bytes, among which was not searched.
    """

    message: Message
    ends: Array
    searching: bool
    any: float


@dataclass(frozen=True)
class _Shares:
    """Of all that may come next, how likely each is.

    Parameters
    ----------
    none : float
        Nothing.
    any : float
        A message of any bytes, among which was not searched.
    lost, open : array, shape (searches,)
        A message that the search let go; one that is under way.
    listed : array, shape (N,)
        The messages found, likeliest first.
    payloads : list of bytes
        They.
    best : int
        Which search found the likeliest.
    """

    none: float
    any: float
    lost: Array
    open: Array
    listed: Array
    payloads: list[bytes]
    best: int

    @classmethod
    def of(cls, founds: Sequence[Found], none: float) -> "_Shares":
        """By what was found among texts, then among all bytes, and the log weight of nothing."""
        listed: dict[bytes, float] = {}
        lost, opened, top = [], [], []
        priors = np.log([1 - NOT_TEXT, NOT_TEXT]).tolist()
        for f, prior in zip(founds, priors, strict=False):
            lost.append(f.lost + prior)
            opened.append(f.open + prior)
            top.append(float(f.weights.max(initial=-np.inf)) + prior)
            for payload, weight in zip(f.payloads, (f.weights + prior).tolist(), strict=True):
                listed[payload] = float(np.logaddexp(listed.get(payload, -np.inf), weight))
        payloads = sorted(listed, key=lambda one: -listed[one])
        other = founds[0].any + priors[1] if len(founds) == 1 else -np.inf
        parts = np.array([none, other, *lost, *opened, *(listed[one] for one in payloads)])
        p = np.exp(parts - float(np.logaddexp.reduce(parts)))
        none, other = p[:2].tolist()
        its_lost, its_open, its_listed = np.split(p[2:], [len(lost), 2 * len(lost)])
        return cls(none, other, its_lost, its_open, its_listed, payloads, int(np.argmax(top)))

    @property
    def entropy(self) -> float:
        """In bits, of which it is, but for whether it is none."""
        p = np.concatenate([[self.any], self.lost, self.open, self.listed])
        return -float((p * np.log2(np.maximum(p, TINY))).sum())


class MessageReader:
    """Reads the messages of a transcript, again and again as it grows.

    Parameters
    ----------
    scheme : Scheme
    language : English or AnyBytes
    certain : bool
        Whether it is public that every step agrees.
    """

    def __init__(
        self,
        scheme: Scheme[Any],
        language: English | AnyBytes,
        *,
        certain: bool,
        beam: int = BEAM,
    ) -> None:
        self._table = StateTable(scheme)
        self._size = scheme.alphabet
        self._states = _close(self._table)
        self._language, self._certain, self._beam = language, certain, beam
        self._room = 0
        self.stretches: list[Stretch] = []
        """What was read last."""

    def read(
        self, steps: Sequence[InferredStep], among: Interval, after: dict[str, int]
    ) -> list[Message]:
        """The messages of ``steps``; of each session those that begin ``after`` a step."""
        self.stretches = []
        by_step = {id(s.transition): s for s in steps}
        runs = [
            Run([by_step[id(t)] for t in run], self._entry(fresh=run[0].start), made_of(run))
            for run in transitions_in_a_row([s.transition for s in steps])
            if any(t.cipher is not None for t in run)
        ]
        intervals: list[Interval] = []
        out: list[Message] = []
        for run in runs:
            first = run.steps[0].transition
            last = after.get(first.session, -1)
            part = [s for s in run.steps if s.transition.k > last]
            if len(part) < 2 or all(s.transition.cipher is None for s in part):
                continue
            intervals = intervals or self._intervals(runs, among)
            entry = self._entry(fresh=first.start and last < 0)
            out += self._stretch(Run(part, entry, run.made[-len(part) :]), intervals)
        return out

    def _intervals(self, runs: Sequence[Run], among: Interval) -> list[Interval]:
        """Those of thresholds that remain."""
        return [among] if self._certain else likely_thresholds(self._table, runs, among)

    def _entry(self, *, fresh: bool) -> Array:
        """Probability of each of the scheme's states, the initial one if ``fresh``."""
        return np.eye(self._states)[0] if fresh else np.full(self._states, 1 / self._states)

    def _stretch(self, run: Run, intervals: Sequence[Interval]) -> list[Message]:
        """The messages of transitions in a row."""
        steps, entry, made = run.steps, run.entry, run.made
        ciphers = np.array(
            [-1 if s.transition.cipher is None else s.transition.cipher for s in steps]
        )
        verdicts = [self._verdicts(steps, among) for among in intervals]
        lattices = [Lattice(self._table, one, ciphers, entry, made) for one in verdicts]
        search = SharedSearch(lattices, self._beam)
        widths = np.array([high - low for low, high in intervals])
        begin = search.begin(entry, widths / widths.sum())
        out: list[Message] = []
        ks, session = [s.transition.k for s in steps], steps[0].transition.session
        for _ in range(MOST_MESSAGES):
            if search.silent(begin):
                break
            read = self._next(search, begin, session, ks)
            if read is None:
                break
            message, ends = read
            out.append(message)
            if not message.whole:
                break
            begin = ends
        self._room = len(steps)
        stream, waits = self._stream(out)
        aligned = [
            (share, found)
            for share, one in zip(search.shares(begin), verdicts, strict=True)
            if share > SLIGHT
            and (found := align(self._table, one, ciphers, entry, made, stream, waits)) is not None
        ]
        if aligned:
            whole = sum(share for share, _ in aligned)
            both = (sum(p * found[i] for p, found in aligned) / whole for i in range(2))
            self.stretches.append(Stretch(session, ks, *both))
        return out

    def _verdicts(self, steps: Sequence[InferredStep], among: Interval) -> Array:
        """Probability of each step's verdict in each of the scheme's states."""
        alone, after = verdicts_of(steps, among, self._size, certain=self._certain)
        # a state that holds a key holds that of the step before
        pads = self._table.pad[: self._states]
        out: Array = np.where((pads >= 0)[:, None], after[:, pads], alone[:, None])
        return out

    def _stream(self, messages: Sequence[Message]) -> tuple[Array, Integers]:
        """The symbols of messages, as sure as she is of them, and where silence may be."""
        size, parts, waits = self._size, [np.empty((0, self._size))], [0]
        for message in messages:
            if message.whole:
                symbols = np.frombuffer(encode_frame(message.payload, size), dtype=np.uint8)
            else:
                symbols = np.full(self._room, START, dtype=np.uint8)
            rows = np.full((len(symbols), size), 1 / size)
            if message.whole and message.probability > 0.5:
                rows *= 1 - message.probability
                rows[np.arange(len(symbols)), symbols] += message.probability
            rows[0] = np.arange(size) == START
            parts.append(rows)
            waits.append(waits[-1] + len(symbols))
        if messages and not messages[-1].whole:
            waits.pop()
        return np.concatenate(parts), np.array(waits)

    def _next(
        self, search: SharedSearch, begin: Array, session: str, ks: Sequence[int]
    ) -> tuple[Message, Array] | None:
        """The message that comes next and where it ends, or None where there is likely none.

        Searched more widely where it may have been let go, and among all bytes where it is no text.
        """
        found = search.find(begin, self._language, self._beam)
        if found is None:
            return None

        def judged(*founds: Found) -> _Judged | None:
            return self._judge(search, begin, founds, session, ks)

        read = judged(found)
        for wider in WIDER:
            if read is None or not read.message.whole or not read.searching:
                break
            if read.message.probability >= SURE:
                break
            again = search.find_wider(begin, self._language, wider * self._beam)
            assert again is not None
            better = judged(again)
            if better is not None and better.message.probability >= read.message.probability:
                found, read = again, better
        if read is not None and read.any > 0.5:
            among_all = search.find(begin, AnyBytes(), self._beam)
            assert among_all is not None
            read = judged(found, among_all)
        return None if read is None else (read.message, read.ends)

    def _judge(
        self,
        search: SharedSearch,
        begin: Array,
        founds: Sequence[Found],
        session: str,
        ks: Sequence[int],
    ) -> _Judged | None:
        """What was found as a message, or None where there is likely none.

        Parameters
        ----------
        founds : sequence of Found
            By her language, and among all bytes where these were searched.
        """
        shares = _Shares.of(founds, search.none_after(begin))
        if shares.none > 0.5:
            return None
        texts = int(isinstance(self._language, English))  # the other one is among all bytes
        missing, any_bytes, left = 1.0 - float(shares.listed.sum()), None, shares.entropy
        if missing > 1e-9:
            any_bytes = search.any_bytes(begin, np.random.default_rng(0))
            # what she does not have is worth at least as much as she can follow
            followed = float(np.log2(search.beam))
            any_left = max(any_bytes.bits_left, followed)
            left += float(shares.any + (shares.lost + shares.open)[texts:].sum()) * any_left
            for f, lost, under_way in zip(founds[:texts], shares.lost, shares.open, strict=False):
                more = min(max(f.surprise, followed), any_left)
                left += float(lost * more + under_way * (more + f.unsent))
        likeliest, longest = founds[0], founds[0].longest
        refuted = bool(shares.lost[0] > 0.5 and likeliest.kept >= 1 - REFUTED)
        left = min(left, longest) if np.isfinite(left) and not refuted else longest
        p = shares.listed
        whole, due, probability = True, -1, 0.0
        if refuted:
            payload, ends = likeliest.unchecked, likeliest.unchecked_ends
        elif any_bytes is not None and (
            shares.any + float((shares.lost + shares.open)[texts:].sum()) > 0.5
        ):
            payload, ends = any_bytes.payload, any_bytes.ends
            whole, due = not any_bytes.missing, any_bytes.missing
        elif len(p) and float(p.sum() + shares.lost.sum()) >= shares.open.sum():
            payload, probability = shares.payloads[0], float(p[0])
            ends = founds[shares.best].ends
        else:
            payload, ends = likeliest.under_way, likeliest.ends
            whole, due = False, likeliest.missing
        at, last = ends.max(axis=(0, 2)), ks[-1]
        place = int(at.argmax()) if np.isfinite(at).any() else len(ks)
        k = ks[place - 1] if place else ks[0] - 1
        message = Message(
            session,
            k if whole else last,
            payload,
            probability,
            left,
            whole,
            int((p > 1e-3 * p.max()).sum()) if len(p) else 0,
            -1 if whole or due < 0 else last + due,
            refuted,
        )
        searching = bool(shares.lost.sum() > MISSED) and not refuted
        return _Judged(message, ends, searching, shares.any)


def _close(table: StateTable) -> int:
    """Number all states of a scheme; how many there are."""
    known = 1
    while True:
        following = [
            int(table.following(np.array([e]), np.array([v]))[0])
            for e in range(known)
            for v in range(-1, table.scheme.alphabet)
        ]
        if max(following) + 1 <= known:
            return known
        known = max(following) + 1
