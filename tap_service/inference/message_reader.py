"""All messages of a transcript, one after the other, each with its probability and what it leaves.

Steps as they were inferred become verdicts under the likely thresholds
(:mod:`tap_service.inference.thresholds`), verdicts and ciphertext symbols a lattice, and the
lattice is searched for one frame after another. What she claims for a message is its share of all
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
from tap_service.inference.expectation import Expectation
from tap_service.inference.inferred import InferredStep
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_search import BEAM, REFUTED, Found, MessageSearch
from tap_service.inference.thresholds import Cell, Interval, Run, likely_thresholds
from tap_service.inference.verdicts import made_of, verdicts_of

SURE: Final = 0.9
"""Probability from which a message counts as read."""

MOST_MESSAGES: Final = 64
"""Messages looked for in one stretch."""

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
    kind : str
        Which kind of text it is, or that it is not known.
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
    kind: str = ""


@dataclass(frozen=True)
class Stretch:
    """Transitions in a row as she reads them.

    Parameters
    ----------
    at : list of (str, int)
        Their sessions and steps.
    verdicts : array, shape (K, 1 + M)
        Probability of each step's verdict (none, symbol 0, 1, ...), the messages known.
    symbols : array, shape (K, 1 + M), optional
        Of the message symbol carried: none, 0, 1, ...; where the messages were looked at.
    """

    at: list[tuple[str, int]]
    verdicts: Array
    symbols: Array | None


class MessageReader:
    """Reads the messages of a transcript, again and again as it grows.

    Parameters
    ----------
    scheme : Scheme
    language : Expectation
    certain : bool
        Whether it is public that every step agrees.
    """

    def __init__(
        self,
        scheme: Scheme[Any],
        language: Expectation,
        *,
        certain: bool,
        beam: int = BEAM,
    ) -> None:
        self._table = StateTable(scheme)
        self._size = scheme.alphabet
        self._states = len(self._table.all_following())
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
        cells: list[Cell] = []
        out: list[Message] = []
        for run in runs:
            first = run.steps[0].transition
            last = after.get(first.session, -1)
            part = [s for s in run.steps if s.transition.k > last]
            if len(part) < 2 or all(s.transition.cipher is None for s in part):
                continue
            cells = cells or self._cells(runs, among)
            entry = self._entry(fresh=first.start and last < 0)
            out += self._stretch(Run(part, entry, run.made[-len(part) :]), cells)
        return out

    def _cells(self, runs: Sequence[Run], among: Interval) -> list[Cell]:
        """Thresholds that remain, in intervals with their shares."""
        if self._certain:
            return [(*among, 1.0)]
        return likely_thresholds(self._table, runs, among)

    def _entry(self, *, fresh: bool) -> Array:
        """Probability of each of the scheme's states, the initial one if ``fresh``."""
        return np.eye(self._states)[0] if fresh else np.full(self._states, 1 / self._states)

    def _stretch(self, run: Run, among: Sequence[Cell]) -> list[Message]:
        """The messages of transitions in a row."""
        steps, entry, made = run.steps, run.entry, run.made
        ciphers = np.array(
            [-1 if s.transition.cipher is None else s.transition.cipher for s in steps]
        )
        verdicts = self._verdicts(steps, among)
        lattice = Lattice(self._table, verdicts, ciphers, entry, made)
        search = MessageSearch(lattice, self._language, self._beam)
        begin = np.full((lattice.steps + 1, len(entry)), -np.inf)
        begin[0] = np.log(np.maximum(entry, TINY))
        out: list[Message] = []
        ks, session = [s.transition.k for s in steps], steps[0].transition.session
        for _ in range(MOST_MESSAGES):
            found = None if search.silent(begin) else search.find(begin)
            if found is None:
                break
            read = self._judge(found, lattice.none_after(begin), session, ks)
            if read is None:
                break
            message, begin = read
            out.append(message)
            if not message.whole:
                break
        self._room = len(steps)
        stream, waits = self._stream(out)
        aligned = align(self._table, verdicts, ciphers, entry, made, stream, waits)
        if aligned is not None:
            self.stretches.append(Stretch([(session, k) for k in ks], *aligned))
        return out

    def _verdicts(self, steps: Sequence[InferredStep], among: Sequence[Cell]) -> Array:
        """Probability of each step's verdict in each of the scheme's states."""
        # a state that holds a key holds that of the step before
        pads = self._table.pad[: self._states]
        out = np.zeros((len(steps), self._states, 1 + self._size))
        for low, high, share in among:
            alone, after = verdicts_of(steps, (low, high), self._size, certain=self._certain)
            out += share * np.where((pads >= 0)[:, None], after[:, pads], alone[:, None])
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

    def _judge(
        self, found: Found, none: float, session: str, ks: Sequence[int]
    ) -> tuple[Message, Array] | None:
        """What was found as a message and where it ends, or None where there is likely none."""
        parts = np.array([none, found.lost, found.open, *found.weights])
        p = np.exp(parts - float(np.logaddexp.reduce(parts)))
        if p[0] > 0.5:
            return None
        lost, under_way, listed = float(p[1]), float(p[2]), p[3:]
        left = -float((p[1:] * np.log2(np.maximum(p[1:], TINY))).sum())
        # what she does not have is worth at least as much as she can follow
        more = max(found.surprise - found.check, float(np.log2(self._beam)))
        left += lost * more + under_way * (more + found.unsent)
        refuted = lost > 0.5 and found.kept >= 1 - REFUTED
        left = found.longest if refuted or not np.isfinite(left) else min(left, found.longest)
        whole, due, probability = True, -1, 0.0
        if refuted or not (len(listed) or under_way > lost):
            payload, ends = found.unchecked, found.unchecked_ends
        elif float(listed.sum()) + lost >= under_way:
            payload, probability, ends = found.payloads[0], float(listed[0]), found.ends
        else:
            payload, ends, whole, due = found.under_way, found.ends, False, found.missing
        at = ends.max(axis=1)
        place = int(at.argmax()) if np.isfinite(at).any() else len(ks)
        k = ks[-1] if not whole else (ks[place - 1] if place else ks[0] - 1)
        message = Message(
            session,
            k,
            payload,
            probability,
            left,
            whole,
            int((listed > 1e-3 * listed.max(initial=0.0)).sum()),
            -1 if whole or due < 0 else ks[-1] + due,
            refuted,
            self._language.weighed([payload])[1][0]
            if probability > 0.5
            else self._language.named(found.kinds),
        )
        return message, ends
