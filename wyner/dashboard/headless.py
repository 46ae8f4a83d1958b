"""Without a terminal: plain lines, one when something happened, never more than a bounded rate."""

import sys
import time
from collections.abc import Callable, Hashable, Iterator
from typing import IO, Final

from protocol.text import printable
from wyner.dashboard.app import REFRESH_S, Ending
from wyner.dashboard.model import LoopState, TapState, reduce_all
from wyner.dashboard.score import (
    characters_right,
    contradictions,
    rate_in_words,
    score,
    secrecy,
    truth_for,
)
from wyner.dashboard.secrecy_panel import held, keys_right
from wyner.dashboard.source import BusSource
from wyner.dashboard.story import next_moment
from wyner.dashboard.text import component, in_words, letters

PROGRESS_NS: Final = 2_000_000_000
"""Time between two lines of progress."""

COUNTED: Final = (
    "bit/s and % are counts of this run; [low, high] are 95 % limits, however often one looks"
)
"""Said once, before the first figure."""

Fact = tuple[str, Hashable, str]
"""What it is about, its value, and the line that tells it; it is told when the value changes."""


class Reporter:
    """Lines for what is new since the last call."""

    def __init__(self) -> None:
        self._told: dict[str, Hashable] = {}
        self._next_ns = 0
        self._at: tuple[str, int] | None = None

    def report(self, state: LoopState, now_ns: int) -> list[str]:
        """A line for each event, then progress if it is due."""
        lines = []
        for about, value, line in facts(state):
            if self._told.get(about) != value:
                self._told[about] = value
                lines.append(line)
        now = (state.plant.session, state.plant.step.k) if state.plant is not None else None
        if now is None or now == self._at or now_ns < self._next_ns:
            return lines
        self._at, self._next_ns = now, now_ns + PROGRESS_NS
        return [*lines, progress(state)]


def facts(state: LoopState) -> Iterator[Fact]:
    """Everything that is worth a line when it changes."""
    plant, model, controller = state.plant, state.model, state.controller
    if plant is not None and model is not None:
        what = f"{printable(model.scenario)}, alpha {model.alpha:g}, law {printable(model.law)}"
        yield "session", plant.session, f"session {plant.session}: {what}"
        yield "counted", True, COUNTED
        if model.seeded:
            seeded = "random choices are seeded: an experiment, nothing here is secret"
            yield "seeded", True, seeded
    for name, end in (("plant", plant), ("controller", controller)):
        if end is not None:
            why = f": {printable(end.detail)}" if end.detail else ""
            yield name, end.phase, f"{in_words(name, end.phase)}{why}"
    if plant is not None:
        if plant.attack:
            yield "attack", plant.attack, f"attack: {plant.attack}"
        if plant.step.symbol_errors:
            why = " (its sensor is being attacked)" if plant.attack else ""
            yield "wrong", True, f"step {plant.step.k}: a key is not the plant's input{why}"
        if n := plant.frame.messages:
            at = f" at step {plant.frame.message_k}" if plant.frame.message_k >= 0 else ""
            yield "message", n, f"message {n} recovered{at}: {_quoted(plant.secrets.last_message)}"
    for name, tap in state.taps.items():
        yield from _of_tap(printable(name), tap)
    for text in contradictions(state):
        yield text.partition(":")[0], True, printable(text)


def _of_tap(name: str, tap: TapState) -> Iterator[Fact]:
    yield f"tap {name}", True, f"tap {name} listens"
    failed, keys, belief = tap.status.failed, tap.status.keys, tap.status.belief
    if failed:
        yield f"{name} failed", failed, f"tap {name} FAILED: {printable(failed)}"
    if tap.exact:
        yield f"{name} exact", True, f"tap {name} has the message: {_quoted(belief.message)}"
    if (k := belief.solved_k) >= 0:
        wrong = tap.watched and not tap.exact
        judged = ", but it is not a true one" if wrong else ""
        yield f"{name} sure", k, f"tap {name} was sure of a message at step {k}{judged}"
    if keys is not None and keys.bits:
        yield f"{name} bits", True, f"tap {name} holds {keys.bits} bits of keys"


def progress(state: LoopState) -> str:
    """One line on where the loop, the message and the strongest tap stand."""
    plant = state.plant
    assert plant is not None
    recovered, sent = len(letters(state.recovered)), len(letters(state.sent))
    distilled = state.model is not None and bool(state.model.keys_claim)
    # `sealed` agrees on no key symbol: its message travels under distilled keys
    step = plant.step
    agreed = [f"keys {step.agreements}"] if step.agreements or not distilled else []
    troubles = {
        "wrong keys": step.symbol_errors,
        "frames refused": plant.frame.refused,
        "malformed": state.malformed,
    }
    parts = [
        f"step {step.k}",
        f"x ({', '.join(component(v) for v in step.x)})",
        *agreed,
        f"missed {step.missed}",
        *(f"{what} {n}" for what, n in troubles.items() if n),
        rate_in_words(state),
        f"recovered {recovered}/{sent} {_quoted(state.recovered)}",
    ]
    if distilled:
        parts.append(f"distilled keys {plant.keys.made}, {held(state, 99)[0]}")
    if state.away:
        parts.append(f"the plant is {component(state.away)} from the x reported")
    if state.alarms:
        parts.append(state.alarms)
    its = secrecy(state)
    if its.strongest:
        tap = state.taps[its.strongest]
        scored = score(state, tap)
        right, total = characters_right(state, tap)
        old = "" if truth_for(state, tap.status.belief.message) == state.sent else ", old"
        parts.append(
            f"{printable(its.strongest)}: {keys_right(scored)} % of key symbols,"
            f" {right}/{total} characters{old}"
        )
    return "  ".join(parts)


def secrecy_line(state: LoopState) -> str:
    """What the paper's rule counts against what is true, in words."""
    its = secrecy(state)
    told = f"{its.claimed_bits:.0f} bit by the paper's rule"
    failed = f"; FAILED: {', '.join(map(printable, its.failed))}" if its.failed else ""
    if its.left_bits is None:
        return f"secrecy: {told}, true unknown: {its.why}{failed}"
    loud = "PAPER'S RULE EXCEEDS TRUE: " if its.exceeds else ""
    of = f" of {its.claimed_bits - its.silent_bits:.0f}" if its.silent_bits else ""
    left = f"{printable(its.strongest)} leaves at most {its.left_bits:.0f}{of} bit"
    why = f" ({its.why})" if its.why else ""
    return f"secrecy: {loud}{told}, {left}{why}{failed}"


def run_headless(
    source: BusSource,
    *,
    until: Callable[[], bool],
    out: IO[str] | None = None,
    story: bool = False,
) -> Ending:
    """Print lines until ``until()`` or Ctrl-C; as `wyner.dashboard.app.run_dashboard` draws.

    Lines carry no control codes. A broken pipe is the caller's.
    """
    stream = out or sys.stdout
    state, reporter = LoopState(), Reporter()
    told: set[int] = set()
    last = ""

    def say(lines: list[str]) -> None:
        encoding = getattr(stream, "encoding", None) or "utf-8"
        for line in lines:
            print(line.encode(encoding, "replace").decode(encoding), file=stream)
        if lines:
            stream.flush()

    ending = Ending.FINISHED
    try:
        while True:
            finished = until()
            state = reduce_all(state, source.drain())
            lines = reporter.report(state, source.now_ns())
            say(lines)
            last = lines[-1] if lines else last
            while story and (found := next_moment(state, told)) is not None:
                told.add(found[0])
                title, *captions = found[1]
                say([f"* {title}", *(f"  {line}" for line in captions)])
            if finished:
                break
            time.sleep(REFRESH_S)
    except KeyboardInterrupt:
        ending = Ending.INTERRUPTED
    if state.plant is not None:
        now = progress(state)
        say([*([] if last == now else [now]), secrecy_line(state)])
    for line in source.problems():
        print(line, file=sys.stderr)
    return ending


def _quoted(text: str, room: int = 72) -> str:
    shown = text if len(text) <= room else "..." + text[-room:]
    return f'"{printable(shown)}"'
