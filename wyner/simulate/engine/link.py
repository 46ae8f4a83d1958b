"""Both automata over many runs: counts for every alpha at once, or the whole transfer for one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.agreement import NO_SYMBOL
from protocol.schemes.framing import IDLE, encode_frame
from protocol.schemes.switched import MESSAGE, TEST
from wyner.simulate.engine.draws import cipher_symbols
from wyner.simulate.engine.loop import Runs

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Symbols = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Link:
    """What each run's link did at each alpha; every array has shape (alphas, R).

    Parameters
    ----------
    tested : int array
        Transitions in state 1.
    agreements : int array
        Of these, the ones in Diff.
    message_symbols : int array
        Transitions in state 2, each with one message symbol.
    mistaken : int array
        Agreements on another symbol than the coin b_r; none while d is in D_c.
    """

    tested: Counts
    agreements: Counts
    message_symbols: Counts
    mistaken: Counts


def agreed_transitions(runs: Runs, alphas: Sequence[float]) -> NDArray[np.bool_]:
    """Where a key symbol was agreed, shape (steps, alphas, R).

    A transition is tested unless the one before it agreed (state 2), so that the automaton's whole
    state is the last transition's flag.
    """
    limit = np.asarray(alphas, dtype=float)[None, :, None]
    agreed: NDArray[np.bool_] = runs.largest[:, None, :] <= limit
    agreed &= (runs.symbol != NO_SYMBOL)[:, None, :]
    for k in range(1, len(agreed)):
        np.greater(agreed[k], agreed[k - 1], out=agreed[k])
    return agreed


def follow(runs: Runs, alphas: Sequence[float]) -> Link:
    """Count what the link did at each of ``alphas``, from one simulation."""
    agreed = agreed_transitions(runs, alphas)
    mistaken = (runs.symbol != runs.coin)[:, None, :]
    messages = agreed[:-1].sum(axis=0, dtype=np.int64)
    return Link(
        tested=runs.steps - messages,
        agreements=agreed.sum(axis=0, dtype=np.int64),
        message_symbols=messages,
        mistaken=(agreed & mistaken).sum(axis=0, dtype=np.int64),
    )


@dataclass(frozen=True, eq=False)
class Transfer:
    """The link of each run, transition by transition; time first, runs last.

    Parameters
    ----------
    cipher : int8 array, shape (steps, R)
        The symbol that travels with the candidates.
    s : int8 array, shape (steps, R)
        Both automata's state after the transition, 1 or 2.
    key : int8 array, shape (steps, R)
        The key symbol held afterwards, or -1.
    message_symbol : int8 array, shape (steps, R)
        The message symbol recovered on the transition, or -1.
    p : int array, shape (steps, R)
        Message symbols up to here.
    """

    cipher: Symbols
    s: Symbols
    key: Symbols
    message_symbol: Symbols
    p: NDArray[np.int64]


def transfer(
    runs: Runs,
    alpha: float | None = None,
    payloads: Sequence[bytes] = (),
    symbols: Sequence[int] = (),
) -> Transfer:
    """Send a message over every run's link and recover it (Fig. 5).

    Parameters
    ----------
    runs : Runs
    alpha : float, optional
        The scenario's own by default.
    payloads : sequence of bytes
        Framed, one after the other, then idle symbols.
    symbols : sequence of int
        Raw message symbols instead, for a link without frames.
    """
    size = runs.scenario.secrecy.candidates
    limit = runs.scenario.secrecy.alpha if alpha is None else alpha
    stream = [*symbols, *(v for payload in payloads for v in encode_frame(payload, size))]
    text = np.full(len(stream) + runs.steps + 1, IDLE, dtype=np.int8)
    text[: len(stream)] = stream
    agreed = agreed_transitions(runs, [limit])[:, 0]
    carried = np.zeros_like(agreed)  # state 2 during the transition
    carried[1:] = agreed[:-1]
    key = np.where(agreed, runs.symbol, np.int8(NO_SYMBOL))
    in_use = np.full_like(key, NO_SYMBOL)
    in_use[1:] = key[:-1]
    p = carried.cumsum(axis=0, dtype=np.int64)
    sent = text[np.maximum(p - 1, 0)]
    cipher = cipher_symbols(runs.seed, runs.runs, runs.steps, size)
    np.copyto(cipher, (sent + in_use) % size, where=carried)
    recovered = (cipher - in_use) % size
    return Transfer(
        cipher=cipher,
        s=np.where(agreed, np.int8(MESSAGE), np.int8(TEST)),
        key=key,
        message_symbol=np.where(carried, recovered, np.int8(NO_SYMBOL)),
        p=p,
    )
