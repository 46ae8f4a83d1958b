"""Where in the transcript each message symbol may have been carried, and what it may have been.

A node is a step and the scheme's state before it. From node to node one message symbol is carried:
the band of this lattice says with what probability, for every symbol. Everything is a ratio to
random symbols, so that a stretch of which nothing is said counts one. A verdict may depend on
the scheme's state, and so on the verdict before where the state holds its key, and on nothing else.
"""

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from protocol.arrays import Array, Integers, Narrow
from protocol.schemes.framing import IDLE, START
from protocol.schemes.table import StateTable

LONGEST_WAIT: Final = 96
"""Steps from one message symbol to the next that are followed."""

FORGOTTEN: Final = 1e-9
"""Probability of a longer wait that is not followed."""

BEGINS: Final = 0.03
"""Probability that a symbol between two messages begins one."""

ENDS: Final = 0.004
"""Probability that a symbol within a message that is not looked at is its last."""

SHORT_SHARE: Final = 0.9
"""Probability of a message shorter than 256 bytes."""

TINY: Final = 1e-300


class Lattice:
    """The steps of one stretch of a session.

    Parameters
    ----------
    table : StateTable
    verdicts : array, shape (K, E, 1 + M)
        Probability of each step's verdict (none, symbol 0, 1, ...) in each state of the scheme.
    ciphers : integer array, shape (K,)
        The ciphertext symbols, -1 where one was missed.
    entry : array, shape (states,)
        Probability of the scheme's state before the first step.
    made : array, shape (K,)
        Probability that the plant took the step's offer; else the scheme stands still.

    Attributes
    ----------
    steps : int
        K.
    states : int
        E, states of the scheme.
    wait : int
        G, steps within which the next symbol is carried.
    band : array, shape (M, K, E, G, E)
        From node (k, e) to node (k + 1 + g, f), carrying symbol m.
    left : array, shape (K + 1, E)
        That no further symbol is carried.
    rate : float
        Symbols carried a step.
    """

    def __init__(
        self, table: StateTable, verdicts: Array, ciphers: Integers, entry: Array, made: Array
    ) -> None:
        self.steps, self.size = len(verdicts), verdicts.shape[2] - 1
        self.entry = entry
        self.states = E = len(entry)
        K, M = self.steps, self.size
        emit = np.ones((M, K, E))  # of symbol m at step k in state e
        pads = table.pad[:E]
        for e in np.flatnonzero(pads >= 0):
            heard = ciphers >= 0
            carried = (ciphers - pads[e]) % M
            for m in range(M):
                emit[m, heard, e] = M * (carried[heard] == m)
        following = table.all_following()
        carries = pads >= 0
        now = np.zeros((K, E, E))  # begun in (k, e), now in f after g steps, nothing carried
        now[:, np.arange(E), np.arange(E)] = 1.0
        self.left = np.zeros((K + 1, E))
        self.left[K] = 1.0
        parts = []
        for g in range(min(LONGEST_WAIT, K)):
            count = K - g
            part = np.zeros((M, K, E, E))
            after = np.zeros((K, E, E))
            for f in range(E):
                if not now[:count, :, f].any():
                    continue
                after[:count, :, f] += now[:count, :, f] * (1 - made[g:, None])
                for v in range(M + 1):
                    p = now[:count, :, f] * (made[g:] * verdicts[g:, f, v])[:, None]
                    to = following[f, v]
                    if carries[f]:
                        part[:, :count, :, to] += p[None] * emit[:, g:, f, None]
                    else:
                        after[:count, :, to] += p
            parts.append(part)
            self.left[count - 1] = after[count - 1].sum(axis=1)
            after[count - 1] = 0.0
            now = after
            if now.max() < FORGOTTEN:
                break
        self.wait = len(parts)
        self.band = np.stack(parts, axis=3)
        self.uniform = self.band.mean(axis=0)
        waits = self.uniform.sum(axis=(0, 1, 3))
        self.rate = float(waits.sum() / max(waits @ np.arange(1, self.wait + 1), TINY))

    # --- sweeps -----------------------------------------------------------------------------------

    def idle_until(self, begin: Array) -> Array:
        """Log weight that all symbols are idle from ``begin``, shape (K + 1, E), up to each node.

        ``begin`` holds log weights too.
        """
        kernel = (1 - BEGINS) * self.band[IDLE]
        out = begin.copy()
        for k in range(self.steps):
            level = float(out[k].max())
            if level == -np.inf:
                continue
            reach = min(self.wait, self.steps - k)
            w = np.einsum("e,egf->gf", np.exp(out[k] - level), kernel[k][:, :reach])
            to = slice(k + 1, k + 1 + reach)
            out[to] = np.logaddexp(out[to], _log(w) + level)
        return out

    def outside(self) -> Array:
        """Log weight of all that follows each node where no message is under way there.

        Shape (K + 1, E).
        """
        K = self.steps
        both = np.zeros((2, K + 1, self.states))  # outside a message, inside one
        kernel = np.stack([(1 - BEGINS) * self.band[IDLE], BEGINS * self.band[START]])
        for k in range(K - 1, -1, -1):
            reach = min(self.wait, K - k)
            part = both[:, k + 1 : k + 1 + reach]
            level = max(float(part.max()), 0.0)
            o, i = np.exp(part - level)
            end = self.left[k] * np.exp(-level)
            idle, start = kernel[:, k, :, :reach]
            out = np.einsum("egf,gf->e", idle, o) + np.einsum("egf,gf->e", start, i) + end
            inside = np.einsum("egf,gf->e", self.uniform[k][:, :reach], (1 - ENDS) * i + ENDS * o)
            both[0, k], both[1, k] = _log(out) + level, _log(inside + end) + level
        outside: Array = both[0]
        return outside

    def ahead(self, outside: Array, symbols: int) -> Narrow:
        """Log weight of all that follows where ``symbols`` of any kind end the message.

        Shape (symbols + 1, K + 1, E), in single precision: with 4096 steps it is a third of a GB.
        """
        K, G = self.steps, self.wait
        out = np.empty((symbols + 1, K + 1, self.states), dtype=np.float32)
        out[0] = last = outside
        kernel = self.uniform.swapaxes(2, 3).reshape(K, self.states, -1)
        # a long silence is worth more than a float holds: each node has a level of its own
        own, values = np.full(K + 1 + G, -np.inf), np.zeros((K + 1 + G, self.states))
        own_after = sliding_window_view(own, G)[1:]
        values_after = sliding_window_view(values, G, axis=0)[1 : K + 1]
        for r in range(1, symbols + 1):
            own[: K + 1] = last.max(axis=1)
            values[: K + 1] = np.exp(last - own[: K + 1, None])
            level = np.maximum(own_after.max(axis=1), 0.0)
            share = np.exp(own_after[:K] - level[:K, None])
            now = self.left * np.exp(-level)[:, None]
            now[:K] += np.einsum(
                "kem,km->ke", kernel, (values_after * share[:, None]).reshape(K, -1)
            )
            out[r] = last = _log(now) + level[:, None]
        return out

    def none_after(self, begin: Array) -> float:
        """Log weight that nothing but silence follows ``begin``, log weights of nodes."""
        with np.errstate(divide="ignore"):
            return float(np.logaddexp.reduce((self.idle_until(begin) + np.log(self.left)).ravel()))

    def moved(self, weights: Array, symbol: int | None, low: int) -> Array:
        """Rows of weights of a window's nodes, shape (R, count E), after a symbol, any if None.

        The window begins at step ``low``; returns shape (R, (count + G) E), from step ``low`` + 1.
        """
        rows, E = len(weights), self.states
        nodes = weights.reshape(rows, -1, 1, E)
        count = nodes.shape[1]
        have = min(count, self.steps - low)
        out = np.zeros((rows, count + self.wait, E))
        band = self.uniform if symbol is None else self.band[symbol]
        for g in range(self.wait):
            out[:, g : g + have] += (nodes[:, :have] @ band[low : low + have, :, g])[:, :, 0]
        return out.reshape(rows, (count + self.wait) * E)

    def window(self, low: int, count: int) -> Array:
        """The band from ``count`` steps on from ``low`` as matrices, one a symbol.

        Shape (M, count E, (count + G) E): to nodes from step ``low`` + 1 on.
        """
        E, M = self.states, self.size
        out = np.zeros((M, count, E, count + self.wait, E))
        for i in range(count):
            if low + i < self.steps:
                out[:, i, :, i : i + self.wait] = self.band[:, low + i]
        return out.reshape(M, count * E, (count + self.wait) * E)


def _log(values: Array) -> Array:
    """The logarithm, of nothing too."""
    return np.log(np.maximum(values, TINY))
