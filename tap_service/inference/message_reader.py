"""All messages of a transcript, one after the other, each with its probability and what it leaves.

Steps as they were inferred become verdicts under the likely thresholds
(:mod:`tap_service.inference.verdicts`), verdicts and ciphertext symbols a lattice, and the
lattice is searched for one frame after another. What she claims for a message is its share of all
that she considers: the others on the list, those that the search let go, messages of any bytes
whatever, one that is still under way, and none at all. A step of which she did not hear whether it
was made may be none.

Once the messages are known, or taken for known, keys and message symbols follow step by step
(:func:`align`): forwards and backwards over the steps, with how much of the messages was carried.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from protocol.arrays import Array, Integers
from protocol.schemes.base import Scheme
from protocol.schemes.framing import IDLE, START, encode_frame
from protocol.schemes.table import StateTable
from tap_service.capture.transcript import transitions_in_a_row
from tap_service.inference.expectation import Expectation
from tap_service.inference.lattice import BEGINS, Lattice
from tap_service.inference.message_search import BEAM, REFUTED, Found, MessageSearch
from tap_service.inference.verdicts import (
    Cell,
    InferredStep,
    Interval,
    Run,
    likely_thresholds,
    made_of,
    verdicts_of,
)

MOST_CELLS: Final = 12_000_000
"""Steps times states times symbols at most; with more, nothing is aligned."""

TINY: Final = 1e-300


def align(
    table: StateTable,
    verdicts: Array,
    ciphers: Integers,
    entry: Array,
    made: Array,
    stream: Array,
    waits: Integers,
) -> tuple[Array, Array] | None:
    """Posteriors of every step's verdict and symbol, or None where there is too much.

    Parameters
    ----------
    table : StateTable
    verdicts : array, shape (K, E, 1 + M)
        Of each step in each state of the scheme, without the messages.
    ciphers : integer array, shape (K,)
        -1 where one was missed.
    entry : array, shape (E,)
        Probability of the scheme's state before the first step.
    made : array, shape (K,)
        Probability that the plant took each step's offer; else the scheme stands still.
    stream : array, shape (P, M)
        Probability of each symbol of the messages, one after the other.
    waits : integer array
        Places in the stream, 0 to P, before which idle symbols may be carried.

    Returns
    -------
    verdicts : array, shape (K, 1 + M)
    symbols : array, shape (K, 1 + M)
        Of the message symbol carried: none, 0, 1, ...
    """
    K, M, E, P = len(verdicts), verdicts.shape[2] - 1, len(entry), len(stream)
    if K * E * (P + 1) > MOST_CELLS:
        return None
    idles = np.zeros(P + 1)
    idles[waits] = 1 - BEGINS
    begins = np.ones(P)
    begins[waits[waits < P]] = BEGINS
    pads = table.pad[:E]
    after = table.all_following()
    carried = [begins * stream[:, m] * M for m in range(M)]
    whole = begins * stream.sum(axis=1)

    def moved(f: Array, e: int, k: int) -> Array:
        """Weights by what was carried, after step k in state e."""
        if pads[e] < 0:
            return f
        c = int(ciphers[k])
        g = np.zeros_like(f)
        if c < 0:
            g[1:] = f[:-1] * whole
            return g + f * idles
        m = (c - int(pads[e])) % M
        g[1:] = f[:-1] * carried[m]
        return g + f * idles * M if m == IDLE else g

    F = np.zeros((K + 1, E, P + 1))
    F[0, :, 0] = entry
    for k in range(K):
        for e in range(E):
            if not F[k, e].any():
                continue
            g = made[k] * moved(F[k, e], e, k)
            F[k + 1, e] += (1 - made[k]) * F[k, e]
            for v in range(M + 1):
                F[k + 1, after[e, v]] += verdicts[k, e, v] * g
        F[k + 1] /= max(F[k + 1].max(), TINY)
    back = np.ones((E, P + 1))
    out, symbols = np.zeros((K, M + 1)), np.zeros((K, M + 1))
    for k in range(K - 1, -1, -1):
        mixed = np.einsum("ev,evp->ep", verdicts[k], back[after])
        before = np.zeros_like(back)
        for e in range(E):
            still = (1 - made[k]) * float(F[k, e] @ back[e])  # no offer was taken
            out[k, 0] += still
            symbols[k, 0] += still
            gain = made[k] * verdicts[k, e] * (back[after[e]] @ moved(F[k, e], e, k))
            out[k] += gain
            c = int(ciphers[k])
            if pads[e] < 0:
                symbols[k, 0] += gain.sum()
                before[e] = mixed[e]
            elif c >= 0:
                m = (c - int(pads[e])) % M
                symbols[k, 1 + m] += gain.sum()
                before[e, :-1] = carried[m] * mixed[e, 1:]
                before[e] += idles * M * mixed[e] * (m == IDLE)
            else:
                step = F[k, e, :-1] * begins * mixed[e, 1:]
                symbols[k, 1:] += made[k] * (step @ stream)
                symbols[k, 1 + IDLE] += made[k] * float((F[k, e] * idles * mixed[e]).sum())
                before[e, :-1] = whole * mixed[e, 1:]
                before[e] += idles * mixed[e]
            before[e] = made[k] * before[e] + (1 - made[k]) * back[e]
        back = before / max(before.max(), TINY)
        out[k] /= max(out[k].sum(), TINY)
        symbols[k] /= max(symbols[k].sum(), TINY)
    if not (out.sum(axis=1) > 0.5).all():
        return None
    return out, symbols


SURE: Final = 0.9
"""Probability from which a message counts as read."""

MOST_MESSAGES: Final = 64
"""Messages looked for in one stretch."""


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
