"""The scheme over many runs: counts for every alpha at once, or the whole transfer for one."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Counts, Flags, Symbols
from protocol.brief import Brief
from protocol.schemes.base import Carries, Scheme
from protocol.schemes.framing import IDLE, Deframer, encode_frame, frame_length
from protocol.schemes.registry import make_scheme
from protocol.schemes.table import advance_many
from wyner.simulate.engine.corrected import Followed, corrected, sent_again
from wyner.simulate.engine.draws import cipher_symbols, symbol_type
from wyner.simulate.engine.loop import Runs


@dataclass(frozen=True, eq=False, repr=False)
class LinkCounts(Brief):
    """What each run's link did at each alpha; every array has shape (alphas, R).

    Parameters
    ----------
    tested : int array
        Transitions whose verdict counted.
    agreements : int array
        Of these, the ones in Diff.
    message_symbols : int array
        Transitions that carried one.
    mistaken : int array
        Agreements on another symbol than the coin b_r; none while d is in D_c. Where words are
        corrected: estimates before that.
    """

    tested: Counts
    agreements: Counts
    message_symbols: Counts
    mistaken: Counts

    def brief(self) -> dict[str, object]:
        """How many alphas and runs, and sums over them."""
        alphas, runs = self.tested.shape
        sums = ("tested", "agreements", "message_symbols", "mistaken")
        return {"alphas": alphas, "runs": runs, **{n: int(getattr(self, n).sum()) for n in sums}}


def carries(runs: Runs, alphas: Sequence[float]) -> Carries:
    """What the scheme makes of every transition; arrays of shape (steps, alphas, R)."""
    return followed(runs, alphas).carries


def followed(runs: Runs, alphas: Sequence[float]) -> Followed:
    """The same, with what travelled in clear where words are corrected."""
    limit = np.asarray(alphas, dtype=float)[None, :, None]
    possible = runs.largest[:, None, :] <= limit
    # NO_SYMBOL is -1, all bits set: or-ing it in is many times faster than choosing
    verdicts = np.subtract(possible, 1, dtype=runs.symbol.dtype)
    np.bitwise_or(verdicts, runs.symbol[:, None, :], out=verdicts)
    secrecy = runs.scenario.secrecy
    scheme = make_scheme(secrecy.scheme, secrecy.candidates)
    coins = np.broadcast_to(runs.coin[:, None, :], verdicts.shape)
    if runs.missed is None:
        return _followed(scheme, verdicts, coins)
    # A missed step is no transition: each run's transitions come first, and go back to their steps.
    order = transitions_first(runs.missed)[:, None, :]
    many = _followed(
        scheme, *(np.take_along_axis(part, order, axis=0) for part in (verdicts, coins))
    )
    nothing = runs.missed[:, None, :]
    agreed, pad, tested = (_at_steps(part, order) for part in many.carries)
    agreed[np.broadcast_to(nothing, agreed.shape)] = NO_SYMBOL
    pad[np.broadcast_to(nothing, pad.shape)] = NO_SYMBOL
    tested[np.broadcast_to(nothing, tested.shape)] = False
    clear, ended = (
        None if part is None else _at_steps(part, order) for part in (many.clear, many.ended)
    )
    if clear is not None and ended is not None:
        clear[np.broadcast_to(nothing, clear.shape)] = NO_SYMBOL
        ended &= ~nothing
    return Followed(Carries(agreed, pad, tested), clear, ended)


def _followed(scheme: Scheme[Any], verdicts: Symbols, coins: Symbols) -> Followed:
    if scheme.corrects:
        return corrected(scheme, verdicts, coins)
    return Followed(advance_many(scheme, verdicts))


def transitions_first(missed: NDArray[np.bool_]) -> NDArray[np.intp]:
    """For each run the steps of its transitions in their order, and then those missed."""
    order: NDArray[np.intp] = np.argsort(missed, axis=0, kind="stable")
    return order


def _at_steps(values: NDArray[Any], order: NDArray[np.intp]) -> NDArray[Any]:
    """What stands by transition, put to its steps."""
    out = np.empty_like(values)
    np.put_along_axis(out, np.broadcast_to(order, values.shape), values, axis=0)
    return out


def _count(flags: NDArray[np.bool_]) -> Counts:
    """How many are set along the first axis: bytes are added up, as many as fit in one."""
    count = np.zeros(flags.shape[1:], dtype=np.int64)
    for first in range(0, len(flags), 255):
        count += np.add.reduce(flags[first : first + 255].view(np.uint8), axis=0, dtype=np.uint8)
    return count


def _mistaken(runs: Runs, agreed: Symbols) -> Flags:
    """Keys that are not the coin; where words are corrected, estimates that are not."""
    coin = runs.coin[:, None, :]
    scheme = make_scheme(runs.scenario.secrecy.scheme, runs.scenario.secrecy.candidates)
    if scheme.corrects:
        wrong: Flags = (runs.symbol != runs.coin)[:, None, :]
        return np.broadcast_to(wrong, agreed.shape)
    unlike: Flags = (agreed != NO_SYMBOL) & (agreed != coin)
    return unlike


def follow(runs: Runs, alphas: Sequence[float]) -> LinkCounts:
    """Count what the link did at each of ``alphas``, from one simulation."""
    agreed, pad, tested = carries(runs, alphas)
    gained = agreed != NO_SYMBOL
    return LinkCounts(
        tested=_count(tested),
        agreements=_count(gained),
        message_symbols=_count(pad != NO_SYMBOL),
        mistaken=_count(_mistaken(runs, agreed)),
    )


@dataclass(frozen=True, eq=False, repr=False)
class Transfer(Brief):
    """The link of each run, transition by transition; time first, runs last.

    Parameters
    ----------
    cipher : integer array, shape (steps, R)
        The symbol that travels with the candidates.
    agreed : integer array, shape (steps, R)
        The key symbol gained, or -1.
    pad : integer array, shape (steps, R)
        The key symbol under which ``cipher`` travelled, or -1.
    message_symbol : integer array, shape (steps, R)
        The message symbol recovered on the transition, or -1.
    p : int array, shape (steps, R)
        Message symbols up to here.
    ended : bool array, shape (steps, R), optional
        Where words are corrected: transitions with which a session ended.
    """

    cipher: Symbols
    agreed: Symbols
    pad: Symbols
    message_symbol: Symbols
    p: NDArray[np.int64]
    ended: Flags | None = None

    def brief(self) -> dict[str, object]:
        """How many steps and runs, and what they carried."""
        steps, runs = self.agreed.shape
        return {
            "steps": steps,
            "runs": runs,
            "agreements": int((self.agreed != NO_SYMBOL).sum()),
            "message_symbols": int((self.message_symbol != NO_SYMBOL).sum()),
        }


def transfer(
    runs: Runs,
    alpha: float | None = None,
    payloads: Sequence[bytes] = (),
    symbols: Sequence[int] = (),
    covers: Symbols | None = None,
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
    covers : integer array, shape (steps, R), optional
        What travels where nothing is carried, in place of the seed's own streams.
    """
    size = runs.scenario.secrecy.candidates
    limit = runs.scenario.secrecy.alpha if alpha is None else alpha
    stream = [*symbols, *(v for payload in payloads for v in encode_frame(payload, size))]
    text = np.full(len(stream) + runs.steps + 1, IDLE, dtype=np.int16)
    text[: len(stream)] = stream
    many, clear, ended = followed(runs, [limit])
    kind = symbol_type(size)
    agreed, pad = many.agreed[:, 0].astype(kind), many.pad[:, 0].astype(kind)
    carried = pad != NO_SYMBOL
    p = carried.cumsum(axis=0, dtype=np.int64)
    index, torn = np.maximum(p - 1, 0), np.zeros(carried.shape, bool)
    if ended is not None:
        lengths = [len(symbols), *(frame_length(len(payload), size) for payload in payloads)]
        frames = np.cumsum(lengths).tolist()
        for r in range(carried.shape[1]):
            index[:, r], torn[:, r] = sent_again(carried[:, r], ended[:, 0, r], frames)
    sent = text[index]
    if covers is None:
        covers = cipher_symbols(runs.seed, runs.runs, runs.steps, size)
    cipher = covers.astype(kind)
    if runs.missed is not None:
        cipher = _at_steps(cipher, transitions_first(runs.missed))
    if clear is not None:
        np.copyto(cipher, clear[:, 0], where=clear[:, 0] != NO_SYMBOL)
    np.copyto(cipher, ((sent + pad) % size).astype(kind), where=carried)
    recovered = (cipher.astype(np.int16) - pad) % size
    return Transfer(
        cipher=cipher,
        agreed=agreed,
        pad=pad,
        message_symbol=np.where(carried & ~torn, recovered, NO_SYMBOL).astype(kind),
        p=p,
        ended=None if ended is None else ended[:, 0],
    )


def whole_messages(symbols: Iterable[int], size: int) -> list[bytes]:
    """The messages in one run's message symbols over M = ``size``, -1 where there was none."""
    deframer = Deframer(size)
    payloads = [deframer.push(symbol) for symbol in symbols if symbol != NO_SYMBOL]
    return [payload for payload in payloads if payload is not None]
