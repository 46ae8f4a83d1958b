"""Every decoding that the hidden thresholds leave possible, followed at once.

What the scheme hides from an eavesdropper with the right model is two numbers: a key is agreed when
exactly one gauge is at most t_c and all are at most t_e. A hypothesis is a rectangle of (t_c, t_e)
in which every step so far came out the same, with the scheme's state, the frame's state and the
message symbols that follow. A step cuts the rectangles that its gauges run through, and no others:
over N steps there are of the order of N hypotheses for one threshold, so the list stays short.

:mod:`tap_service.inference.frame_scores` says how plausible each is. Where the list would outgrow
its bound the least plausible go, and are counted.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array, Flags, Indices
from protocol.schemes.base import Scheme
from protocol.schemes.framing import Deframer, digits_of
from protocol.schemes.table import StateTable
from tap_service.inference.frame_scores import FrameScores
from tap_service.inference.hypotheses import Hypotheses
from tap_service.inference.kept import KEPT_MESSAGES
from tap_service.inference.symbol_paths import SymbolPaths

CAP: Final = 3000
"""Hypotheses kept at most."""

BEHIND: Final = 30.0
"""Log ratio behind the best at which a hypothesis is dropped once a frame check has held."""

UNLIKELY: Final = 0.02
"""Outcomes of an uncertain step that are less probable are not followed."""

OUTSIDE: Final = -0.5
"""Score of a step whose every gauge exceeds t_c: the disturbance would have left D_c."""

NODES: Final = 1_000_000
"""Message symbols of all hypotheses together at which those of dropped ones are let go; where more
than half of that remain, the less plausible half of the list goes too."""


class ListDecoding:
    """The list of hypotheses.

    Parameters
    ----------
    scheme : Scheme
        Over M symbols.
    edge : float, optional
        t_e where she knows it; otherwise it is searched too.
    framed : bool
        Whether messages come in frames; otherwise symbols are raw bytes of text from the start.
    cap : int
        Hypotheses kept at most.
    certain : bool
        Whether it is public that every transition agrees: then no threshold is searched.

    Attributes
    ----------
    dropped : int
        Hypotheses that were dropped because the list was full.
    peak : int
        The longest that the list has been.
    solved_k : int
        The step at which a frame check first held; -1 not yet.
    whole_at : list of ((session, k), bytes)
        The last messages whose check held, with where they ended.
    """

    def __init__(
        self,
        scheme: Scheme[Any],
        edge: float | None = None,
        *,
        framed: bool = True,
        cap: int = CAP,
        certain: bool = False,
    ) -> None:
        self.size = scheme.alphabet
        self._table = StateTable(scheme)
        self.framed = framed
        self.certain = certain
        self.dropped = 0
        self.peak = 1
        self.solved_k = -1
        self.session = ""
        self.whole_at: list[tuple[tuple[str, int], bytes]] = []
        self.whole_count = 0
        self._cap = cap
        self._passed = 0
        self.beam = Hypotheses(2 * cap + 64)
        self.paths = SymbolPaths(self.size)
        self._frames = FrameScores(self.beam, self.paths, self.size, framed=framed)
        self.beam.node[0] = -1
        self._frames.begin(slice(0, 1))
        if edge is None:
            self.restrict(0.0, np.inf, 0.0, np.inf)
        else:
            self.restrict(0.0, edge, edge, float(np.nextafter(edge, np.inf)))

    def restart(self) -> None:
        """A new session: scheme and frame from the start; what is known of t_c, t_e is kept."""
        self._commit()
        self.paths.forget_trunk()
        if self.certain:  # those that lost more or fewer steps are one again
            self.beam.keep(np.array([self.beam.best]))
            self.doubt()
        everyone = slice(0, self.beam.n)
        self.beam.state[everyone] = 0
        self._frames.begin(everyone)

    # --- one transition ---------------------------------------------------------------------------

    def step(self, k: int, gauges: Sequence[float], cipher: int) -> None:
        """Count one transition that was seen whole.

        Parameters
        ----------
        k : int
        gauges : sequence of float, shape (M,)
            Of x(k+1) about each centre, in the unit in which t_c and t_e are searched.
        cipher : int
        """
        h = self.beam
        nearest = min(gauges)
        if self.certain:
            symbol = np.full(h.n, gauges.index(nearest))
            self._advance(k, symbol, self._values(cipher))
            return
        ordered = sorted(gauges)
        second, largest = ordered[1], ordered[-1]
        self._cut("lo", "hi", nearest)
        self._cut("lo", "hi", second)
        inside = (h.lo[: h.n] >= nearest) & (h.hi[: h.n] <= second)
        if self._cut("edge_lo", "edge_hi", largest, inside):
            inside = (h.lo[: h.n] >= nearest) & (h.hi[: h.n] <= second)
        agreed = inside & (h.edge_lo[: h.n] >= largest)
        outside = h.hi[: h.n] <= nearest
        if outside.any():
            h.score[: h.n][outside] += OUTSIDE
        verdicts = np.where(agreed, gauges.index(nearest), NO_SYMBOL)
        self._advance(k, verdicts, self._values(cipher))

    def doubt(self) -> None:
        """From here on all agree again from some transition on; ``lo`` says who has begun."""
        self.beam.lo[: self.beam.n] = 0.0

    def step_doubtful(
        self, k: int, shares: Sequence[float] | None, cipher: int | None, loss: float
    ) -> None:
        """Count one of the transitions in which all agree from some one on.

        A hypothesis that has not begun to agree goes on as one that begins here, and one that does
        not; where its verdict does not count it need not be told.

        Parameters
        ----------
        k : int
        shares : sequence of float, shape (M,), optional
            Probability of each candidate; None where each is as likely.
        cipher : int, optional
        loss : float
            Probability that one more is lost.
        """
        h = self.beam
        waiting = np.flatnonzero((h.lo[: h.n] == 0.0) & self._tested())
        begins = h.copy(waiting)
        h.lo[begins] = 1.0
        h.score[begins] += np.log(1 - loss)
        h.score[waiting] += np.log(loss)
        self._step_known(k, shares, cipher)

    def step_known(self, k: int, shares: Sequence[float] | None, cipher: int | None) -> None:
        """Count a transition in which all agree, on a candidate that is known so well."""
        self.beam.lo[: self.beam.n] = 1.0
        self._step_known(k, shares, cipher)

    def _step_known(self, k: int, shares: Sequence[float] | None, cipher: int | None) -> None:
        row = np.full(self.size, 1 / self.size) if shares is None else np.array(shares)
        values = self._values_of(cipher)
        tested = np.flatnonzero(self._tested())
        chances = np.zeros((len(tested), 1 + self.size))
        begun = self.beam.lo[tested] > 0.0
        chances[:, 0] = ~begun
        chances[:, 1:] = begun[:, None] * row
        self._branch(k, tested, chances, values)

    def restrict(self, lo: float, hi: float, edge_lo: float, edge_hi: float) -> None:
        """Begin with this rectangle: t_c and t_e from and to."""
        h = self.beam
        h.lo[0], h.hi[0], h.edge_lo[0], h.edge_hi[0] = lo, hi, edge_lo, edge_hi

    def widen(self, factor: float) -> None:
        """Let every hypothesis hold thresholds that are so much smaller and larger too."""
        h = self.beam
        for low, high in ((h.lo, h.hi), (h.edge_lo, h.edge_hi)):
            low[: h.n] /= factor
            high[: h.n] *= factor

    def split_evenly(self, edges: Sequence[float]) -> None:
        """Cut the one hypothesis of the beginning at each t_c of ``edges``."""
        for edge in () if self.certain else edges:
            self._cut("lo", "hi", edge)

    def step_missed(self, k: int, cipher: int | None) -> None:
        """Count one transition without a verdict: taken for one without an agreement.

        Where every transition agrees, each symbol is as likely.
        """
        no = np.full((1, self.size), np.inf)
        self.step_sampled(k, no, cipher)

    def step_sampled(self, k: int, samples: Array, cipher: int | None) -> None:
        """Count one transition of which something was missed or blurred.

        Each hypothesis whose verdict counts goes on as one for every outcome that is likely enough.

        Parameters
        ----------
        k : int
        samples : array, shape (S, M)
            Equally likely values of the gauges.
        cipher : int, optional
            None where it was missed: then every message symbol is possible.
        """
        ordered = np.sort(samples, axis=1)
        choice = samples.argmin(axis=1)
        values = self._values_of(cipher)
        tested = np.flatnonzero(self._tested())
        self._branch(k, tested, self._chances(tested, ordered, choice), values)

    def _values_of(self, cipher: int | None) -> Indices:
        """The message symbol that this step carries; where the cipher was missed, each one."""
        h = self.beam
        values = self._values(0 if cipher is None else cipher)
        if cipher is None:
            carriers = np.flatnonzero(values != NO_SYMBOL)
            values[carriers] = 0
            for value in range(1, self.size):
                values = np.append(values, np.full(len(h.copy(carriers)), value))
            h.score[: h.n][values != NO_SYMBOL] -= np.log(self.size)
        return values

    def _branch(self, k: int, tested: Indices, chances: Array, values: Indices) -> None:
        """Go on with each outcome that is likely enough.

        Parameters
        ----------
        tested : integer array
            Hypotheses whose verdict counts.
        chances : array, shape (tested, 1 + M)
            Probability of each outcome: no agreement, symbol 0, 1, ...
        values : integer array
            The message symbol that each hypothesis carries, or -1.
        """
        h = self.beam
        verdicts = np.full(h.n, NO_SYMBOL)
        best = chances.argmax(axis=1)
        for outcome in range(self.size + 1):
            likely = (best != outcome) & (chances[:, outcome] > UNLIKELY)
            also = tested[likely]
            if len(also):
                copies = h.copy(also)
                h.score[copies] += np.log(chances[likely, outcome])
                verdicts = np.append(verdicts, np.full(len(copies), outcome - 1))
                values = np.append(values, values[also])
        verdicts[tested] = best - 1
        h.score[tested] += np.log(chances[np.arange(len(tested)), best])
        self._advance(k, verdicts, values)

    def _tested(self) -> Flags:
        """Which hypotheses take this step for one whose verdict counts."""
        tested: Flags = self._table.tests[self.beam.state[: self.beam.n]]
        return tested

    def _values(self, cipher: int) -> Indices:
        """The message symbol that this step carries in each hypothesis, or -1 for none."""
        pads = self._table.pad  # of the states, which are fewer than the hypotheses
        carried = np.where(pads == NO_SYMBOL, NO_SYMBOL, (cipher - pads) % self.size)
        values: Indices = carried[self.beam.state[: self.beam.n]]
        return values

    def _advance(self, k: int, verdicts: Indices, values: Indices) -> None:
        """Let the scheme go on in every hypothesis, and take the message symbols."""
        h = self.beam
        h.state[: h.n] = self._table.following(h.state[: h.n], verdicts)
        carriers = np.flatnonzero(values != NO_SYMBOL)
        if len(carriers):
            symbols = values[carriers]
            h.node[carriers] = self.paths.extend(k, h.node[carriers], symbols)
            self._frames.push(carriers, symbols)
        self._prune(k)

    def _chances(self, tested: Indices, ordered: Array, choice: Indices) -> Array:
        """Probability of each outcome (no agreement, symbol 0, 1, ...), shape (rows, 1 + M)."""
        chances = np.zeros((len(tested), 1 + self.size))
        if self.certain:
            blind = not np.isfinite(ordered[:, 0]).any()
            shares = np.bincount(choice, minlength=self.size) / len(choice)
            chances[:, 1:] = 1.0 / self.size if blind else shares
            return chances
        h = self.beam
        lo, hi = h.lo[tested][:, None], np.minimum(h.hi[tested], 1e9)[:, None]
        nearest, second, largest = ordered[:, 0], ordered[:, 1], ordered[:, -1]
        overlap = np.minimum(hi, second) - np.maximum(lo, nearest)
        agree = np.clip(overlap / (hi - lo), 0.0, 1.0)
        agree *= h.edge_lo[tested][:, None] >= largest
        for symbol in range(self.size):
            chances[:, 1 + symbol] = agree[:, choice == symbol].sum(axis=1) / len(choice)
        chances[:, 0] = np.maximum(1.0 - chances[:, 1:].sum(axis=1), 0.0)
        return chances

    def _cut(self, low: str, high: str, at: float, where: Flags | None = None) -> bool:
        """Split the hypotheses whose verdict counts and whose interval holds ``at`` inside.

        Says whether there was one.
        """
        h = self.beam
        crossed = (getattr(h, low)[: h.n] < at) & (getattr(h, high)[: h.n] > at)
        if where is not None:
            crossed &= where
        which = np.flatnonzero(crossed)
        which = which[self._table.tests[h.state[which]]]
        if not len(which):
            return False
        copies = h.copy(which)
        getattr(h, low)[copies] = at
        getattr(h, high)[which] = at
        return True

    # --- the list ---------------------------------------------------------------------------------

    def _collapse(self, k: int) -> None:
        """Where the best hypothesis is one whose frame check held, drop those whose did not."""
        h = self.beam
        passed = h.passed[: h.n]
        best = h.best
        if passed[best] <= self._passed:
            self._frames.held = bool(passed.max() > self._passed)
            return
        self._frames.held = False
        self._passed = int(passed[best])
        if self.solved_k < 0:
            self.solved_k = k
        payload = self._last_frame(int(h.node[best]))
        if payload is not None:
            self.whole_at.append(((self.session, k), payload))
            del self.whole_at[:-KEPT_MESSAGES]
            self.whole_count += 1
        h.keep(np.flatnonzero(passed == passed[best]))
        self._commit()
        self.paths.end_frame()

    def _last_frame(self, node: int) -> bytes | None:
        deframer = Deframer(self.size)
        payload = None
        for symbol in self.paths.frame(node):
            whole = deframer.push(symbol)
            if whole is not None:
                payload = whole
        return payload

    def _prune(self, k: int) -> None:
        h = self.beam
        self.peak = max(self.peak, h.n)
        if self._frames.held:
            self._collapse(k)
        score = h.score[: h.n]
        if h.n > self._cap:
            order = np.argpartition(-score, self._cap * 3 // 4)[: self._cap * 3 // 4]
            self.dropped += h.n - len(order)
            h.keep(np.sort(order))
        elif self.whole_count and h.n > 1:
            behind = score < score.max() - BEHIND
            if behind.any():
                h.keep(np.flatnonzero(~behind))
        if len(self.paths) > NODES:
            self._compact()
            while len(self.paths) > NODES // 2 and h.n > 1:
                self._halve()
                self._compact()
            if h.n == 1:
                self._commit()

    def _compact(self) -> None:
        h = self.beam
        h.node[: h.n] = self.paths.compact(h.node[: h.n])

    def _halve(self) -> None:
        h = self.beam
        order = np.argsort(-h.score[: h.n], kind="stable")[: (h.n + 1) // 2]
        self.dropped += h.n - len(order)
        h.keep(np.sort(order))

    def _commit(self) -> None:
        """Take the best hypothesis's symbols for granted and forget all paths."""
        h = self.beam
        self.paths.commit(int(h.node[h.best]))
        h.node[: h.n] = -1
        h.score[: h.n] -= h.score[: h.n].max()

    # --- what she thinks --------------------------------------------------------------------------

    @property
    def whole(self) -> list[bytes]:
        """The last messages whose frame check held."""
        return [payload for _, payload in self.whole_at]

    @property
    def hypotheses(self) -> int:
        """Rectangles on the list."""
        return self.beam.n

    @property
    def _best_path(self) -> int:
        return int(self.beam.node[self.beam.best])

    def candidates(self) -> int:
        """Distinct message decodings on the list."""
        h = self.beam
        return len(np.unique(h.node[: h.n])) if h.n > 1 else 1

    def confidence(self) -> float:
        """Share of the best hypothesis's decoding among all, taking the scores at their word."""
        h = self.beam
        score = h.score[: h.n]
        weight = np.exp(score - score.max())
        return float(weight[h.node[: h.n] == self._best_path].sum() / weight.sum())

    def message_symbols(self) -> list[tuple[int, int]]:
        """Step and message symbol along the best hypothesis, the newest that are kept."""
        return self.paths.steps_and_symbols(self._best_path)

    def under_way(self) -> bytes:
        """The payload under way along the best hypothesis; without frames, all of the text."""
        if not self.framed:
            return bytes_of((s for _, s in self.message_symbols()), self.size)
        deframer = Deframer(self.size)
        for symbol in self.paths.frame(self._best_path):
            deframer.push(symbol)
        return deframer.partial

    def thresholds(self) -> tuple[float, float, float, float]:
        """The best hypothesis's rectangle: t_c from, to, and t_e from, to."""
        h, best = self.beam, self.beam.best
        return float(h.lo[best]), float(h.hi[best]), float(h.edge_lo[best]), float(h.edge_hi[best])

    def testing(self) -> bool:
        """Whether the best hypothesis takes the next transition for a tested one."""
        return bool(self._table.tests[self.beam.state[self.beam.best]])


def bytes_of(symbols: Iterable[int], size: int) -> bytes:
    """Symbols as bytes, most significant digit first; what exceeds 255 becomes 255."""
    digits = digits_of(1, size)
    out, value, count = bytearray(), 0, 0
    for symbol in symbols:
        value, count = value * size + symbol, count + 1
        if count == digits:
            out.append(min(value, 255))
            value = count = 0
    return bytes(out)
