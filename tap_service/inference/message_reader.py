"""All messages of a transcript, one after the other, each with its probability and what it leaves.

Steps as they were inferred become verdicts, verdicts and ciphertext symbols a lattice, and the
lattice is searched for one frame after another. What she claims for a message is its share of all
that she considers: the others on the list, those that the search let go, messages of any bytes
whatever, one that is still under way, and none at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from protocol.arrays import Array, Integers
from protocol.schemes.base import Scheme
from protocol.schemes.framing import CHECK_BYTES, START, encode_frame
from protocol.schemes.table import StateTable
from tap_service.capture.transcript import steps_in_a_row
from tap_service.inference.alignment import align
from tap_service.inference.english import AnyBytes, English
from tap_service.inference.gap_smoother import InferredStep
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_search import BEAM, REFUTED, Found, MessageSearch

NOT_TEXT: Final = 0.02
"""Probability that a message is of any bytes at all."""

SURE: Final = 0.9
"""Probability from which a message counts as read."""

MISSED: Final = 0.05
"""Probability that the search let the message go, from which it is searched more widely."""

WIDER: Final = (4,)
"""Times as many hypotheses are then followed."""

LIKE_ALONE: Final = 10.0
"""Trajectories that are added, where a step is looked at after another, as it is alone."""

DOUBT: Final = 1e-4
"""Probability that a step's verdict is another where nothing seems to speak for it."""

PSEUDO: Final = 0.25
"""Trajectories that are added to those drawn, spread over all verdicts."""

MOST_MESSAGES: Final = 64
"""Messages looked for in one stretch."""

LN2: Final = float(np.log(2))


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
    searching : bool
        Whether a wider search may find more.
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
    searching: bool = False
    refuted: bool = False


@dataclass(frozen=True)
class Stretch:
    """Steps in a row as she reads them.

    Parameters
    ----------
    session : str
    k : int
        The first step.
    verdicts : array, shape (K, 1 + M)
        Probability of each step's verdict (none, symbol 0, 1, ...), the messages known.
    symbols : array, shape (K, 1 + M)
        Of the message symbol carried: none, 0, 1, ...
    """

    session: str
    k: int
    verdicts: Array
    symbols: Array


def verdicts_of(
    steps: Sequence[InferredStep], among: tuple[float, float], size: int, *, certain: bool
) -> tuple[Array, Array]:
    """Probability of each step's verdict (none, symbol 0, 1, ...), alone and after the last one.

    Parameters
    ----------
    steps : sequence of InferredStep
    among : tuple of float
        t_c from and to, in units of D_e, evenly.
    size : int
        M.
    certain : bool
        Whether every step agrees.

    Returns
    -------
    alone : array, shape (K, 1 + M)
    after : array, shape (K, M, 1 + M)
        Where the step before agreed on each symbol: trajectories are drawn over several steps, so
        that what one step was says something of the next.
    """
    shares = [_shares(step.samples, among, size, certain=certain) for step in steps]
    alone = np.zeros((len(steps), 1 + size))
    for i, share in enumerate(shares):
        if share is None:
            continue
        alone[i] = share.sum(axis=0)
        more = DOUBT if len(share) == 1 else PSEUDO
        alone[i, 1 if certain else 0 :] += more / (size + 1)
        alone[i] /= alone[i].sum()
    blind = np.array([share is None for share in shares], dtype=bool)
    seen = alone[~blind]
    agreed = 1.0 if certain else (float(seen[:, 1:].sum(axis=1).mean()) if len(seen) else 0.2)
    alone[blind, 0] = 1.0 - agreed
    alone[blind, 1:] = agreed / size
    after = np.repeat(alone[:, None], size, axis=1)
    for i, (before, share) in enumerate(pairwise(shares), 1):
        if before is None or share is None or len(before) != len(share) or len(share) == 1:
            continue
        together = before[:, 1:].T @ share + LIKE_ALONE * alone[i]
        after[i] = together / together.sum(axis=1, keepdims=True)
    return alone, after


def _shares(
    samples: Array | None, among: tuple[float, float], size: int, *, certain: bool
) -> Array | None:
    """Of each trajectory the probability of each verdict, shape (S, 1 + M)."""
    if samples is None:
        return None
    low, high = among
    choice = samples.argmin(axis=1)
    share = np.ones(len(choice))
    if not certain:
        ordered = np.sort(samples, axis=1)
        over = np.minimum(high, ordered[:, 1]) - np.maximum(low, ordered[:, 0])
        share = np.clip(over / max(high - low, 1e-12), 0.0, 1.0) * (ordered[:, -1] <= 1.0)
    out = np.zeros((len(choice), 1 + size))
    out[np.arange(len(choice)), 1 + choice] = share
    out[:, 0] = 1.0 - share
    return out


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
        self, steps: Sequence[InferredStep], among: tuple[float, float], after: dict[str, int]
    ) -> list[Message]:
        """The messages of ``steps``; of each session those that begin ``after`` a step."""
        self.stretches = []
        by_step = {id(s.transition): s for s in steps}
        out: list[Message] = []
        for run in steps_in_a_row([s.transition for s in steps]):
            last = after.get(run[0].session, -1)
            part = [by_step[id(t)] for t in run if t.k > last]
            if len(part) < 2 or all(s.transition.cipher is None for s in part):
                continue
            fresh = part[0].transition.start and last < 0
            out += self._stretch(part, among, fresh=fresh)
        return out

    def _stretch(
        self, steps: Sequence[InferredStep], among: tuple[float, float], *, fresh: bool
    ) -> list[Message]:
        """The messages of steps in a row, the scheme in its initial state if ``fresh``."""
        alone, after = verdicts_of(steps, among, self._size, certain=self._certain)
        # a state that holds a key holds that of the step before
        pads = self._table.pad[: self._states]
        verdicts = np.where((pads >= 0)[:, None], after[:, pads], alone[:, None])
        ciphers = np.array(
            [-1 if s.transition.cipher is None else s.transition.cipher for s in steps]
        )
        entry = np.zeros(self._states)
        entry[0] = 1.0
        if not fresh:
            entry[:] = 1 / self._states
        lattice = Lattice(self._table, verdicts, ciphers, entry)
        search = MessageSearch(lattice, self._language, self._beam)
        begin = np.full((lattice.steps + 1, self._states), -np.inf)
        with np.errstate(divide="ignore"):
            begin[0] = np.log(entry)
        out: list[Message] = []
        first, session = steps[0].transition.k, steps[0].transition.session
        for _ in range(MOST_MESSAGES):
            if search.silent(begin):
                break
            found = search.find(begin)
            if found is None:
                break
            message = self._message(search, lattice, begin, found, session, first)
            if message is None:
                break
            for wider in WIDER:
                if not message.whole or message.probability >= SURE or not message.searching:
                    break
                again = search.find(begin, wider * self._beam)
                assert again is not None
                better = self._message(search, lattice, begin, again, session, first)
                if better is not None and better.probability >= message.probability:
                    found, message = again, better
            out.append(message)
            if not message.whole:
                break
            begin = found.unchecked_ends if message.refuted else found.ends
        self._room = len(steps)
        stream, waits = self._stream(out)
        aligned = align(self._table, verdicts, ciphers, entry, stream, waits)
        if aligned is not None:
            self.stretches.append(Stretch(session, first, *aligned))
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

    def _message(
        self,
        search: MessageSearch,
        lattice: Lattice,
        begin: Array,
        found: Found,
        session: str,
        first: int,
    ) -> Message | None:
        """What was found as a message, or None where there is likely none."""
        text, other = np.log(1 - NOT_TEXT), np.log(NOT_TEXT)
        none = lattice.none_after(begin)
        listed = found.weights + text
        lost = found.plain + text + np.log(max(1 - found.kept, 1e-300))
        anything = found.any + other
        opened = found.open + text
        parts = np.array([none, lost, anything, opened, *listed])
        total = float(np.logaddexp.reduce(parts))
        p_none, p_lost, p_any, p_open = np.exp(parts[:4] - total)
        p = np.exp(listed - total)
        if p_none > 0.5:
            return None
        entropies = -(p * np.log2(np.maximum(p, 1e-300))).sum()
        rest = p_lost + p_any + p_open
        left = float(entropies)
        if rest > 1e-9:
            # what she does not have is worth at least as much as she can follow
            followed = float(np.log2(search.beam))
            any_left = search.drawn(begin, np.random.default_rng(0)) - 8 * CHECK_BYTES
            any_left = max(any_left, followed)
            more = min(max(found.surprise, followed), any_left)
            left += float(p_any * any_left + p_lost * more + p_open * (more + found.unsent))
            for p_part in (p_lost, p_any, p_open):
                left -= float(p_part * np.log2(max(p_part, 1e-300)))
        refuted = bool(p_lost > 0.5 and found.kept >= 1 - REFUTED)
        left = min(left, found.longest) if np.isfinite(left) and not refuted else found.longest
        is_whole = refuted or (bool(len(p)) and float(p.sum() + p_lost) >= p_open)
        ends = (found.unchecked_ends if refuted else found.ends).max(axis=1)
        k = first + (int(ends.argmax()) if np.isfinite(ends).any() else lattice.steps) - 1
        payload = found.unchecked
        if not refuted:
            payload = found.payloads[0] if is_whole else found.under_way
        return Message(
            session,
            k if is_whole else first + lattice.steps - 1,
            payload,
            float(p[0]) if is_whole and not refuted else 0.0,
            left,
            is_whole,
            int((p > 1e-3 * p.max()).sum()) if len(p) else 0,
            -1 if is_whole or found.missing < 0 else first + lattice.steps - 1 + found.missing,
            bool(p_lost > MISSED) and not refuted,
            refuted,
        )


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
