"""The screen: golden pictures at three sizes, and what must hold at every size.

``WYNER_REWRITE=1`` rewrites the golden screens; review them as text.
"""

import io
import os
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from dashboard.keymap import KEYS, Action, action_of
from dashboard.model import Arrival, Board, reduce, reduce_all
from dashboard.rehearsal import MESSAGE_TEXT, Rehearsal
from dashboard.screenshot import save, to_svg, to_text
from dashboard.text import count, number, percent, sparkline
from dashboard.view import (
    DROPPED_FIRST,
    HELP,
    SILENT_AFTER_NS,
    SMALLEST,
    Wishes,
    screen,
)

SCREENS = Path(__file__).parent / "screens"
PLAIN = Wishes()

USUAL = Rehearsal()
FOUR_STATES = Rehearsal(
    A=(
        (0.99, 0.0, 0.02, 0.0),
        (0.0, 0.99, 0.0, 0.02),
        (0.0, 0.0, 0.97, 0.0),
        (0.0, 0.0, 0.0, 0.97),
    ),
    B=((0.08, 0.0), (0.0, 0.06), (0.0, 0.05), (0.03, 0.0)),
    half_widths=(0.03, 0.03, 0.03, 0.03),
    gain=((-1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 0.0)),
)


@cache
def board_after(steps: int, rehearsal: Rehearsal = USUAL) -> Board:
    board = Board()
    for batch in rehearsal.arrivals(steps):
        board = reduce_all(board, batch)
    return board


def shown(board: Board, width: int, height: int, wishes: Wishes = PLAIN) -> str:
    return to_text(screen(board, width, height, wishes, board.plant_seen_ns))


# --- golden screens ----------------------------------------------------------------------------

GOLDEN = {
    "80x24-under-way": (board_after(700), 80, 24, PLAIN),
    "80x24-delivered": (board_after(3000), 80, 24, PLAIN),
    "80x24-waiting": (Board(), 80, 24, PLAIN),
    "80x24-four-states": (board_after(700, FOUR_STATES), 80, 24, PLAIN),
    "80x24-ascii": (board_after(700), 80, 24, Wishes(unicode=False)),
    "80x24-help": (board_after(700), 80, 24, Wishes(help=True)),
    "80x24-frozen": (board_after(700), 80, 24, Wishes(frozen=True, held_steps=40)),
    "80x24-filter": (board_after(700), 80, 24, Wishes(typing=True, filter="near")),
    "120x40-under-way": (board_after(700), 120, 40, PLAIN),
    "120x40-delivered": (board_after(3000), 120, 40, PLAIN),
    "60x16-under-way": (board_after(700), 60, 16, PLAIN),
    "40x8-under-way": (board_after(700), 40, 8, PLAIN),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_screens(name: str) -> None:
    text = shown(*GOLDEN[name])
    path = SCREENS / f"{name}.txt"
    if os.environ.get("WYNER_REWRITE"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8"), "review, then rewrite with WYNER_REWRITE=1"


# --- every size --------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 200),
    st.integers(1, 70),
    st.sampled_from([Board(), board_after(700), board_after(700, FOUR_STATES)]),
    st.booleans(),
    st.booleans(),
)
def test_every_line_has_the_screens_width(
    width: int, height: int, board: Board, help: bool, unicode: bool
) -> None:
    lines = screen(board, width, height, Wishes(help=help, unicode=unicode), 0)
    assert len(lines) == height
    assert all(cell_len(line.plain) == width for line in lines)
    assert unicode or all(line.plain.isascii() for line in lines)


PANELS = {
    "picture": "Agreement at k",
    "key symbols and automata": "receiver",
    "taps": "broke it",
    "loop": "set i(k)",
    "message": "recovered ",
}


def test_the_screen_is_whole_at_80x24_with_nothing_cut() -> None:
    text = shown(board_after(700), 80, 24)
    assert all(mark in text for mark in PANELS.values())
    assert "…" not in text


@pytest.mark.parametrize(("width", "height"), [(60, 16), (72, 20), (100, 30), (120, 40), (200, 60)])
def test_no_word_is_cut_at_usual_sizes(width: int, height: int) -> None:
    for steps in (30, 700, 3000):
        assert "…" not in shown(board_after(steps), width, height)


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_panels_are_dropped_in_the_stated_order(width: int) -> None:
    assert set(PANELS) == set(DROPPED_FIRST)
    for height in range(SMALLEST[1], 40):
        text = shown(board_after(700), width, height)
        there = [PANELS[panel] in text for panel in DROPPED_FIRST]
        assert there == sorted(there), f"{width}x{height}: {text}"
        assert "EXCEEDS TRUE" in text


def test_more_rows_never_show_fewer_panels() -> None:
    seen: set[str] = set()
    for height in range(SMALLEST[1], 60):
        text = shown(board_after(700), 80, height)
        now = {panel for panel, mark in PANELS.items() if mark in text}
        assert seen <= now
        seen = now


def test_too_small_a_screen_says_so() -> None:
    assert "too small: 40x8 needed" in shown(board_after(700), 39, 8)


# --- what it says ------------------------------------------------------------------------------


def test_a_mark_stands_under_every_wrong_character_and_under_no_right_one() -> None:
    board = board_after(3000)
    lines = shown(board, 120, 40).splitlines()
    at = next(
        i for i, line in enumerate(lines) if line.startswith(" nearest-centre") and "·" in line
    )
    guess, marks = lines[at][16:], lines[at + 1][16:]
    guess = guess.ljust(len(MESSAGE_TEXT))
    marks = marks.ljust(len(MESSAGE_TEXT))
    assert all(
        (mark == "^") == (a != b) for a, b, mark in zip(guess, MESSAGE_TEXT, marks, strict=True)
    )
    assert f"{marks.count('^')} wrong" in lines[at + 1]


def test_wrong_key_symbols_are_marked_too() -> None:
    board = board_after(700)
    blind = replace(board, taps={"set-membership": board.taps["set-membership"]})
    lines = shown(blind, 80, 24).splitlines()
    at = next(
        i for i, line in enumerate(lines) if line[1:].startswith("363 keys") or " keys " in line
    )
    for x in range(16, 39):
        truth, guess, mark = lines[at][x], lines[at + 1][x], lines[at + 2].ljust(80)[x]
        assert (mark == "^") == (truth != guess)


def test_a_claim_too_high_is_said_in_red_and_in_words() -> None:
    board = board_after(700)
    line = next(
        line
        for line in screen(board, 80, 24, PLAIN, board.plant_seen_ns)
        if "CLAIMED EXCEEDS TRUE" in line.plain
    )
    assert any("red" in str(span.style) for span in line.spans)
    blind = replace(board, taps={"set-membership": board.taps["set-membership"]})
    assert "EXCEEDS" not in shown(blind, 80, 24)
    assert "true: at most" in shown(blind, 80, 24)
    assert "no tap was scored" in shown(replace(board, taps={}), 80, 24)


def test_a_silent_service_is_named() -> None:
    board = board_after(700)
    late = board.plant_seen_ns + SILENT_AFTER_NS + 1
    header = screen(board, 120, 24, PLAIN, late)[0].plain
    assert "plant silent" in header
    assert "controller silent" in header


def test_trouble_stands_in_the_first_line() -> None:
    board = board_after(700)
    assert board.plant is not None
    assert board.controller is not None
    trouble = replace(
        board,
        plant=board.plant.model_copy(
            update={"phase": "refused", "detail": "another model", "frames_refused": 2}
        ),
        controller=board.controller.model_copy(update={"phase": "outside", "detail": "x is far"}),
    )
    header = shown(trouble, 120, 24).splitlines()[0]
    for told in ("refused", "another model", "2 frames refused", "controller outside", "x is far"):
        assert told in header
    assert "controller outside" in shown(trouble, 60, 16).splitlines()[0]


def test_the_filter_leaves_the_verdict_to_all_taps() -> None:
    text = shown(board_after(3000), 80, 24, Wishes(filter="MEMBER"))
    assert "list-decoder leaves 0 bit" in text
    assert " nearest-centre" not in text
    assert "/MEMBER: 1 of 3 taps" in text
    assert "none by that name" in shown(board_after(3000), 80, 24, Wishes(filter="zzz"))


def test_text_from_the_wire_moves_no_cursor_and_is_no_markup() -> None:
    board = board_after(700)
    tap = board.taps["list-decoder"].status
    evil = "\x1b[2J[red]\r\n\x07漢\u0301\u202e" + "x" * 3
    hostile = tap.model_copy(
        update={"name": "[b]\x1b[31m", "message": evil, "seq": tap.seq + 1, "t_ns": tap.t_ns + 1}
    )
    board = reduce(board, Arrival(board.plant_seen_ns, hostile))
    for line in screen(board, 100, 40, PLAIN, board.plant_seen_ns):
        assert cell_len(line.plain) == 100
        assert all(c.isprintable() for c in line.plain)


def test_a_long_message_is_shown_where_it_grows() -> None:
    rehearsal = Rehearsal(message="abcdefghij" * 12)
    text = shown(board_after(1500, rehearsal), 80, 24)
    board = board_after(1500, rehearsal)
    row = next(line for line in text.splitlines() if line.startswith(" recovered"))
    assert row[16:] == board.recovered[-len(row[16:]) :]
    assert 30 < len(row[16:]) <= 64


# --- colour is never the only signal -----------------------------------------------------------


def drawn(**options: object) -> str:
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, width=80, highlight=False, **options)  # type: ignore[arg-type]
    for line in screen(board_after(3000), 80, 24, PLAIN, 0):
        console.print(line, no_wrap=True)
    return file.getvalue()


COLOUR = re.compile(r"\x1b\[(?:[0-9;]*;)?(?:3[0-7]|4[0-7]|9[0-7]|10[0-7]|[34]8;)")


def test_no_color_is_honoured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    assert COLOUR.search(drawn(_environ={"TERM": "xterm-256color"}))
    quiet = drawn(_environ={"TERM": "xterm-256color", "NO_COLOR": "1"})
    assert not COLOUR.search(quiet)
    bare = re.sub(r"\x1b\[[0-9;]*m", "", quiet)
    assert bare == re.sub(r"\x1b\[[0-9;]*m", "", drawn(_environ={"TERM": "xterm-256color"}))


# --- help, figures, screenshots ----------------------------------------------------------------


def test_help_is_made_from_the_key_table_and_covers_every_key_and_action() -> None:
    text = shown(board_after(700), 80, 24, Wishes(help=True))
    assert {key.action for key in KEYS} == set(Action)
    for key in KEYS:
        assert f" {key.label} " in text
        assert key.meaning in text
        assert action_of(key.character) is key.action
    assert all(f"\n {line}\n" in text for line in HELP)
    assert all(panel in " ".join(HELP) for panel in DROPPED_FIRST)
    assert all(key.short in shown(board_after(700), 80, 24) for key in KEYS)


@pytest.mark.parametrize("value", [0, 1e-9, 0.00123, 0.5, 12.345, 999.9, 1e5, -2.5e-7, 1e12])
def test_figures_are_short(value: float) -> None:
    assert len(number(value).lstrip("-")) <= 6
    assert float(number(value)) == pytest.approx(value, rel=0.25)


def test_counts_and_shares() -> None:
    assert [count(v) for v in (0, 99_999, 123_456, 2**80)] == ["0", "99999", "123k", "2^80"]
    assert percent(999, 1000) == "99 %"
    assert percent(0, 0) == "-"
    assert sparkline([1, 2, 3], "abc") == "abc"
    assert sparkline([2, 2], "abc") == "bb"


def test_a_screenshot_is_the_same_bytes_twice_and_fetches_nothing(tmp_path: Path) -> None:
    lines = screen(board_after(700), 80, 24, PLAIN, 0)
    svg = to_svg(lines, 80)
    assert svg == to_svg(screen(board_after(700), 80, 24, PLAIN, 0), 80)
    assert "url(" not in svg.replace("url(#", "")
    assert "EXCEEDS" in svg
    first, second = save(lines, 80, tmp_path), save(lines, 80, tmp_path)
    assert first[0].name == "screen-1.svg"
    assert second[1].name == "screen-2.txt"
    assert first[0].read_bytes() == second[0].read_bytes()
