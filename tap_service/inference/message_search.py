"""The message itself: a beam search over its symbols, with a model of its language and its check.

A hypothesis is a beginning of a frame. Its weight is the probability of its text, times how well
its symbols fit the transcript (:mod:`tap_service.inference.lattice`), times what the rest of the
transcript says where the rest of the frame may be anything and silence follows. So beginnings of
frames of all lengths can be compared. What is dropped on the way is accounted for: it lowers what
she claims for what she found.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Indices, Narrow
from protocol.schemes.framing import (
    CHECK_BYTES,
    LENGTH_BYTES,
    START,
    block_bytes,
    digits_of,
    frame_length,
)
from tap_service.inference.expectation import Expectation
from tap_service.inference.lattice import BEGINS, SHORT_SHARE, Lattice
from tap_service.inference.message_beam import FAR, NEGLIGIBLE, Beam, Growth, finite
from tap_service.inference.message_graph import (
    DRAWN,
    HEATS,
    Drawn,
    Graph,
    check_symbols,
    first_of_each,
    join,
    judge,
)

BEAM: Final = 3000
"""Hypotheses kept from symbol to symbol."""

LENGTHS: Final = 160
"""Lengths of the payload that are followed. Where another message follows at once, the length that
spans both fits better than the true one until the text is looked at."""

LONGEST: Final = 1024
"""Bytes of a payload at most."""

KEPT: Final = 200
"""Messages that are given back."""

FEWEST: Final = 200
"""Messages drawn of a length at least."""

LEAST_CHECKED: Final = 1e-4
"""Share of texts whose check the transcript holds that is told from none: rounding."""

CLEARLY: Final = float(np.log(20))
"""Log ratio by which silence must be likelier than a message for none to be searched."""

NEARLY: Final = float(np.log(4))
"""Log ratio behind the likeliest up to which the end of a message under way is waited for."""

REFUTED: Final = 1e-3
"""Share let go on the way up to which a message that is none of those kept refutes what she takes
the steps for."""


TINY: Final = 1e-300


@dataclass(frozen=True)
class Found:
    """What a search found of one frame.

    Parameters
    ----------
    payloads : tuple of bytes
        The likeliest messages, best first.
    weights : array
        Their log weights, the check included: ratios to random symbols.
    plain : float
        Log weight of all messages on the list before their checks were looked at.
    kept : float
        Share of the weight that was not dropped on the way.
    surprise : float
        Entropy of the list before the checks, in bits.
    ends : array, shape (K + 1, E)
        Log weight that the best one ends at each node.
    under_way : bytes
        The likeliest beginning of a message that the transcript does not hold to its end.
    open : float
        Log weight of all such beginnings.
    missing : int
        Steps in which those of them that are nearly the likeliest may be over; -1 where none is.
    unsent : float
        Bits of the likeliest of them that the transcript does not hold.
    check : float
        Bits that the check says of the message.
    longest : float
        Bits that a message holds, its length's included, given what says how long it is.
    unchecked : bytes
        The likeliest message before checks were looked at.
    unchecked_ends : array, shape (K + 1, E)
        Log weight that it ends at each node, whatever its check.
    kinds : array, shape (kinds,)
        Probability of each kind of text; of what was let go as it was when it was let go.
    """

    payloads: tuple[bytes, ...]
    weights: Array
    plain: float
    kept: float
    surprise: float
    ends: Array
    under_way: bytes
    open: float
    missing: int
    unsent: float
    check: float
    longest: float
    unchecked: bytes
    unchecked_ends: Array
    kinds: Array

    @property
    def lost(self) -> float:
        """Log weight of what was let go."""
        return self.plain + float(np.log(max(1 - self.kept, TINY)))


class Opened(NamedTuple):
    """Messages of which the transcript does not hold the last symbols.

    Parameters
    ----------
    total, best : float
        Log weight of all of them, and of the likeliest.
    text : bytes
        What is known of that one.
    missing : int
        Symbols that they lack.
    """

    total: float
    best: float
    text: bytes
    missing: int


class Ended:
    """Messages that came to their end."""

    def __init__(self) -> None:
        self.list: list[tuple[float, float, bytes, Array, int]] = []
        self.plain: dict[bytes, float] = {}
        self.total = self.listed = -np.inf
        self.unchecked = (-np.inf, b"", np.zeros(0), 0)
        """Log weight of the likeliest before its check, it, its nodes and their first step."""
        self.check = 0.0
        self.drawn: list[tuple[float, float]] = []
        """Log weights of texts of a length before their check, and their entropy in bits."""

    def add(self, text: bytes, score: float, plain: float, alpha: Array, low: int) -> None:
        """Add one with its log weights, its check's included and not, and where it ends."""
        self.list.append((score, plain, text, alpha, low))


class MessageSearch:
    """Searches one frame in a lattice.

    Parameters
    ----------
    lattice : Lattice
    language : Expectation
    beam : int
        Hypotheses kept from symbol to symbol.
    """

    def __init__(self, lattice: Lattice, language: Expectation, beam: int = BEAM) -> None:
        self._lattice, self._language, self.beam = lattice, language, beam
        self._size = lattice.size
        self._header = digits_of(LENGTH_BYTES, self._size)
        self._single = block_bytes(self._size) == 1
        self._digits = digits_of(1, self._size)
        self._outside = lattice.outside()
        self._longest = LONGEST
        symbols = frame_length(self._longest, self._size)
        self._ahead = lattice.ahead(self._outside, min(symbols, lattice.steps))

    def _after(self, symbols: Indices, low: int, count: int) -> Narrow:
        """`Lattice.ahead` of numbers of symbols in a window; more than the steps never end."""
        return self._ahead[np.minimum(symbols, len(self._ahead) - 1), low : low + count]

    # --- where and how long -----------------------------------------------------------------------

    def starts(self, begin: Array) -> Array:
        """Log weight that a frame's start symbol was carried right before each node."""
        idle = self._lattice.idle_until(begin)
        level = finite(idle.max(axis=1, keepdims=True))
        out = np.full_like(idle, -np.inf)
        values = np.exp(idle - level)
        band = self._lattice.band[START]
        for g in range(self._lattice.wait):
            rows = self._lattice.steps - g
            w = np.einsum("ke,kef->kf", values[:rows], band[:rows, :, g])
            with np.errstate(divide="ignore"):
                out[1 + g :] = np.logaddexp(out[1 + g :], np.log(w) + level[:rows])
        return out + float(np.log(BEGINS))

    @cached_property
    def _all_lengths(self) -> tuple[NDArray[np.intp], Indices, Array]:
        """Payloads' lengths, the symbols that follow the start symbol, and log probabilities."""
        lengths = np.arange(1, self._longest + 1)
        total = np.array([frame_length(int(n), self._size) - 1 for n in lengths])
        prior = np.where(
            lengths < 256, np.log(SHORT_SHARE / 255), np.log((1 - SHORT_SHARE) / 65280)
        )
        return lengths, total, np.asarray(prior, dtype=np.float64)

    def _of_any_length(self, start: Array) -> Array:
        """Log weight that a message of any length and bytes begins right before each node."""
        _, total, prior = self._all_lengths
        # those that the transcript cannot hold to their end are alike
        rows, alike = np.unique(np.minimum(total, len(self._ahead) - 1), return_inverse=True)
        weights = np.log(np.bincount(alike.reshape(-1), np.exp(prior)))
        best = np.full(start.shape, -np.inf)
        for n, p in zip(rows, weights, strict=True):
            best = np.logaddexp(best, start + self._after(n, 0, len(start)) + p)
        return best

    def silent(self, begin: Array) -> bool:
        """Whether silence alone after ``begin`` is clearly likelier than a message of any bytes."""
        message = float(np.logaddexp.reduce(self._of_any_length(self.starts(begin)).ravel()))
        return self._lattice.none_after(begin) > message + CLEARLY

    def _lengths(self, start: Array) -> tuple[NDArray[np.intp], Array, Array, int] | None:
        """Likely lengths: they, their alphas and levels, and the first step of the window.

        None where the transcript holds no length.
        """
        lengths, total, prior = self._all_lengths
        best = self._of_any_length(start)
        near = np.flatnonzero((best > best.max() - FAR).any(axis=1))
        low, high = int(near[0]), int(near[-1])
        alpha = np.exp(start[low : high + 1] - start[low : high + 1].max())
        level: Array = prior + float(start[low : high + 1].max())
        alphas = np.tile(alpha.reshape(1, -1), (len(lengths), 1))
        for j in range(self._header):
            # lengths that began alike are one row
            begun = lengths // self._size ** (self._header - 1 - j)
            alike, rows, back = np.unique(begun, return_index=True, return_inverse=True)
            moved = np.empty((len(rows), alphas.shape[1] + self._lattice.wait * start.shape[1]))
            for m in range(self._size):
                mine = alike % self._size == m
                if mine.any():
                    moved[mine] = self._lattice.moved(alphas[rows[mine]], m, low)
            alphas = moved[back]
            low += 1
            left = total - 1 - j
            score = self._weights(alphas, level, left, low)
            if not np.isfinite(score.max()):
                return None
            near = np.flatnonzero(score > score.max() - FAR)
            if len(near) > LENGTHS and j == self._header - 1:
                near = np.sort(np.argsort(-score)[:LENGTHS])
            lengths, total = lengths[near], total[near]
            alphas, level, score = alphas[near], level[near], score[near]
            alphas, low = self._trimmed(alphas, level, total - 1 - j, low, score)
        return lengths, alphas, level, low

    def _rows(self, left: Indices, low: int, count: int) -> Array:
        """Log weight ahead of the nodes of a window, a row for each of ``left``."""
        out = np.full((len(left), count, self._lattice.states), -np.inf)
        have = min(count, self._lattice.steps + 1 - low)
        if have > 0:
            out[:, :have] = self._after(left, low, have)
        return out.reshape(len(left), count * self._lattice.states)

    def _weights(self, alphas: Array, level: Array, left: Indices, low: int) -> Array:
        ahead = self._rows(left, low, alphas.shape[1] // self._lattice.states)
        top = finite(ahead.max(axis=1, keepdims=True))
        with np.errstate(divide="ignore"):
            out: Array = np.log((alphas * np.exp(ahead - top)).sum(axis=1)) + level + top[:, 0]
        return out

    def _trimmed(
        self, alphas: Array, level: Array, left: Indices, low: int, score: Array
    ) -> tuple[Array, int]:
        """Leave the nodes at both ends out that hardly count."""
        E = self._lattice.states
        count = alphas.shape[1] // E
        ahead = self._rows(left, low, count)
        with np.errstate(divide="ignore"):
            share = np.log(alphas) + (level - score.max())[:, None] + ahead
        weight = np.exp(share - finite(share.max())).sum(axis=0).reshape(count, E).sum(axis=1)
        used = np.flatnonzero(weight > NEGLIGIBLE * weight.sum())
        first, last = int(used[0]), int(used[-1])
        return alphas[:, first * E : (last + 1) * E], low + first

    # --- the payload ------------------------------------------------------------------------------

    def find(self, begin: Array) -> Found | None:
        """Search the frame that comes next after ``begin``, log weights of nodes."""
        start = self.starts(begin)
        if not np.isfinite(start).any():
            return None
        begun = self._lengths(start)
        if begun is None:
            return None
        lengths, alphas, level, low = begun
        growth = Growth(self._lattice, self._language, lengths, self.beam)
        plan = growth.plan
        dtype = np.int64 if self._single else object
        hypotheses = Beam(
            len(lengths),
            alphas.shape[1],
            int(lengths.max()) + CHECK_BYTES,
            dtype,
            self._language.start(len(lengths)),
        )
        hypotheses.length = np.arange(len(lengths))
        hypotheses.alpha, hypotheses.level = alphas, level
        hypotheses.score = self._weights(alphas, level, plan.total, low)
        likely = hypotheses.score.copy()
        growth.expect(hypotheses, np.arange(len(lengths)))
        kept, ended = 0.0, Ended()
        kinds, going = np.zeros(hypotheses.state.shares.shape[1]), 1.0
        opened: list[Opened] = []
        graph = Graph()
        graph.begin(hypotheses)
        for j in range(int(plan.total.max())):
            opened += self._open(hypotheses, lengths, plan.total[hypotheses.length] - j, low)
            count = hypotheses.alpha.shape[1] // self._lattice.states + self._lattice.wait
            ahead = self._rows(np.maximum(plan.total - 1 - j, 0), low + 1, count)
            moved = growth.symbol(hypotheses, ahead, j, low)
            if moved is None:
                break
            low, share, gone = moved
            kinds += going * gone
            kept += float(np.log(share))
            going *= share
            sizes = lengths[hypotheses.length]
            if not self._single:
                over = self._over(ended, hypotheses, sizes, plan.total[hypotheses.length], j, low)
            elif (j + 1) % self._digits:
                continue
            else:
                graph.merge(hypotheses)
                over = hypotheses.count == lengths[hypotheses.length]
                if over.any():
                    self._drawn(ended, opened, graph, hypotheses, over, low)
            if over.any():
                ends = np.exp(hypotheses.score - np.logaddexp.reduce(hypotheses.score)) * over
                kinds += going * (ends @ hypotheses.state.shares)
                going *= 1.0 - float(ends.sum())
            if over.all():
                break
            if over.any():
                hypotheses.take(np.flatnonzero(~over))
        p = np.exp(likely - np.logaddexp.reduce(likely))
        longest = float(p @ (8 * lengths - np.log2(np.maximum(p, 1e-300))))
        last = np.exp(hypotheses.score - np.logaddexp.reduce(hypotheses.score))
        kinds += max(going, 0.0) * (last @ hypotheses.state.shares)
        return self._found(ended, kept, opened, longest, kinds)

    def _over(
        self, ended: "Ended", beam: Beam, sizes: Indices, totals: Indices, j: int, low: int
    ) -> Flags:
        """Take the hypotheses that have their check too, followed one by one; which they are."""
        scores = beam.score.tolist()
        for row in np.flatnonzero(beam.count >= sizes).tolist():
            text = beam.text[row, : sizes[row]].tobytes()
            ended.plain.setdefault(text, scores[row])
            if ended.plain[text] > ended.unchecked[0]:
                ended.unchecked = (ended.plain[text], text, np.zeros(0), 0)
        over: Flags = totals == j + 1
        for row in np.flatnonzero(over).tolist():
            text = beam.text[row, : sizes[row]].tobytes()
            ended.add(text, scores[row], ended.plain[text], beam.alpha[row].copy(), low)
        ended.total = float(np.logaddexp.reduce([ended.total, *(e[1] for e in ended.list)]))
        return over

    def _drawn(
        self, ended: "Ended", opened: list[Opened], graph: Graph, beam: Beam, over: Flags, low: int
    ) -> None:
        """Draw messages that are over but for their check, and judge them by it."""
        rows = np.flatnonzero(over)
        all_of_them = float(np.logaddexp.reduce(beam.score[rows]))
        share = np.exp(all_of_them - np.logaddexp.reduce(beam.score))
        count = max(int(share * DRAWN), FEWEST)
        drawn = graph.draw(rows, beam.score[rows], np.random.default_rng(0), count)
        as_likely = drawn.scores[: len(drawn.scores) // len(HEATS), -1]  # drawn by their weights
        entropy = float((all_of_them - as_likely).mean() / np.log(2))
        ended.drawn.append((all_of_them, max(entropy, 0.0)))
        first = int(drawn.scores[:, -1].argmax())
        node, text = int(drawn.nodes[first, -1]), drawn.texts[first].tobytes()
        best = float(drawn.scores[first, -1])
        if best > ended.unchecked[0]:
            ended.unchecked = (best, text, beam.alpha[node].copy(), low)
        checked = self._checked(opened, beam, rows, low, (best - all_of_them, text))
        ended.total = float(np.logaddexp(ended.total, all_of_them + checked))
        texts, plain, nodes, mass, heard = self._joined(drawn, beam, rows, low)
        ended.check = max(ended.check, heard)
        ended.listed = float(np.logaddexp(ended.listed, mass + checked))
        if not len(texts):
            return
        gain, alpha, low = judge(
            self._lattice, texts, beam.alpha[nodes], low, self._ahead, self._digits
        )
        for i in np.argsort(-(plain + gain))[:KEPT].tolist():
            ended.add(texts[i].tobytes(), float(plain[i] + gain[i]), float(plain[i]), alpha[i], low)

    def _checked(
        self, opened: list[Opened], beam: Beam, rows: Indices, low: int, best: tuple[float, bytes]
    ) -> float:
        """Log share of texts in ``rows`` whose check the transcript holds to its end.

        The others are under way: ``best`` is the log share of the likeliest, and it.
        """
        top = float(beam.level[rows].max())
        alpha = np.exp(beam.level[rows] - top) @ beam.alpha[rows]
        total = self._digits * CHECK_BYTES
        weights = np.full(total, -np.inf)  # that it ends after so many symbols of the check
        for j, (nodes, first, level) in zip(
            range(total), self._onward(alpha, low, total), strict=False
        ):
            left = self._lattice.left[first : first + len(nodes) // self._lattice.states].ravel()
            with np.errstate(divide="ignore"):
                weights[j] = top + level + float(np.log(nodes[: len(left)] @ left))
        under_way = float(np.logaddexp.reduce(weights))
        if under_way == -np.inf:
            return 0.0
        for j in np.flatnonzero(np.isfinite(weights)).tolist():
            weight = float(weights[j])
            opened.append(Opened(weight, weight + best[0], best[1], total - j))
        share = np.exp(under_way - float(np.logaddexp.reduce(beam.score[rows])))
        return float(np.log(max(1.0 - share, LEAST_CHECKED)))

    def _onward(self, alpha: Array, low: int, count: int) -> Iterator[tuple[Array, int, float]]:
        """Weights of nodes before each of ``count`` symbols of any kind and after the last.

        Each with the first step of its window and the log of what it was divided by.
        """
        E, level = self._lattice.states, 0.0
        for _ in range(count):
            yield alpha, low, level
            alpha = self._lattice.moved(alpha[None], None, low)[0]
            alpha, low = alpha[: (self._lattice.steps - low) * E], low + 1
            if not alpha.any():
                return
            level += float(np.log(alpha.max()))
            alpha = alpha / alpha.max()
            used = np.flatnonzero(alpha.reshape(-1, E).max(axis=1) > NEGLIGIBLE)
            alpha, low = alpha[used[0] * E : (used[-1] + 1) * E], low + int(used[0])
        yield alpha, low, level

    def _joined(
        self, drawn: Drawn, beam: Beam, rows: Indices, low: int
    ) -> tuple[NDArray[np.uint8], Array, Indices, float, float]:
        """Messages that may have their check: they, log weights, nodes; and that of all looked at.

        What was drawn, put together anew by halves, where symbols are bits. Last come the bits that
        the check says of any message.
        """
        symbols = None
        if self._size & (self._size - 1) == 0 and drawn.texts.shape[1] > 1:
            mean = np.exp(beam.score[rows] - beam.score[rows].max()) @ beam.alpha[rows]
            total = self._digits * CHECK_BYTES
            symbols = check_symbols(self._lattice, mean, low, self._ahead, total)
        if symbols is None:
            once = first_of_each(drawn.texts)
            plain = drawn.scores[once, -1]
            return drawn.texts[once], plain, drawn.nodes[once, -1], np.logaddexp.reduce(plain), 0.0
        first, second, ends = drawn.halves(drawn.middle())
        a, b, mass = join(first, second, symbols)
        texts = np.hstack([first.texts[a], second.texts[b]])
        said = float((symbols * np.log2(np.maximum(self._size * symbols, TINY))).sum())
        return texts, first.scores[a] + second.scores[b], ends[b], mass, said

    def _open(self, beam: Beam, lengths: Indices, missing: Indices, low: int) -> Iterator[Opened]:
        """The hypotheses of which the transcript holds no further symbol, by what they lack."""
        E = self._lattice.states
        left = np.zeros((beam.alpha.shape[1] // E, E))
        have = self._lattice.left[low : low + len(left)]
        left[: len(have)] = have
        if not left.any():
            return
        with np.errstate(divide="ignore"):
            weight = beam.level + beam.said + np.log(beam.alpha @ left.ravel())
        for symbols in np.unique(missing).tolist():
            rows = np.flatnonzero(missing == symbols)
            row = rows[weight[rows].argmax()]
            text = beam.text[row, : min(beam.count[row], lengths[beam.length[row]])].tobytes()
            total = float(np.logaddexp.reduce(weight[rows]))
            yield Opened(total, float(weight[row]), text, symbols)

    def _found(
        self,
        ended: "Ended",
        kept: float,
        opened: list[Opened],
        longest: float,
        kinds: Array,
    ) -> Found:
        """What a search gives back, with ``kept`` the log of what was not dropped."""
        under_way = max(opened, key=lambda one: one.best, default=Opened(-np.inf, -np.inf, b"", 0))
        lacking = min((o.missing for o in opened if o.best > under_way.best - NEARLY), default=-1)
        unsent = max(under_way.missing - digits_of(CHECK_BYTES, self._size), 0)
        ends = self._nodes(np.zeros(0), 0)
        found = sorted(ended.list, key=lambda e: -e[0])[:KEPT]
        surprise = 0.0
        if found:
            p = np.exp(np.array([e[1] for e in found]) - ended.total)
            rest = max(1 - float(p.sum()), 1e-300)
            surprise = float(-(p * np.log2(np.maximum(p, 1e-300))).sum())
            # what is not on the list is at best as likely as the least likely that is
            surprise -= rest * float(np.log2(max(p.min(), 1e-300)))
            if ended.drawn:
                masses, bits = np.array(ended.drawn).T
                share = np.exp(masses - np.logaddexp.reduce(masses))
                surprise = float(share @ (bits - np.log2(np.maximum(share, TINY))))
            weight, _, _, alpha, at = found[0]
            ends = self._weighing(self._nodes(alpha, at), weight)
        listed = ended.listed if self._single else ended.total
        followed = np.isfinite(ended.total)
        return Found(
            tuple(e[2] for e in found),
            np.array([e[0] for e in found]),
            ended.total - kept,
            float(np.exp(min(listed - ended.total, 0.0) + kept)) if followed else 0.0,
            surprise - kept / float(np.log(2)),
            ends,
            under_way.text,
            float(np.logaddexp.reduce([o.total for o in opened], initial=-np.inf)),
            -1 if lacking < 0 else int(lacking / self._lattice.rate),
            unsent * float(np.log2(self._size)),
            ended.check,
            longest,
            ended.unchecked[1],
            self._weighing(
                self._after_any(*ended.unchecked[2:], self._digits * CHECK_BYTES),
                ended.unchecked[0],
            ),
            kinds / kinds.sum(),
        )

    def _weighing(self, nodes: Array, weight: float) -> Array:
        """Log weights of nodes, such that with all that follows them they come to ``weight``."""
        whole = float(np.logaddexp.reduce((nodes + self._outside).ravel()))
        return nodes + (weight - whole) if np.isfinite(whole) else nodes

    def _nodes(self, alpha: Array, low: int) -> Array:
        """Log weights of all nodes by those of a window from step ``low`` on."""
        out = np.full((self._lattice.steps + 1, self._lattice.states), -np.inf)
        nodes = alpha.reshape(-1, self._lattice.states)[: self._lattice.steps + 1 - low]
        with np.errstate(divide="ignore"):
            out[low : low + len(nodes)] = np.log(nodes)
        return out

    def _after_any(self, alpha: Array, low: int, count: int) -> Array:
        """Log weights of the nodes after ``count`` symbols of any kind."""
        out = self._nodes(np.zeros(0), 0)
        if len(alpha):
            for number, (nodes, first, _) in enumerate(self._onward(alpha, low, count)):
                if number == count:
                    out = self._nodes(nodes, first)
        return out
