"""The secrecy panel: claimed against true in a line, and the taps in a table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from rich.text import Text

from wyner.dashboard.model import Board, TapView
from wyner.dashboard.score import Score, Secrecy, characters_right, model_error
from wyner.dashboard.text import LABEL, STYLES, count, drawn, figure, longest, number, percent, row

_COLUMNS: Final = (
    ("right", 6),
    ("of steps", 8),
    ("P_g", 4),
    ("bit/key", 7),
    ("left", 6),
    ("model off", 9),
    ("text", 9),
    ("broke it", 14),
    ("behind", 6),
    ("lost", 6),
)
"""Columns of the table of taps, left to right, with their widths."""

_KEPT_FIRST: Final = (0, 7, 6, 2, 3, 4, 5, 1, 8, 9)
"""Columns by how telling they are; a narrow screen does without the last ones."""


@dataclass(frozen=True, slots=True)
class _Column:
    title: str
    width: int
    value: Callable[[TapView, Score], str]


def verdict(its: Secrecy, width: int) -> Text:
    """Claimed against true in one line, loud where the claim is too high."""
    claimed = f" claimed {its.claimed_bits:.0f} bit  "
    if its.left_bits is None:
        return Text(f"{claimed}true: unknown, no tap was scored yet")
    left = f"{its.left_bits:.0f} bit"
    room = width - len(claimed)
    strongest = drawn(its.strongest)
    if not its.exceeds:
        return Text(claimed + longest(room, f"true: at most {left} ({strongest})", left))
    loud = longest(
        room,
        f"CLAIMED EXCEEDS TRUE: {strongest} leaves {left}",
        f"EXCEEDS TRUE: {strongest} leaves {left}",
        f"EXCEEDS TRUE, {left}",
    )
    return Text.assemble(claimed, (loud, STYLES["bad"]))


def explanation(its: Secrecy, width: int) -> Text:
    """What the verdict rests on, in words."""
    when = f"when keys were agreed hides at most {its.when_bits:.0f} bit"
    if its.left_bits is None:
        return Text(f" {when}")
    text = longest(
        width - 1,
        f"measured on {its.scored} agreed steps; a stronger tap may exist, so true is no more"
        f" than this; {when}",
        f"measured on {its.scored} agreed steps; {when}",
    )
    return Text(f" {text}", style=STYLES["label"])


def table(board: Board, shown: Sequence[tuple[TapView, Score]], width: int) -> list[Text]:
    """A row for each tap, under the columns that the width has room for."""
    columns = _columns(board, width)
    head = "".join(f" {column.title:>{column.width}}" for column in columns)
    lines = [Text(f" {'tap':<{LABEL}}{head}", style=STYLES["label"])]
    for tap, its in shown:
        line = row(tap.status.name, Text())
        line.right_crop(1)
        for column in columns:
            line.append(f" {column.value(tap, its):>{column.width}}")
        lines.append(line)
    if not shown:
        lines.append(Text(" none heard" if not board.taps else " none by that name"))
    return lines


def _columns(board: Board, width: int) -> list[_Column]:
    """The columns that the width has room for, the most telling ones first."""
    room = width - LABEL - 1
    kept: set[int] = set()
    for i in _KEPT_FIRST:
        if _COLUMNS[i][1] + 1 <= room:
            kept.add(i)
            room -= _COLUMNS[i][1] + 1
    value = {
        "right": lambda _, its: percent(its.right, its.scored),
        "of steps": lambda _, its: count(its.scored),
        "P_g": lambda _, its: figure(its.guessing),
        "bit/key": lambda _, its: figure(its.bits_per_key),
        "left": lambda tap, _: (
            count(tap.status.candidates_left or 0) if tap.status.candidates_left else "-"
        ),
        "model off": lambda tap, _: _model_off(board, tap),
        "text": lambda tap, _: _message_right(board, tap),
        "broke it": lambda tap, _: _broke(tap),
        "behind": lambda tap, _: count(tap.status.behind),
        "lost": lambda tap, _: count(tap.status.lost),
    }
    return [_Column(*_COLUMNS[i], value[_COLUMNS[i][0]]) for i in sorted(kept)]


def _message_right(board: Board, tap: TapView) -> str:
    right, total = characters_right(board, tap)
    return longest(9, f"{right}/{total}", percent(right, total)) if total else "-"


def _model_off(board: Board, tap: TapView) -> str:
    off = model_error(board, tap)
    if off is None:
        return "-"
    return "0 %" if off == 0 else f"{number(100 * off)} %"


def _broke(tap: TapView) -> str:
    solved = tap.status.solved_k
    if solved < 0:
        return "exact, unsure" if tap.exact else "not yet"
    if tap.exact or tap.watched:
        judged = "exact" if tap.exact else "WRONG"
        return longest(14, f"k {solved} {judged}", f"k {count(solved)} {judged}")
    return f"k {solved}"  # a replay, or heard late: nobody here knows what it was
