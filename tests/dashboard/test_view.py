"""The screen: three golden pictures, and what must hold at every size.

``WYNER_REWRITE=1`` rewrites the golden screens; review them as text.
"""

import io
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from protocol.messages.adversary import KeysHeld
from protocol.vectors import Vector
from tests.dashboard.states import plant_of, state_after, with_controller, with_plant
from tests.support.rehearsal import MESSAGE_TEXT, Rehearsal
from tests.support.screens import to_text
from tests.support.size import size
from tests.support.statuses import changed
from wyner.dashboard.headless import Reporter, progress, secrecy_line
from wyner.dashboard.model import Arrival, LoopState, reduce
from wyner.dashboard.score import contradictions
from wyner.dashboard.text import count
from wyner.dashboard.view import HELP, KEYS, SILENT_AFTER_NS, ViewState, screen

SCREENS = Path(__file__).parent / "screens"
PLAIN = ViewState()

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


def with_truth(state: LoopState, x: Vector) -> LoopState:
    """An attacked plant is there after its last step."""
    k = max(state.truths)
    row = state.truths[k]._replace(true_x_next=x)
    return replace(state, truths={**state.truths, k: row})


def with_model(state: LoopState, **changes: object) -> LoopState:
    assert state.model is not None
    return replace(state, model=state.model.model_copy(update=changes))


def with_tap(state: LoopState, which: str, **changes: object) -> LoopState:
    tap = state.taps[which]
    later = replace(tap, status=changed(tap.status, **changes))
    return replace(state, taps={**state.taps, which: later})


def lines_of(
    state: LoopState, width: int, height: int, view: ViewState = PLAIN, now_ns: int = 0
) -> list[Text]:
    """The screen's lines with their styles."""
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=True)
    found = console.render_lines(
        screen(state, width, height, view, now_ns),
        console.options.update(width=width, height=height),
    )
    return [
        Text.assemble(*((text, style or "") for text, style, control in line if not control))
        for line in found
    ]


def shown(state: LoopState, width: int, height: int, view: ViewState = PLAIN) -> str:
    return to_text(screen(state, width, height, view, state.seen["plant"]), (width, height))


# --- golden screens ----------------------------------------------------------------------------

GOLDEN: dict[str, tuple[int, int, int, ViewState]] = {
    "80x24-under-way": (700, 80, 24, PLAIN),
    "80x24-end": (
        3000,
        80,
        24,
        ViewState(
            caption=("What this run shows", "One.", "Two.", "Three."), press="Any key leaves."
        ),
    ),
    "120x40-delivered": (3000, 120, 40, PLAIN),
}
"""Steps of a rehearsal, and how they are shown; worked out when a screen is wanted."""


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_screens(name: str) -> None:
    steps, width, height, view = GOLDEN[name]
    text = shown(state_after(steps), width, height, view)
    path = SCREENS / f"{name}.txt"
    if os.environ.get("WYNER_REWRITE"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8"), "review, then rewrite with WYNER_REWRITE=1"


# --- every size --------------------------------------------------------------------------------


@settings(max_examples=size(25, 60), deadline=None)
@given(
    st.integers(1, 200),
    st.integers(1, 70),
    st.sampled_from([(0,), (700,), (700, FOUR_STATES)]),
    st.booleans(),
)
def test_every_line_has_the_screens_width(
    width: int, height: int, steps: tuple[Any, ...], help: bool
) -> None:
    lines = lines_of(state_after(*steps), width, height, ViewState(help=help))
    assert len(lines) == height
    assert all(cell_len(line.plain) == width for line in lines)


PANELS = ("Control loop", "Key test", "plant has ", "Secrecy", "keys found")


def test_the_screen_is_whole_at_80x24_with_nothing_cut() -> None:
    text = shown(state_after(700), 80, 24)
    assert all(mark in text for mark in PANELS)
    assert "…" not in text
    small = shown(state_after(700), 60, 16).splitlines()
    for row, whole in zip(small[1:-1], text.splitlines()[1:], strict=False):
        assert whole.startswith(row.rstrip("…"))


# --- what it says ------------------------------------------------------------------------------


def test_a_mark_stands_under_every_wrong_character_and_under_no_right_one() -> None:
    state = state_after(3000)
    state = replace(state, taps={"nearest-centre": state.taps["nearest-centre"]})
    lines = shown(state, 120, 40).splitlines()
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
    state = state_after(700)
    blind = replace(state, taps={"set-membership": state.taps["set-membership"]})
    lines = shown(blind, 80, 24).splitlines()
    at = next(i for i, line in enumerate(lines) if re.match(r" \d+ keys ", line))
    for x in range(16, 39):
        truth, guess, mark = lines[at][x], lines[at + 1][x], lines[at + 2].ljust(80)[x]
        assert (mark == "^") == (truth != guess)


def test_a_claim_too_high_is_said_in_red_and_in_words() -> None:
    state = state_after(700)
    line = next(
        line
        for line in lines_of(state, 80, 24, PLAIN, state.seen["plant"])
        if "PAPER'S RULE EXCEEDS TRUE" in line.plain
    )
    assert any("red" in str(span.style) for span in line.spans)
    blind = replace(state, taps={"set-membership": state.taps["set-membership"]})
    assert "EXCEEDS" not in shown(blind, 80, 24)
    assert "(set-membership)" in shown(blind, 80, 24)
    assert "(no tap)" in shown(replace(state, taps={}), 80, 24)


def test_a_silent_service_is_named() -> None:
    state = state_after(700)
    late = state.seen["plant"] + SILENT_AFTER_NS + 1
    header = lines_of(state, 120, 24, PLAIN, late)[0].plain
    assert "plant silent" in header
    assert "controller silent" in header
    over = with_controller(with_plant(state, phase="stopped"), phase="stopped")
    assert "silent" not in lines_of(over, 120, 24, PLAIN, late)[0].plain.replace("tap silent", "")


REASON = "x lies outside of every control set, by 12.5 in its first component; the input is 0 now"


def test_trouble_stands_in_the_first_line_before_what_tells_less() -> None:
    state = with_plant(state_after(700), phase="refused", frame={"refused": 2}, attack="ghost")
    state = with_controller(state, phase="outside", detail=REASON)
    told = ["rehearsal", "refused", "2 frames refused", "ATTACK: ghost", "controller outside"]
    places = [shown(state, 200, 24).splitlines()[0].find(text) for text in (*told, REASON, "x10")]
    assert places[0] > -1
    assert places == sorted(places)
    narrow = shown(with_model(state, seeded=False), 80, 24).splitlines()[0]
    assert all(text in narrow for text in told[:4])


@pytest.mark.parametrize("missed", [1, 999, 1234, 99_999, 10**8])
def test_missed_steps_are_told_whatever_their_number(missed: int) -> None:
    """Once: beside them stood those whose input came after all, as if they were others."""
    state = with_plant(state_after(700), step={"missed": missed}, timing={"late": missed})
    for terminal in ((80, 24), (60, 24), (120, 40)):
        text = shown(state, *terminal)
        assert re.search(rf" steps/s.*  missed {re.escape(count(missed))}\b", text)
        assert "late" not in text


def test_where_the_state_is_among_the_sets_is_told_in_words() -> None:
    state = state_after(700)
    assert "state: inside the target set" in shown(state, 120, 40)
    far = with_controller(state, set_index=250)
    assert "state: at most 250 steps to the target set" in shown(far, 120, 40)
    lost = with_controller(state, set_index=-1)
    assert "state: outside of every set" in shown(lost, 120, 40)


def test_a_state_under_attack_is_told_as_reported_beside_the_true_one() -> None:
    """The screen said "inside the target set" of a plant that was 29 away."""
    state = with_truth(state_after(700), (-28.892, 1.0))
    for terminal in ((80, 24), (120, 40)):
        text = shown(state, *terminal)
        assert re.search(r"reported in\w* .*target set; plant 29\.1 away", text)
        assert "reported   +0.186, true  -28.892" in text
    assert "the plant is 29.078 from the x reported" in progress(state)
    honest = with_truth(state, plant_of(state).step.x)
    assert "state: inside the target set" in shown(honest, 80, 24), "an attack has not begun"


def test_secrecy_stands_beside_the_rate_of_the_message() -> None:
    text = shown(state_after(700), 80, 24)
    assert re.search(r"4\.66 bit/s, at most 0\.\d+ secret", text)
    assert "4.66 bit/s, secret: unknown" in shown(replace(state_after(700), taps={}), 80, 24)


def test_guesses_that_lag_are_shown_at_the_steps_that_they_are_of() -> None:
    """The panel showed the newest steps, for which there was no guess yet."""
    state = state_after(700)
    tap = state.taps["list-decoder"]
    early = {k: guess for k, guess in tap.guesses.items() if k < 500}
    slow = replace(state, taps={"list-decoder": replace(tap, guesses=early)})
    text = shown(slow, 120, 40)
    assert "200 steps behind" in text
    assert re.search(r"^.* 499 .*Eve: ", text, re.MULTILINE)


def test_an_alarm_is_a_red_line() -> None:
    state = with_controller(
        state_after(700),
        alarms={"count": 3, "k": 650, "reading": (1.0, 2.0), "expected": (0.5, 2.0)},
    )
    spans = [(line, span) for line in lines_of(state, 120, 40) for span in line.spans]
    red = [line.plain[s.start : s.end].strip() for line, s in spans if "red" in str(s.style)]
    assert "ALARMS: 3, the last at step 650" in red
    assert "ALARMS: 3, the last at step" in shown(state, 80, 24)
    assert "ALARMS" not in shown(state_after(700), 120, 40)


@pytest.mark.parametrize(
    ("watched", "exact", "told"),
    [(True, True, "650 exact"), (True, False, "650 WRONG"), (False, False, "650")],
)
def test_only_a_tap_that_was_watched_is_called_wrong(watched: bool, exact: bool, told: str) -> None:
    state = with_tap(state_after(700), "list-decoder", belief={"solved_k": 650})
    tap = replace(state.taps["list-decoder"], watched=watched, exact=exact)
    text = shown(replace(state, taps={"list-decoder": tap}), 80, 24)
    assert next(line for line in text.splitlines() if " 100 [" in line).endswith(f" {told}")


def test_of_a_tap_that_is_far_behind_it_is_told_how_much_she_has_still_to_read() -> None:
    """Else the screen of a machine that is too slow for her would flatter the scheme."""
    state = with_tap(state_after(700), "list-decoder", behind=12_421, belief={"solved_k": -1})
    state = with_tap(state, "nearest-centre", behind=5, belief={"solved_k": -1})
    lines = shown(state, 80, 24).splitlines()
    row = {
        name: next(x for x in lines if x.startswith(f" {name}") and "[" in x) for name in state.taps
    }
    assert row["list-decoder"].endswith("12421 behind")
    assert row["nearest-centre"].endswith("not yet")


def test_text_from_the_wire_moves_no_cursor_and_is_no_markup() -> None:
    state = state_after(700)
    tap = state.taps["list-decoder"].status
    evil = "\x1b[2J[red]\r\n\x07漢\u0301\u202e" + "x" * 3
    at = {"seq": tap.seq + 1, "t_ns": tap.t_ns + 1}
    hostile = changed(tap, name="[b]\x1b[31m", belief={"message": evil}, **at)
    state = reduce(state, Arrival(state.seen["plant"], hostile))
    for line in lines_of(state, 100, 40, PLAIN, state.seen["plant"]):
        assert cell_len(line.plain) == 100
        assert all(c.isprintable() for c in line.plain)


def test_a_long_message_is_shown_where_it_grows() -> None:
    rehearsal = Rehearsal(message="abcdefghij" * 12)
    text = shown(state_after(1500, rehearsal), 80, 24)
    state = state_after(1500, rehearsal)
    row = next(line for line in text.splitlines() if line.startswith(" plant has"))
    assert row[16:] == state.recovered[-len(row[16:]) :]
    assert 30 < len(row[16:]) <= 64


# --- help, figures, screenshots ----------------------------------------------------------------


def test_help_covers_every_key_and_every_panel_that_may_go() -> None:
    text = shown(state_after(700), 80, 24, ViewState(help=True))
    assert all(f" {key} " in text and meaning in text for key, _, meaning in KEYS)
    assert all(f"\n {line}\n" in text for line in HELP)
    assert all(short in shown(state_after(700), 80, 24) for _, short, _ in KEYS)


def test_the_end_of_a_run_keeps_its_lines_broken_and_not_cut() -> None:
    """The demo's point once ended in an ellipsis: "the plant has it at step 296, the tap…"."""
    point = "1. Spoken:  16.9 bit/s by the rule; the plant has it at step 1328, the tap at 1328."
    caption = ("What this run shows", point, "second line", "third line", "fourth line")
    view = ViewState(caption=caption, press="Any key leaves.")
    keyed = with_plant(with_model(state_after(3000), keys_claim=CLAIM), keys={"begun": 3})
    for state in (state_after(3000), keyed):
        text = shown(state, 80, 24, view)
        told = text.partition("What this run shows")[2].partition("\n")[2]
        assert " ".join(told.split()).startswith(" ".join(" ".join(caption[1:]).split()))
        first, second = told.splitlines()[:2]  # what goes on stands below the text, not the label
        assert second.index(second.strip()) == first.index("16.9")
        assert text.splitlines()[-1] == " Any key leaves."
        shows = [panel in text for panel in ("Secrecy", "steps/s", "messages delivered")]
        assert shows == [True, True, False], "a panel is whole or gone"


CLAIM = "secret only from a tap that misses 30 % of first copies or more"


def test_keys_have_lines_with_the_claim_they_rest_on_and_what_all_blocks_may_cost() -> None:
    state = state_after(700)
    assert "distilled" not in shown(state, 120, 40)
    state = with_model(state, keys_claim=CLAIM, keys_eps=1e-12)
    made = with_plant(state, keys={"made": 63, "of_block": 48, "block_steps": 176})
    begun = with_plant(made, keys={"begun": 1700, "lost": 3})
    refused = {"refused": "eps_E = 0: nothing is claimed"}
    assert made.controller is not None
    partner = changed(made.controller, keys={"stopped": "refuted"})
    for told, its in (
        ("63 keys, 698 bit/s; no tap goes for them", made),
        (f" assumption     {CLAIM}", made),
        ("63 keys, 698 bit/s; 3 blocks lost; ", begun),
        (" blocks begun   1700: together 1.7e-09 from perfect keys at most", begun),
        (f"refused: eps_E = 0: nothing is claimed; {CLAIM}", with_plant(made, keys=refused)),
        ("none: eps_E = 0: nothing is claimed", with_plant(state, keys=refused)),
        ("STOPPED: refuted", with_plant(made, keys={"stopped": "refuted"})),
        ("STOPPED at the controller: refuted", replace(made, controller=partner)),
    ):
        text = shown(its, 120, 40)
        assert told in text
        assert text.count("STOPPED") == told.count("STOPPED")
        assert text.count("blocks begun") == (its is begun)


def with_attacker(state: LoopState, name: str = "key-solver", **fields: object) -> LoopState:
    """A tap that goes for the keys is heard."""
    tap = next(iter(state.taps.values()))
    none = KeysHeld(
        blocks=7, broken=0, bits=0, copies=2000, missed=0, at_most=1.0, refuted=False, bursts=False
    )
    keys = none.model_copy(update=fields)
    status = changed(tap.status, name=name, tail=(), belief={"message": ""}, keys=keys)
    return reduce(state, Arrival(0, status))


def test_what_the_paper_claims_is_not_taken_for_a_word_on_distilled_keys() -> None:
    """``CLAIMED EXCEEDS TRUE`` stood in red above keys with a proof: whose claim, nobody said."""
    keyed = with_plant(with_model(state_after(700), keys_claim=CLAIM), keys={"made": 63})
    for state in (state_after(700), keyed):
        for width, height in ((120, 40), (80, 24)):
            rows = shown(state, width, height).splitlines()
            loud = [row for row in rows if "EXCEEDS" in row]
            assert len(loud) == 1
            assert loud[0].startswith(" paper's rule ")
            told = [row for row in rows if "claim" in row.lower()]
            assert all("paper's rule" in row or CLAIM[:9] in row for row in told), told
            assert all(cell_len(row) <= width for row in rows)
    rows = shown(holds := with_attacker(keyed, missed=600), 80, 24).splitlines()
    paper, true, keys, assumption = (
        next(i for i, row in enumerate(rows) if row.startswith(f" {label}"))
        for label in ("paper's rule", "true, at most", "distilled keys", "assumption")
    )
    assert (true, keys, assumption) == (paper + 1, paper + 2, paper + 3)
    assert "EXCEEDS" not in rows[keys] + rows[assumption]
    assert secrecy_line(holds).startswith(
        "secrecy: PAPER'S RULE EXCEEDS TRUE: 326 bit by the paper's rule"
    )
    assert "  distilled keys 63, Eve holds 0 bits of 7 blocks" in progress(holds)
    assert "  keys " in progress(holds)
    assert "  keys " not in progress(with_plant(holds, step={"agreements": 0})), (
        "the scheme agrees on none"
    )


def test_what_she_holds_of_the_keys_is_told_as_it_is_so() -> None:
    state = with_plant(with_model(state_after(700), keys_claim=CLAIM), keys={"made": 63})
    holds = with_attacker(state, missed=600)
    for width, height in ((80, 24), (120, 40)):
        text = shown(holds, width, height)
        assert "63 keys, 0 bit/s; Eve holds 0 bits of 7 blocks, missed 30 %" in text
        assert f" assumption     {CLAIM}" in text
    assert list(contradictions(holds)) == []
    two = with_attacker(holds, name="other", bits=256)
    assert "Eve holds 256 bits of 7 blocks" in shown(two, 120, 40)
    worse = with_attacker(
        state,
        missed=20,
        bits=512,
        refuted=True,
        at_most=0.0213,
        direction="offers",
    )
    text = shown(worse, 120, 40)
    assert "Eve holds 512 bits of 7 blocks, missed 1 %" in text
    assert worse.plant is not None
    none = replace(worse, plant=changed(worse.plant, keys={"made": 0}))
    assert "Eve would hold 512 bits of 7 blocks, missed 1 %" in shown(none, 120, 40)
    assert "CLAIM REFUTED: Eve misses 0.021 of the offers at most" in text
    worst = with_attacker(
        state,
        bits=999,
        refuted=True,
        bursts=True,
    )
    text = shown(worst, 80, 24)
    assert "CLAIM REFUTED: Eve misses 1 at most; MISSES IN BURSTS" in text
    away = with_attacker(state, copies=0, missed=0, absent=900)
    assert "Eve holds 0 bits of 7 blocks, was not there" in shown(away, 120, 40)
    reporter = Reporter()
    lines = reporter.report(worst, 0)
    assert "tap key-solver holds 999 bits of keys" in lines
    assert "MISSES IN BURSTS" in lines
    assert any("Eve holds 999 bits of 7 blocks" in line for line in lines)
    again = reporter.report(worst, 0)
    assert not any("BURSTS" in line or "holds 999 bits of keys" in line for line in again)


def test_a_tap_that_failed_is_shown_to_have_failed_and_not_as_her_message() -> None:
    why = "step 21: ValueError: no idea"
    state = with_tap(state_after(700), "list-decoder", failed=why)
    alone = replace(state, taps={"list-decoder": state.taps["list-decoder"]})
    for terminal in ((80, 24), (120, 40)):
        rows = shown(alone, *terminal).splitlines()
        assert any(row.startswith(" FAILED ") and why in row for row in rows)
        assert any("unknown" in row and "FAILED: list-" in row for row in rows)
        assert any(row.startswith(" list-decoder") and " FAILED" in row for row in rows)
    reporter = Reporter()
    reporter.report(state_after(700), 0)
    lines = reporter.report(alone, 0)
    assert f"tap list-decoder FAILED: {why}" in lines
