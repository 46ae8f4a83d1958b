"""The secrecy panel: what counts as secret against what is true, keys, and the taps in a table."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from rich.cells import cell_len
from rich.text import Text

from protocol.messages import TapStatus
from wyner.dashboard.model import Board, TapBoard
from wyner.dashboard.score import Score, SecrecyScore, characters_right, course, model_error
from wyner.dashboard.text import (
    LABEL,
    STYLES,
    Glyphs,
    bars_of,
    count,
    drawn,
    figure,
    longest,
    number,
    percent,
    row,
)

CURVE: Final = 60
"""Most cells of the curves of the bits by the paper's rule and of those that are true."""


def verdict(its: SecrecyScore, width: int) -> Text:
    """What the paper's rule counts against what is true, in one line; loud where it is too much."""
    claimed = f" paper's rule {its.claimed_bits:.0f} bit  "
    if its.left_bits is None:
        style = STYLES["bad"] if its.failed else ""
        told = longest(width - len(claimed), f"true: unknown, {its.why}", f"true: {its.why}")
        return Text.assemble(claimed, (told, style))
    left = f"{its.left_bits:.0f} bit"
    room = width - len(claimed)
    strongest = drawn(its.strongest)
    if not its.exceeds:
        return Text(claimed + longest(room, f"true: at most {left} ({strongest})", left))
    loud = longest(
        room,
        f"PAPER'S RULE EXCEEDS TRUE: {strongest} leaves at most {left}",
        f"EXCEEDS TRUE: {strongest} leaves at most {left}",
        f"EXCEEDS TRUE, {left}",
        "EXCEEDS TRUE",
    )
    return Text.assemble(claimed, (loud, STYLES["bad"]))


def explanation(its: SecrecyScore, width: int) -> Text:
    """What the verdict rests on, in words."""
    when = f"when keys were agreed hides at most {its.when_bits:.0f} bit"
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


def distilled(board: Board, width: int) -> list[Text]:
    """Keys made of nonces and what she holds of them; then the claim, and what contradicts it.

    Nothing where the scenario makes none.
    """
    plant, model = board.plant, board.model
    if plant is None or model is None or not (model.keys_claim or plant.keys_refused):
        return []
    room = width - LABEL - 1
    claim, refused = drawn(model.keys_claim), drawn(plant.keys_refused)
    if refused and not plant.keys_made:
        told = longest(room, f"none: {refused}", "none")
        return [
            row("distilled keys", Text(told, style=STYLES["bad"])),
            row("assumption", Text(claim)),
        ]
    seconds = plant.key_block_steps * model.period_s
    rate = 256 * plant.keys_of_block / seconds if seconds else 0.0
    n = plant.key_blocks_lost
    lost = f"{count(n)} {'block' if n == 1 else 'blocks'} lost; " if n else ""
    made = f"{count(plant.keys_made)} keys, {rate:.0f} bit/s; {lost}"
    line = row("distilled keys", Text(made))
    hers, style = held(board, room - cell_len(made))
    line.append(hers, style=STYLES[style])
    against = [*contradictions(board)]
    if plant.keys_stopped:
        against.insert(0, f"STOPPED: {drawn(plant.keys_stopped)}")
    elif board.controller is not None and board.controller.keys_stopped:
        against.insert(0, f"STOPPED at the controller: {drawn(board.controller.keys_stopped)}")
    if refused:
        against.insert(0, f"refused: {refused}")
    if against:
        heads = [text.partition(":")[0] for text in against]
        fewer = ("; ".join(heads[:most]) for most in range(len(heads), 0, -1))
        red = longest(room, "; ".join(against), *fewer)
        left = room - cell_len(red)
        line_2 = row("assumption", Text(red, style=STYLES["bad"]))
        return [line, Text.assemble(line_2, longest(left, f"; {claim}"))]
    return [line, row("assumption", Text(claim))]


def attacker(board: Board) -> TapStatus | None:
    """The tap that holds most of the keys, of those that go for them."""
    trying = [tap.status for tap in board.taps.values() if tap.status.key_bits_held >= 0]
    return max(trying, key=lambda its: its.key_bits_held, default=None)


def held(board: Board, room: int) -> tuple[str, str]:
    """What she holds, in words, and its style."""
    hers = attacker(board)
    if hers is None:
        return longest(room, "no tap goes for them"), "label"
    bits = f"she holds {count(hers.key_bits_held)} bits"
    share = percent(hers.copies_missed, hers.copies)
    of = f"{bits} of {count(hers.key_blocks)} blocks"
    missed = f"missed {share}" if hers.copies or not hers.copies_absent else "was not there"
    told = longest(room, f"{of}, {missed}", of, bits)
    return told, "bad" if hers.key_bits_held else "good"


def contradictions(board: Board) -> Iterator[str]:
    """What her tap found against the claim."""
    hers = attacker(board)
    if hers is None:
        return
    if hers.claim_refuted:
        of = f" of the {drawn(hers.missed_direction)}" if hers.missed_direction else ""
        yield f"CLAIM REFUTED: she misses {hers.missed_at_most:.2g}{of} at most"
    if hers.misses_in_bursts:
        yield "MISSES IN BURSTS"
    if hers.sealed_bits_known:
        yield (
            f"SHE READS {count(hers.sealed_bits_known)} of {count(hers.sealed_bits)} sealed bits: "
            f"{drawn(hers.sealed_text)}"
        )


def curves(board: Board, its: SecrecyScore, width: int, glyphs: Glyphs) -> list[Text]:
    """What the paper's rule counts and what is true over time, on one scale, with last figures."""
    claimed = f" {its.claimed_bits:.0f} bit"
    left = " unknown" if its.left_bits is None else f" {its.left_bits:.0f} bit"
    figures = max(len(claimed), len(left))
    loud, who = "", f" ({its.why})"
    room = width - LABEL - 2 - figures
    if its.exceeds:
        loud = longest(room, " PAPER'S RULE EXCEEDS TRUE", " EXCEEDS TRUE")
    if its.strongest:
        who = longest(room, f" ({drawn(its.strongest)})")
    if its.failed:
        who = longest(room, f"{who} FAILED: {', '.join(map(drawn, its.failed))}", " FAILED", who)
    shown = course(board, max(0, min(CURVE, room - max(cell_len(loud), cell_len(who)))))
    lines = []
    for label, values, told, note, style in (
        ("paper's rule", [c for c, _ in shown], claimed, loud, "bad"),
        ("true, at most", [t for _, t in shown], left, who, "bad" if its.failed else "label"),
    ):
        bars = bars_of(values, max(its.claimed_bits, 1.0), glyphs.levels)
        line = row(
            label, Text(bars, style=STYLES["claimed" if label == "paper's rule" else "true"])
        )
        line.append(told.rjust(figures))
        line.append(longest(width - line.cell_len, note), style=STYLES[style])
        lines.append(line)
    return lines


def table(
    board: Board, shown: Sequence[tuple[TapBoard, Score]], width: int, chosen: str = ""
) -> list[Text]:
    """A row for each tap, under the columns that the width has room for."""
    columns = _columns(width)
    head = "".join(f" {column.title:>{column.width}}" for column in columns)
    lines = [Text(f" {'eavesdropper':<{LABEL}}{head}", style=STYLES["label"])]
    for tap, its in shown:
        line = row(tap.status.name, Text())
        line.right_crop(1)
        if chosen and tap.status.name == chosen:
            line = Text.assemble((">", STYLES["title"]), line[1:])
        for column in columns:
            line.append(f" {column.value(board, tap, its):>{column.width}}")
        lines.append(line)
    if not shown:
        lines.append(Text(" none heard" if not board.taps else " none by that name"))
    return lines


def _follows(tap: TapBoard) -> str:
    left = tap.status.candidates_left
    return count(left) if left else "-"


def _message_right(board: Board, tap: TapBoard) -> str:
    right, total = characters_right(board, tap)
    return longest(9, f"{right}/{total}", percent(right, total)) if total else "-"


def _model_off(board: Board, tap: TapBoard) -> str:
    off = model_error(board, tap)
    if off is None:
        return "-"
    return "0 %" if off == 0 else f"{number(100 * off)} %"


def keys_right(its: Score) -> str:
    """The share of keys that she guessed right, in per cent, with its limits."""
    if not its.scored:
        return "-"
    low, high = int(100 * its.guessed.low), math.ceil(100 * its.guessed.high)
    return f"{100 * its.right // its.scored} [{low},{high}]"


def _broke(tap: TapBoard) -> str:
    if tap.status.failed:
        return "FAILED, exact" if tap.exact else "FAILED"
    solved = tap.status.solved_k
    if solved < 0:
        return "exact, unsure" if tap.exact else "not yet"
    if tap.exact or tap.watched:
        judged = "exact" if tap.exact else "WRONG"
        return longest(14, f"{solved} {judged}", f"{count(solved)} {judged}")
    return f"{solved}"  # a replay, or heard late: nobody here knows what it was


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of the table of taps; a narrow screen does without those of the last ranks."""

    title: str
    width: int
    rank: int
    value: Callable[[Board, TapBoard, Score], str]


_COLUMNS: Final = (
    _Column("keys found %", 12, 0, lambda _, __, its: keys_right(its)),
    _Column("keys", 6, 6, lambda _, __, its: count(its.scored)),
    _Column("bits left", 9, 3, lambda _, __, its: figure(its.bits_per_key)),
    _Column("readings", 8, 4, lambda _, tap, __: _follows(tap)),
    _Column("model error", 11, 5, lambda board, tap, _: _model_off(board, tap)),
    _Column("text read", 9, 2, lambda board, tap, _: _message_right(board, tap)),
    _Column("whole at step", 14, 1, lambda _, tap, __: _broke(tap)),
    _Column("waiting", 7, 7, lambda _, tap, __: count(tap.status.behind)),
    _Column("missed", 6, 8, lambda _, tap, __: count(tap.status.lost)),
)
"""Left to right."""


def _columns(width: int) -> list[_Column]:
    """The columns that the width has room for, those of the first ranks."""
    room = width - LABEL - 1
    kept = []
    for column in sorted(_COLUMNS, key=lambda column: column.rank):
        if column.width + 1 <= room:
            kept.append(column)
            room -= column.width + 1
    return sorted(kept, key=_COLUMNS.index)
