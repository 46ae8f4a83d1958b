"""Keys and message symbols step by step, once the messages are known or taken for known.

Forwards and backwards over the steps, with how much of the messages was carried so far.
"""

from typing import Final

import numpy as np

from protocol.arrays import Array, Integers
from protocol.schemes.framing import IDLE
from protocol.schemes.table import StateTable
from tap_service.inference.lattice import BEGINS

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
