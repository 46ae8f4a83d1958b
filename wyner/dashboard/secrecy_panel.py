"""The secrecy panel: what counts as secret against what is true, keys, and the taps in a table."""

import math
from collections.abc import Sequence
from typing import Final

from rich.text import Text

from protocol.relabelling import KnownSymbols
from protocol.statistics import bits_left
from wyner.dashboard.model import LoopState, TapState
from wyner.dashboard.score import SecrecyScore, attacker, characters_right, contradictions
from wyner.dashboard.text import (
    LEVELS,
    STYLES,
    VALUE_AT,
    count,
    drawn,
    labelled,
    line,
    longest,
    percent,
)

BARS: Final = 30
"""Cells of the bar of the bits that the paper's rule counts."""


def amounts(its: SecrecyScore, width: int) -> list[Text]:
    """Bits that the paper's rule counts as secret and bits that are true, on one scale."""
    claimed = f"{its.claimed_bits:.0f} bit"
    left = "unknown" if its.left_bits is None else f"{its.left_bits:.0f} bit"
    figures = max(len(claimed), len(left))
    bars = min(BARS, width - VALUE_AT - figures - 28)
    share = (its.left_bits or 0.0) / its.claimed_bits if its.claimed_bits else 0.0
    true = line(LEVELS[-1] * min(bars, math.ceil(bars * share)), STYLES["true"])
    true.append(" " * (bars - true.cell_len) + f" {left:>{figures}}", "default")
    counted = line(LEVELS[-1] * (bars if its.claimed_bits else 0), STYLES["claimed"])
    counted.append(" " * (bars - counted.cell_len) + f" {claimed:>{figures}}", "default")
    if its.exceeds:
        counted.append("  PAPER'S RULE EXCEEDS TRUE", STYLES["bad"])
    told = f"  ({its.why})" if its.left_bits is None else f"  ({drawn(its.strongest)})"
    if its.failed:
        failed = f" FAILED: {', '.join(map(drawn, its.failed))}"
        told = failed if its.left_bits is None else told + failed
    true.append(told, STYLES["bad" if its.failed else ""])
    return [labelled("paper's rule", counted), labelled("true, at most", true)]


def explanation(its: SecrecyScore, width: int) -> Text:
    """What the verdict rests on, in words."""
    if its.left_bits is None:
        return line()
    by = its.why or f"measured on {its.scored} agreed steps, 95 % however often one looks"
    more = "a stronger eavesdropper may exist, so true is no more than this"
    return line(f" {longest(width - 1, f'{by}; {more}', by)}", STYLES["label"])


def distilled(state: LoopState, width: int) -> list[Text]:
    """Distilled keys and what Eve holds of them; the claim, and what contradicts it; the distance
    of all blocks that were begun from perfect keys.

    Nothing where the scenario makes none.
    """
    plant, model = state.plant, state.model
    if plant is None or model is None or not (model.keys_claim or plant.keys.refused):
        return []
    its = plant.keys
    room = width - VALUE_AT
    claim, refused = drawn(model.keys_claim), drawn(its.refused)
    if refused and not its.made:
        none = line(f"none: {refused}", STYLES["bad"])
        return [labelled("distilled keys", none), labelled("assumption", line(claim))]
    seconds = its.block_steps * model.period_s
    rate = 256 * its.of_block / seconds if seconds else 0.0
    lost = f"{count(its.lost)} {'block' if its.lost == 1 else 'blocks'} lost; " if its.lost else ""
    of = "key" if its.made == 1 else "keys"
    keys = line(f"{count(its.made)} {of}, {rate:.0f} bit/s; {lost}")
    hers, style = held(state, room - keys.cell_len)
    keys.append(hers, style=STYLES[style])
    against = list(contradictions(state))
    if its.stopped:
        against.insert(0, f"STOPPED: {drawn(its.stopped)}")
    elif state.controller is not None and state.controller.keys.stopped:
        against.insert(0, f"STOPPED at the controller: {drawn(state.controller.keys.stopped)}")
    if refused:
        against.insert(0, f"refused: {refused}")
    rests_on = line("; ".join(against), STYLES["bad"])
    rests_on.append(f"; {claim}" if against else claim, "default")
    rows = [labelled("distilled keys", keys), labelled("assumption", rests_on)]
    if its.begun and not refused:
        distance = f"{model.keys_eps * its.begun:.2g} from perfect keys"
        text = f"{count(its.begun)}: together {distance} at most"
        rows.append(labelled("blocks begun", line(text)))
    return rows


def held(state: LoopState, room: int) -> tuple[str, str]:
    """What Eve holds of the keys, or would hold of blocks that gave none, and its style."""
    hers = attacker(state)
    if hers is None:
        return longest(room, "no tap goes for them"), "label"
    made = state.plant is not None and state.plant.keys.made > 0
    holds = "holds" if made or not hers.bits else "would hold"
    bits = f"Eve {holds} {count(hers.bits)} bits"
    of = f"{bits} of {count(hers.blocks)} blocks"
    share = f"missed {percent(hers.missed, hers.copies)}"
    missed = share if hers.copies or not hers.absent else "was not there"
    return longest(room, f"{of}, {missed}", of, bits), "bad" if hers.bits else "good"


HEADING: Final = "keys found % secret bit/key letters right  whole at step"


def eavesdroppers(state: LoopState, shown: Sequence[tuple[TapState, KnownSymbols]]) -> list[Text]:
    """A row for each tap."""
    lines = [labelled("eavesdropper", line(HEADING, STYLES["label"]))]
    for tap, its in shown:
        left = bits_left(1, state.candidates, its.share)
        bits = f"{left.high:.2f}" if its.of else "-"
        right, total = characters_right(state, tap)
        letters = longest(9, f"{right}/{total}", percent(right, total)) if total else "-"
        row = f"{keys_right(its):>12} {bits:>14} {letters:>13} {_broke(tap):>14}"
        lines.append(labelled(tap.status.name, line(row)))
    return lines if shown else [*lines, line(" none")]


def keys_right(its: KnownSymbols) -> str:
    """The share of keys that Eve knows, up to a relabelling, in per cent, with its limits."""
    if not its.of:
        return "-"
    low, high = int(100 * its.share.low), math.ceil(100 * its.share.high)
    return f"{100 * its.right // its.of} [{low},{high}]"


BEHIND: Final = 0.1
"""Share of the steps heard from which on the table says how far the tap is behind."""


def _broke(tap: TapState) -> str:
    if tap.status.failed:
        return "FAILED, exact" if tap.exact else "FAILED"
    solved = tap.status.belief.solved_k
    if solved < 0 and tap.exact:
        return "exact, unsure"
    if solved < 0:
        behind = tap.status.behind
        return f"{count(behind)} behind" if behind > BEHIND * tap.status.steps else "not yet"
    if tap.exact or tap.watched:
        judged = "exact" if tap.exact else "WRONG"
        return longest(14, f"{solved} {judged}", f"{count(solved)} {judged}")
    return f"{solved}"  # a replay, or heard late: nobody here knows what it was
