"""Schemes that correct words, run by run: the plant's states beside the controller's."""

from typing import Any, NamedTuple

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Flags, Symbols
from protocol.schemes.base import Carries, Scheme


class Followed(NamedTuple):
    """What a scheme makes of every transition; time is the first axis.

    Parameters
    ----------
    carries : Carries
    clear : integer array, optional
        Of a scheme that corrects: the symbol that travelled in clear, or -1.
    ended : bool array, optional
        Of such a scheme: transitions with which the session ended, as the words differed.
    """

    carries: Carries
    clear: Symbols | None = None
    ended: Flags | None = None


def corrected(scheme: Scheme[Any], verdicts: Symbols, coins: Symbols) -> Followed:
    """Advance both ends of many runs, each from the initial state, over (steps, ...) transitions.

    After words that differ both begin anew, with the next transition.
    """
    agreed, pad, clear = (np.full_like(verdicts, NO_SYMBOL) for _ in range(3))
    ended = np.zeros(verdicts.shape, dtype=bool)
    for run in np.ndindex(verdicts.shape[1:]):
        controller = plant = scheme.initial
        at = (slice(None), *run)
        for k, (verdict, coin) in enumerate(
            zip(verdicts[at].tolist(), coins[at].tolist(), strict=True)
        ):
            here = (k, *run)
            clear[here] = shown = scheme.clear(controller)
            if shown != NO_SYMBOL:
                plant = scheme.hear(plant, shown)
            controller, (agreed[here], pad[here]) = scheme.advance(controller, verdict)
            plant, _ = scheme.advance(plant, coin)
            if scheme.differs(plant):
                ended[here] = True
                controller = plant = scheme.initial
    return Followed(Carries(agreed, pad, np.ones(verdicts.shape, dtype=bool)), clear, ended)


def sent_again(
    carried: Flags, ended: Flags, frames: list[int]
) -> tuple["np.ndarray[Any, np.dtype[np.int64]]", Flags]:
    """Where in the text each symbol of one run comes from, and the symbols of torn frames.

    With the session the frame under way is torn, and starts again.

    Parameters
    ----------
    carried, ended : bool array, shape (steps,)
    frames : list of int
        Where in the text the frames end; what is behind them is idle.
    """
    index, torn = np.zeros(len(carried), np.int64), np.zeros(len(carried), bool)
    at = begin = 0
    since: list[int] = []
    for k, (carries, ends) in enumerate(zip(carried.tolist(), ended.tolist(), strict=True)):
        if carries:
            index[k], at = at, at + 1
            since.append(k)
        if at in frames or at > frames[-1]:
            begin, since = at, []
        if ends:
            torn[since] = True
            at, since = begin, []
    return index, torn
