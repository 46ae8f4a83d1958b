"""The secrecy panel: what counts as secret against what is true, keys, and the taps in a table."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

from protocol.messages import TapStatus
from wyner.dashboard.model import State, TapState
from wyner.dashboard.parts import LABEL, VALUE_AT, Column, Row, fitting, line, table
from wyner.dashboard.score import Score, SecrecyScore, characters_right, course, model_error
from wyner.dashboard.text import (
    LEVELS,
    STYLES,
    bars_of,
    count,
    drawn,
    figure,
    longest,
    number,
    percent,
)

CURVE: Final = 60
"""Most cells of the curves of the bits by the paper's rule and of those that are true."""


def explanation(its: SecrecyScore, width: int) -> Text:
    """What the verdict rests on, in words."""
    when = f"when keys were agreed may hide {its.when_bits:.0f} bit more"
    if its.left_bits is None:
        return Text(f" {when}")
    by = its.why or f"measured on {its.scored} agreed steps, 95 % however often one looks"
    text = longest(
        width - 1,
        f"{by}; a stronger tap may exist, so true is no more than this; {when}",
        f"{by}; {when}",
        by,
    )
    return Text(f" {text}", style=STYLES["label"])


def distilled(state: State, width: int) -> list[Row]:
    """Keys made of nonces and what she holds of them; then the claim, and what contradicts it;
    then what all blocks that were begun may cost.

    Nothing where the scenario makes none.
    """
    plant, model = state.plant, state.model
    if plant is None or model is None or not (model.keys_claim or plant.keys_refused):
        return []
    room = width - VALUE_AT
    claim, refused = drawn(model.keys_claim), drawn(plant.keys_refused)
    if refused and not plant.keys_made:
        told = longest(room, f"none: {refused}", "none")
        return [
            ("distilled keys", line(told, STYLES["bad"])),
            ("assumption", line(claim)),
        ]
    seconds = plant.key_block_steps * model.period_s
    rate = 256 * plant.keys_of_block / seconds if seconds else 0.0
    n = plant.key_blocks_lost
    lost = f"{count(n)} {'block' if n == 1 else 'blocks'} lost; " if n else ""
    of = "key" if plant.keys_made == 1 else "keys"
    made = f"{count(plant.keys_made)} {of}, {rate:.0f} bit/s; {lost}"
    made_and_held = line(made)
    hers, style = held(state, room - cell_len(made))
    made_and_held.append(hers, style=STYLES[style])
    digits = f"; {count(plant.digits_left)} digits left"
    if plant.digits_left and made_and_held.cell_len + cell_len(digits) <= room:
        made_and_held.append(digits)
    keys: Row = "distilled keys", made_and_held
    against = [*contradictions(state)]
    if plant.keys_stopped:
        against.insert(0, f"STOPPED: {drawn(plant.keys_stopped)}")
    elif state.controller is not None and state.controller.keys_stopped:
        against.insert(0, f"STOPPED at the controller: {drawn(state.controller.keys_stopped)}")
    if refused:
        against.insert(0, f"refused: {refused}")
    rests_on = line(claim)
    if against:
        heads = [text.partition(":")[0] for text in against]
        fewer = ("; ".join(heads[:most]) for most in range(len(heads), 0, -1))
        red = longest(room, "; ".join(against), *fewer)
        left = room - cell_len(red)
        rests_on = line().append(red, style=STYLES["bad"]).append(longest(left, f"; {claim}"))
    rows: list[Row] = [keys, ("assumption", rests_on)]
    if plant.key_blocks_begun and not refused:
        begun = count(plant.key_blocks_begun)
        distance = f"{model.keys_eps * plant.key_blocks_begun:.2g} from perfect keys"
        text = longest(
            room,
            f"{begun}, void and aborted ones too: together {distance} at most",
            f"{begun}: together {distance} at most",
            begun,
        )
        rows.append(("blocks begun", line(text)))
    return rows


def attacker(state: State) -> TapStatus | None:
    """The tap that holds most of the keys, of those that go for them."""
    trying = [tap.status for tap in state.taps.values() if tap.status.key_bits_held >= 0]
    return max(trying, key=lambda its: its.key_bits_held, default=None)


def held(state: State, room: int) -> tuple[str, str]:
    """What Eve holds of the keys, or would hold of blocks that gave none, and its style."""
    hers = attacker(state)
    if hers is None:
        return longest(room, "no tap goes for them"), "label"
    made = state.plant is not None and state.plant.keys_made > 0
    holds = "holds" if made or not hers.key_bits_held else "would hold"
    bits = f"Eve {holds} {count(hers.key_bits_held)} bits"
    share = percent(hers.copies_missed, hers.copies)
    of = f"{bits} of {count(hers.key_blocks)} blocks"
    missed = f"missed {share}" if hers.copies or not hers.copies_absent else "was not there"
    told = longest(room, f"{of}, {missed}", of, bits)
    return told, "bad" if hers.key_bits_held else "good"


def contradictions(state: State) -> Iterator[str]:
    """What her tap found against the claim."""
    hers = attacker(state)
    if hers is None:
        return
    if hers.claim_refuted:
        of = f" of the {drawn(hers.missed_direction)}" if hers.missed_direction else ""
        yield f"CLAIM REFUTED: she misses {hers.missed_at_most:.2g}{of} at most"
    if hers.misses_in_bursts:
        yield "MISSES IN BURSTS"


def curves(state: State, its: SecrecyScore, width: int) -> list[Row]:
    """What the paper's rule counts and what is true over time, on one scale, with last figures."""
    claimed = f" {its.claimed_bits:.0f} bit"
    left = " unknown" if its.left_bits is None else f" {its.left_bits:.0f} bit"
    figures = max(len(claimed), len(left))
    loud, who = "", f" ({its.why})"
    room = width - VALUE_AT - figures
    if its.exceeds:
        loud = longest(room, " PAPER'S RULE EXCEEDS TRUE", " EXCEEDS TRUE")
    if its.strongest:
        who = longest(room, f" ({drawn(its.strongest)})")
    if its.failed:
        who = longest(room, f"{who} FAILED: {', '.join(map(drawn, its.failed))}", " FAILED", who)
    shown = course(state, max(0, min(CURVE, room - max(cell_len(loud), cell_len(who)))))
    rows: list[Row] = []
    for label, style, values, told, note, noted in (
        ("paper's rule", "claimed", [c for c, _ in shown], claimed, loud, "bad"),
        ("true, at most", "true", [t for _, t in shown], left, who, "bad" if its.failed else ""),
    ):
        bars = bars_of(values, max(its.claimed_bits, 1.0), LEVELS)
        value = line().append(bars, style=STYLES[style]).append(told.rjust(figures))
        value.append(longest(room + figures - value.cell_len, note), style=STYLES[noted])
        rows.append((label, value))
    return rows


def eavesdroppers(state: State, shown: Sequence[tuple[TapState, Score]], width: int) -> Table:
    """A row for each tap, under the columns that the width has room for."""
    rows = [(tap.status.name, (state, tap, its)) for tap, its in shown]
    found = table("eavesdropper", LABEL, fitting(_COLUMNS, width - LABEL - 2), rows)
    if not shown:
        found.add_row(line("none heard"))
    return found


def _follows(tap: TapState) -> str:
    left = tap.status.candidates_left
    return count(left) if left else "-"


def _message_right(state: State, tap: TapState) -> str:
    right, total = characters_right(state, tap)
    return longest(9, f"{right}/{total}", percent(right, total)) if total else "-"


def _model_off(state: State, tap: TapState) -> str:
    off = model_error(state, tap)
    if off is None:
        return "-"
    return "0 %" if off == 0 else f"{number(100 * off)} %"


def keys_right(its: Score) -> str:
    """The share of keys that she knows, up to a relabelling, in per cent, with its limits."""
    if not its.scored:
        return "-"
    low, high = int(100 * its.guessed.low), math.ceil(100 * its.guessed.high)
    return f"{100 * its.right // its.scored} [{low},{high}]"


BEHIND: Final = 0.1
"""Share of the steps heard from which on it is told how many she has still to read."""


def _broke(tap: TapState) -> str:
    if tap.status.failed:
        return "FAILED, exact" if tap.exact else "FAILED"
    solved = tap.status.solved_k
    if solved < 0 and tap.exact:
        return "exact, unsure"
    if solved < 0:  # what she will make of the steps that she has not read is no secret yet
        behind = tap.status.behind
        return f"{count(behind)} to read" if behind > BEHIND * tap.status.steps else "not yet"
    if tap.exact or tap.watched:
        judged = "exact" if tap.exact else "WRONG"
        return longest(14, f"{solved} {judged}", f"{count(solved)} {judged}")
    return f"{solved}"  # a replay, or heard late: nobody here knows what it was


def _unused(tap: TapState) -> int:
    """Messages that the tap heard and could not use, and steps that it skipped."""
    its = tap.status
    return its.foreign + its.late + its.dropped + its.jumped


_Judged = tuple[State, TapState, Score]

_COLUMNS: Final[tuple[Column[_Judged], ...]] = (
    Column("keys found %", 12, 0, lambda of: keys_right(of[2])),
    Column("keys so far", 11, 6, lambda of: count(of[2].scored)),
    Column("secret bit/key", 14, 3, lambda of: figure(of[2].bits_per_key)),
    Column("texts tried", 11, 5, lambda of: _follows(of[1])),
    Column("model error", 11, 4, lambda of: _model_off(of[0], of[1])),
    Column("letters right", 13, 2, lambda of: _message_right(of[0], of[1])),
    Column("whole at step", 14, 1, lambda of: _broke(of[1])),
    Column("steps to read", 13, 7, lambda of: count(of[1].status.behind)),
    Column("steps missed", 12, 8, lambda of: count(of[1].status.lost)),
    Column("not used", 8, 9, lambda of: count(_unused(of[1]))),
)
"""Left to right."""
