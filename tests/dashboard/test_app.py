"""The live screen on a real terminal, and the lines without one."""

import io
import os
import pty
import signal
import termios
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.dashboard.states import batches, plant_of, state_after, with_controller, with_plant
from tests.support.rehearsal import MESSAGE_TEXT
from tests.support.screens import Terminal, to_text
from tests.support.scripted import ScriptedSource
from tests.support.statuses import changed
from wyner.dashboard.app import GO_ON, Ending, LiveScreen, has_screen
from wyner.dashboard.headless import Reporter, progress, run_headless, secrecy_line
from wyner.dashboard.model import Arrival, LoopState, reduce_all
from wyner.dashboard.story import next_moment
from wyner.dashboard.terminal import ESCAPE, cbreak, split_keys
from wyner.dashboard.view import KEYS

SIZE = (80, 24)


def source(steps: int = 300) -> ScriptedSource:
    return ScriptedSource(batches(steps))


def text_of(watch: LiveScreen, now_ns: int = 0) -> str:
    return to_text(watch.draw(SIZE, now_ns), SIZE)


@pytest.fixture
def watch(tmp_path: Path) -> LiveScreen:
    return LiveScreen()


# --- keys --------------------------------------------------------------------------------------


def test_freezing_holds_the_view_and_goes_on_counting(watch: LiveScreen) -> None:
    script = source()
    for _ in range(5):
        watch.take(script)
    watch.press(" ", 0)
    held = text_of(watch)
    for _ in range(5):
        watch.take(script)
    still = text_of(watch)
    assert "FROZEN, 0 steps on" in held
    assert "FROZEN, 50 steps on" in still
    assert held.splitlines()[1:] == still.splitlines()[1:]
    assert watch.state.received == 51
    watch.press(" ", 0)
    assert "FROZEN" not in text_of(watch)
    assert "step 100 " in text_of(watch)
    watch.press(" ", 0)
    plant = plant_of(watch.state)
    fresh = changed(plant, session="f" * 16, step={"k": 3}, seq=0, t_ns=plant.t_ns + 1)
    watch.take(ScriptedSource([[Arrival(1, fresh)]]))
    assert "FROZEN, new session" in text_of(watch), "no steps are counted backwards"


def test_a_key_does_what_the_help_says_and_others_nothing(watch: LiveScreen) -> None:
    watch.press("?", 0)
    assert KEYS[0][2] in text_of(watch)
    watch.press(ESCAPE, 0)
    assert KEYS[0][2] not in text_of(watch)
    before = watch.view
    for key in "xyz1":
        watch.press(key, 0)
    assert watch.view == before
    watch.press("q", 0)
    assert watch.quit


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        ("q", ["q"]),
        ("\x1b[A\x1bOD", []),
        ("\x1b[5~", []),
        ("a\x1b[1;5Cb", ["a", "b"]),
        ("\x1bOPz", ["z"]),
        ("\x1b", ["\x1b"]),
        ("\x1b[", []),
        ("é?", ["é", "?"]),
    ],
)
def test_keys_are_split_and_sequences_swallowed(typed: str, keys: list[str]) -> None:
    assert split_keys(typed) == keys


def test_the_first_line_begins_with_what_the_screen_is_of() -> None:
    watch = LiveScreen()
    assert text_of(watch).startswith(" wyner  waiting for the plant")
    watch.view = replace(watch.view, title="2/3 sealed")
    assert text_of(watch).startswith(" 2/3 sealed  waiting for the plant")


def test_the_story_begins_with_the_plants_model_and_keeps_its_order() -> None:
    """Its first captions once stood beside a panel without a picture."""
    state = state_after(100)
    assert next_moment(replace(state, model=None), set()) is None
    told: set[int] = set()
    while (found := next_moment(state, told)) is not None and len(told) < 2:
        assert found[0] == len(told), "in their order, however late the model was received"
        told.add(found[0])


def test_the_story_pauses_at_each_moment_once_and_misses_nothing(tmp_path: Path) -> None:
    watch = LiveScreen(story=True)
    script = source(1500)
    while not script.exhausted:
        watch.take(script)
    watch.end(["had it at step 1163"])
    seen = []
    while watch.view.press == GO_ON:
        text = text_of(watch)
        assert "…" not in text
        assert "model was not received yet" not in text, "each caption stands beside its picture"
        title = watch.view.caption[0]
        if title.startswith("A key is agreed"):
            assert f"Key test at {title.rpartition(', at ')[2]} " in text
        seen.append(watch.view.caption[0])
        watch.press(" ", 0)
    assert [title.split(",")[0].split(":")[0] for title in seen] == [
        "A key is agreed",
        "The message travels under such keys",
        "What the nearest prediction tells",
        "Eve's list",
        "Eve has the message",
    ]
    assert "The plant has had it since step" in text
    assert "had it at step 1163" in text_of(watch)
    watch.press("?", 0)
    left = [watch.quit]
    watch.press("x", 0)
    left.append(watch.quit)
    assert left == [False, True], "looking at the last screen does not leave it, another key does"


# --- the terminal ------------------------------------------------------------------------------


def test_the_terminal_is_restored_after_an_exception() -> None:
    leader, follower = pty.openpty()
    before = termios.tcgetattr(follower)
    with pytest.raises(RuntimeError), cbreak(follower) as keys:
        assert not termios.tcgetattr(follower)[3] & termios.ICANON
        os.write(leader, b"k\x1a")
        assert keys.read(5) == ["k", "\x1a"]
        raise RuntimeError
    assert termios.tcgetattr(follower) == before
    os.close(leader)
    os.close(follower)


PROGRAM = """
import sys
from wyner.dashboard.app import run_dashboard
from tests.support.rehearsal import Rehearsal
from tests.support.scripted import ScriptedSource
source = ScriptedSource(Rehearsal().arrivals(100000))
def until():
    print("complaint behind the screen", file=sys.stderr)
    if sys.argv[1] == "raise" and source.now_ns() > 5e8:
        raise RuntimeError("on purpose")
    return sys.argv[1] in ("finish", "conclude") and source.now_ns() > 5e8
if sys.argv[1] == "half":
    from rich.console import Console
    show = Console.set_alt_screen
    def show_and_be_interrupted(console, enable=True):
        show(console, enable)
        if enable:
            raise KeyboardInterrupt
    Console.set_alt_screen = show_and_be_interrupted
conclude = (lambda: ["the point of it"]) if sys.argv[1] == "conclude" else None
print(run_dashboard(source, until=until, conclude=conclude))
"""


def shown(mode: str) -> Terminal:
    """The program on a terminal of its own."""
    return Terminal("-c", PROGRAM, mode)


@pytest.mark.slow
def test_q_leaves_a_restored_terminal_and_repeats_what_was_said_behind() -> None:
    screen = shown("watch")
    screen.wait_for(" steps/s")
    screen.type("?")
    screen.wait_for("How to read it")
    screen.type("\x1b[Aq")
    after = screen.end()
    assert "complaint behind the screen" in after
    assert "Ending.QUIT" in after
    assert "complaint" not in screen.seen.partition(b"\x1b[?1049l")[0].decode()


@pytest.mark.slow
def test_control_c_is_an_interruption_and_restores_the_terminal() -> None:
    screen = shown("watch")
    screen.wait_for(" steps/s")
    os.killpg(screen.process.pid, signal.SIGINT)
    assert "Ending.INTERRUPTED" in screen.end()


@pytest.mark.slow
def test_an_interruption_while_the_screen_is_set_up_restores_the_terminal() -> None:
    assert "Ending.INTERRUPTED" in shown("half").end()


@pytest.mark.slow
def test_the_end_of_the_watch_and_an_error_restore_the_terminal() -> None:
    done = shown("finish")
    assert "Ending.FINISHED" in done.end()
    failed = shown("raise")
    assert "RuntimeError: on purpose" in failed.end()


@pytest.mark.slow
def test_the_last_screen_stays_until_a_key_is_pressed() -> None:
    screen = shown("conclude")
    screen.wait_for("Any key leaves")
    assert b"the point of it" in screen.seen
    time.sleep(0.3)
    assert screen.process.poll() is None
    screen.type("x")
    assert "Ending.FINISHED" in screen.end(), "the run had come to its end"


def test_a_resize_is_followed() -> None:
    screen = shown("watch")
    screen.wait_for(" steps/s")
    assert "often one looks" not in screen.seen.decode()
    screen.resize(120, 40)
    screen.wait_for("often one looks")
    screen.type("q")
    screen.end()


# --- without a terminal ------------------------------------------------------------------------


class Pretender(io.StringIO):
    def __init__(self, encoding: str = "utf-8") -> None:
        super().__init__()
        self._encoding = encoding

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._encoding

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("out", "term", "expected"),
    [
        (Pretender(), "xterm", True),
        (Pretender(), "dumb", False),
        (Pretender(), "", False),
        (Pretender("latin-1"), "xterm", False),
        (io.StringIO(), "xterm", False),
    ],
)
def test_a_screen_needs_a_terminal_that_is_not_dumb_and_has_its_characters(
    out: io.StringIO, term: str, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", term)
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert has_screen(out) is expected


def headless(steps: int, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr("wyner.dashboard.headless.time.sleep", lambda seconds: None)
    script, out = source(steps), io.StringIO()
    assert run_headless(script, until=lambda: script.exhausted, out=out) is Ending.FINISHED
    return out.getvalue()


def test_headless_lines_tell_the_story_without_control_codes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = headless(2000, monkeypatch)
    assert all(c.isprintable() for c in text.replace("\n", ""))
    for told in (
        "session 3f2a9c51d07be684: rehearsal",
        "an experiment, nothing here is secret",
        "plant running",
        "controller running",
        "tap nearest-centre listens",
        f'message 1 recovered at step 1163: "{MESSAGE_TEXT}"',
        f'tap list-decoder has the message: "{MESSAGE_TEXT}"',
        "tap list-decoder was sure of a message at step 1163",
    ):
        assert text.count(told) == 1, told
    assert "PAPER'S RULE EXCEEDS TRUE" in text.splitlines()[-1]
    # Twenty seconds of wall time: a line of progress each two, and a dozen events.
    assert len(text.splitlines()) <= 20 / 2 + 2 + 15


def test_what_happens_while_no_step_is_made_is_said_once() -> None:
    state = state_after(20)
    reporter = Reporter()
    reporter.report(state, 0)
    frame, secrets = {"messages": 1}, {"last_message": "Hello"}
    refused = {"phase": "refused", "detail": "another model"}
    trouble = with_plant(state, **refused, frame=frame, secrets=secrets)
    said = []
    for n in range(70):
        wrong = with_plant(trouble, step={"symbol_errors": n}, attack="ghost at the sensor")
        said += reporter.report(wrong, n * 100_000_000)
    assert said == [
        "plant refused: another model",
        "attack: ghost at the sensor",
        'message 1 recovered: "Hello"',
        "step 20: a key is not the plant's input (its sensor is being attacked)",
    ]
    assert "wrong keys 69" in progress(wrong), "dozens of lines said so, one a key"
    back = reporter.report(with_plant(trouble, phase="running", detail=""), 0)
    assert back == ["plant running"]


def test_attached_late_it_tells_what_is_so_and_not_when_it_came_to_be() -> None:
    whole = state_after(2000)
    text, under_way = "A second message.", {"symbols": 40, "length": 200}
    state = LoopState()
    for message in (
        whole.model,
        plant_of(with_plant(whole, secrets={"message": "A sec"})),
        with_controller(whole, secrets={"message": text}, frame=under_way).controller,
        whole.taps["list-decoder"].status,
    ):
        assert message is not None
        state = reduce_all(state, [Arrival(1, message)])
    lines = Reporter().report(state, 0)
    assert lines[0].startswith("session 3f2a9c51d07be684: rehearsal")
    assert f'message 1 recovered at step 1163: "{MESSAGE_TEXT}"' in lines
    assert f'tap list-decoder has the message: "{MESSAGE_TEXT}"' in lines
    assert "tap list-decoder was sure of a message at step 1163" in lines
    assert not any(word in "\n".join(lines) for word in (" began", " at k 2000", " steps:"))
    assert lines[-1].endswith("62/62 characters, old")
    assert progress(whole).endswith("62/62 characters")


def test_lines_show_all_that_is_printable_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    message = "第二の手紙 second ✓ e\u0301"
    state = state_after(20)
    state = with_controller(state, secrets={"message": message})
    state = with_plant(state, frame={"messages": 1}, secrets={"last_message": message})
    tap = state.taps["list-decoder"].status
    named = changed(
        tap,
        name="\x1b[31mtap",
        belief={"message": message},
        seq=tap.seq + 1,
        t_ns=tap.t_ns + 1,
    )
    state = reduce_all(state, [Arrival(1, named)])
    lines = [*Reporter().report(state, 0), secrecy_line(state)]
    assert f'message 1 recovered: "{message}"' in lines
    assert f'tap ·[31mtap has the message: "{message}"' in lines
    assert "·[31mtap leaves at most 0 bit" in lines[-1]
    assert all(c.isprintable() for line in lines for c in line)
