"""Hypotheses about one frame, a row each, and how they grow by a symbol."""

import zlib
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Indices
from protocol.schemes.framing import CHECK_BYTES, LENGTH_BYTES, block_bytes, digits_of, frame_length
from tap_service.inference.expectation import ByKind, Expectation, State
from tap_service.inference.lattice import Lattice

FAR: Final = 25.0
"""Log ratio behind the best at which a length or a hypothesis is not followed."""

NEGLIGIBLE: Final = 1e-7
"""Share of the weight that a node may have to be left out."""


class Plan:
    """How the symbols of a frame of each length fall into blocks."""

    def __init__(self, lengths: Sequence[int], size: int) -> None:
        header = digits_of(LENGTH_BYTES, size)
        self.total = np.array([frame_length(n, size) - 1 - header for n in lengths])
        longest = int(self.total.max())
        shape = (len(lengths), longest)
        self.bytes = np.zeros(shape, dtype=np.intp)  # of the block to which each symbol belongs
        self.place = np.zeros(shape, dtype=np.intp)  # of the symbol in its block
        self.digits = np.zeros(shape, dtype=np.intp)
        count = block_bytes(size)
        digits = digits_of(count, size)
        place = np.arange(longest) % digits
        for i, n in enumerate(lengths):
            whole, rest = divmod(n + CHECK_BYTES, count)
            at = whole * digits
            self.bytes[i, :at], self.place[i, :at], self.digits[i, :at] = count, place[:at], digits
            if rest:  # the last block is shorter
                last = digits_of(rest, size)
                end = at + last
                self.bytes[i, at:end], self.digits[i, at:end] = rest, last
                self.place[i, at:end] = np.arange(last)


class Beam:
    """The hypotheses, a row each."""

    columns = (
        "length", "alpha", "level", "score", "low", "done", "said", "count",
        "text", "next", "check", "node",
    )  # fmt: skip

    def __init__(self, count: int, nodes: int, longest: int, dtype: type, state: State) -> None:
        self.length = np.zeros(count, dtype=np.intp)  # index of the payload's length
        self.alpha = np.zeros((count, nodes))
        self.level = np.zeros(count)  # log weight, without alpha and what is under way
        self.score = np.zeros(count)
        self.low: Array = np.zeros(count, dtype=dtype)  # least number that the block may be
        self.done = np.zeros(count, dtype=np.intp)  # bytes of the block that are certain
        self.said = np.zeros(count)  # log probability of the byte under way, as far as it is known
        self.count = np.zeros(count, dtype=np.intp)  # bytes of payload and check
        self.text = np.zeros((count, longest), dtype=np.uint8)
        self.next = np.zeros(count, dtype=np.intp)  # row of what is expected of the next byte
        self.check = np.zeros((count, CHECK_BYTES), dtype=np.intp)
        self.node = np.zeros(count, dtype=np.intp)  # in the graph of what was taken together
        self.state = state

    def take(self, rows: Indices) -> None:
        """Keep some rows, in this order."""
        for name in self.columns:
            setattr(self, name, getattr(self, name)[rows])
        self.state = self.state.take(rows)


class Growth:
    """Lets hypotheses grow.

    Parameters
    ----------
    lattice : Lattice
    language : Expectation
    lengths : integer array
        Payloads' lengths that are followed.
    most : int
        Hypotheses kept.
    """

    def __init__(
        self, lattice: Lattice, language: Expectation, lengths: NDArray[np.intp], most: int
    ) -> None:
        self._lattice, self._language, self.most = lattice, language, most
        self._size, self._lengths = lattice.size, lengths
        self.plan = Plan(lengths.tolist(), lattice.size)
        self._begun = [zlib.crc32(int(n).to_bytes(LENGTH_BYTES, "big")) for n in lengths]
        self._next = _CERTAIN
        self._by_kind: ByKind = {}

    def expect(self, beam: Beam, rows: Indices) -> None:
        """Set what is expected of the next byte of some rows: text, or the check.

        The rows of :attr:`_next` are cumulated probabilities; first come those of a certain byte.
        """
        n = self._lengths[beam.length[rows]]
        tail = beam.count[rows] - n
        parts, by_kind = [_CERTAIN], list[ByKind]()
        others = np.setdiff1d(np.arange(len(beam.next)), rows)
        others = others[beam.next[others] >= 256]
        if len(others):
            used, back = np.unique(beam.next[others], return_inverse=True)
            beam.next[others] = 256 + back.reshape(-1)
            parts.append(self._next[used])
            by_kind.append({i: p[used - 256] for i, p in self._by_kind.items()})
        text = rows[tail < 0]
        if len(text):
            p, each = self._language.next(beam.state.take(text), tail[tail < 0] == -1)
            beam.next[text] = sum(map(len, parts)) + np.arange(len(text))
            parts.append(_cumulated(p))
            by_kind.append(each)
        self._next, self._by_kind = np.concatenate(parts), _together(by_kind, parts[1:])
        for row in rows[tail == 0].tolist():
            payload = beam.text[row, : self._lengths[beam.length[row]]].tobytes()
            check = zlib.crc32(payload, self._begun[beam.length[row]])
            beam.check[row] = list(check.to_bytes(CHECK_BYTES, "big"))
        checked = rows[(tail >= 0) & (tail < CHECK_BYTES)]
        beam.next[checked] = beam.check[checked, tail[(tail >= 0) & (tail < CHECK_BYTES)]]

    def symbol(self, beam: Beam, ahead: Array, j: int, low: int) -> tuple[int, float, Array] | None:
        """One symbol more in every hypothesis; the window's first step, and the share kept.

        Last comes the share of each kind of text that was let go. None where the transcript holds
        no further symbol.
        """
        M, E = self._size, self._lattice.states
        count = beam.alpha.shape[1] // E
        matrices = self._lattice.window(low, count)
        low += 1
        top = finite(ahead.max(axis=1))
        fits = np.empty((len(beam.level), M))
        for i in np.unique(beam.length).tolist():
            rows = beam.length == i
            fits[rows] = beam.alpha[rows] @ (matrices @ np.exp(ahead[i] - top[i])).T
        # the interval of numbers that each symbol leaves
        i = beam.length
        digits = range(int(self.plan.digits.max()) + 1)
        powers = np.array([M**n for n in digits], dtype=beam.low.dtype)
        size = powers[self.plan.digits[i, j] - 1 - self.plan.place[i, j]]
        edges = beam.low[:, None] + np.arange(M + 1).astype(beam.low.dtype) * size[:, None]
        unit = self._units(self.plan.bytes[i, j] - 1 - beam.done, beam.low.dtype)
        said = self._between(beam, edges, unit)
        with np.errstate(divide="ignore"):
            score = (
                beam.level[:, None] + np.log(fits) + top[i][:, None] + np.log(np.maximum(said, 0.0))
            )
        flat = score.ravel()
        best = flat.max(initial=-np.inf)
        if best == -np.inf:
            return None
        chosen = np.flatnonzero(flat > best - FAR)
        if len(chosen) > self.most:
            order = np.argpartition(-flat[chosen], self.most)[: self.most]
            chosen = np.sort(chosen[order])
        weights = np.exp(flat - best)
        whole = float(weights.sum())
        share = float(weights[chosen].sum()) / whole
        weights[chosen] = 0.0
        gone = weights.reshape(-1, M).sum(axis=1) @ beam.state.shares / whole
        rows, symbols = np.divmod(chosen, M)
        beam.take(rows)
        beam.low = edges[rows, symbols]
        beam.said = np.log(np.maximum(said.ravel()[chosen], 1e-300))
        beam.score = flat[chosen]
        moved = np.empty((len(rows), matrices.shape[2]))
        for m in range(M):
            mine = symbols == m
            moved[mine] = beam.alpha[mine] @ matrices[m]
        scale = np.maximum(moved.max(axis=1), 1e-300)
        beam.alpha = moved / scale[:, None]
        beam.level = beam.level + np.log(scale)
        # nodes that hardly count are left out
        weight = (beam.alpha * np.exp(ahead[beam.length] - top[beam.length][:, None])) * np.exp(
            beam.score - best
        )[:, None]
        norm = weight.sum(axis=1, keepdims=True)
        share_of = (weight / np.maximum(norm, 1e-300) * np.exp(beam.score - best)[:, None]).sum(0)
        by_step = share_of.reshape(-1, E).sum(axis=1)
        used = np.flatnonzero(by_step > NEGLIGIBLE * by_step.sum())
        first, last = int(used[0]), int(used[-1])
        beam.alpha = beam.alpha[:, first * E : (last + 1) * E]
        low += first
        self._bytes(beam, j, size[rows])
        return low, share, gone

    def _units(self, places: Indices, dtype: np.dtype) -> Array:
        powers = np.array([256**n for n in range(max(int(places.max()), 0) + 1)], dtype=dtype)
        return powers[np.maximum(places, 0)]

    def _between(self, beam: Beam, edges: Array, unit: Array) -> Array:
        """Probability that the byte under way lies between neighbouring ``edges``, shape (H, M)."""
        rows = beam.next[:, None]
        whole = np.clip(edges // unit[:, None], 0, 256)
        part = (edges - whole * unit[:, None]) / unit[:, None]
        at = whole.astype(np.intp)
        below = self._next[rows, at]
        rest = self._next[rows, np.minimum(at + 1, 256)] - below
        below += np.clip(part.astype(float), 0.0, 1.0) * rest
        return np.diff(below, axis=1)

    def _bytes(self, beam: Beam, j: int, size: Array) -> None:
        """Take the bytes that have become certain; numbers are then counted from them."""
        i = beam.length
        count = self.plan.bytes[i, j]
        while True:
            unit = self._units(count - 1 - beam.done, beam.low.dtype)
            first, last = beam.low // unit, (beam.low + size - 1) // unit
            sure: Flags = (beam.done < count) & np.asarray(first == last, dtype=bool)
            rows = np.flatnonzero(sure)
            if not len(rows):
                break
            byte = first[rows].astype(np.intp)
            byte = np.clip(byte, 0, 255)
            p = self._next[beam.next[rows], byte + 1] - self._next[beam.next[rows], byte]
            beam.level[rows] += np.log(np.maximum(p, 1e-300))
            beam.low[rows] -= byte.astype(beam.low.dtype) * unit[rows]
            beam.text[rows, beam.count[rows]] = byte
            self._go_on(beam, rows, byte)
            beam.said[rows] = 0.0
            beam.done[rows] += 1
            beam.count[rows] += 1
            self.expect(beam, rows)
        ended = self.plan.place[i, j] + 1 == self.plan.digits[i, j]
        beam.done[ended] = 0
        beam.low[ended] = 0

    def _go_on(self, beam: Beam, rows: Indices, byte: Indices) -> None:
        """Let the texts of some rows have one more byte."""
        text = beam.next[rows] >= 256
        rows, byte = rows[text], byte[text]
        which = beam.next[rows] - 256
        after = self._language.after(beam.state.take(rows), byte, self._by_kind, which)
        at, shares = beam.state
        for name in ("last", "word", "before"):
            getattr(at, name)[rows] = getattr(after.at, name)
        shares[rows] = after.shares


def _together(by_kind: Sequence[ByKind], parts: Sequence[Array]) -> ByKind:
    """What kinds say of the rows of several parts, none where a part has no such kind."""
    if len(by_kind) == 1:
        return by_kind[0]
    none = [np.zeros((len(part), 256), dtype=np.float32) for part in parts]
    return {
        i: np.concatenate([one.get(i, zeros) for one, zeros in zip(by_kind, none, strict=True)])
        for i in sorted(set().union(*by_kind))
    }


def _cumulated(p: Array) -> Array:
    """Cumulated probabilities of bytes, shape (R, 257)."""
    out = np.zeros((len(p), 257))
    np.cumsum(p, axis=1, out=out[:, 1:])
    return out


_CERTAIN: Final = _cumulated(np.eye(256))


def finite(top: Array) -> Array:
    """The same with 0 for log weights of nothing."""
    return np.where(np.isfinite(top), top, 0.0)
