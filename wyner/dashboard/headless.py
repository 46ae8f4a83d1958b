"""Without a terminal: plain lines, one when something happened, never more than a bounded rate."""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import IO, Final

from protocol.messages import PlantModel, PlantStatus
from protocol.text import printable
from wyner.dashboard.app import REFRESH_S, Ending
from wyner.dashboard.model import State, TapState, reduce_all
from wyner.dashboard.score import (
    characters_right,
    rate_in_words,
    score,
    secrecy,
    time_left_s,
    truth_for,
)
from wyner.dashboard.secrecy_panel import attacker, contradictions, held, keys_right
from wyner.dashboard.source import Source
from wyner.dashboard.story import next_moment
from wyner.dashboard.text import component, duration, in_words, letters

PROGRESS_NS: Final = 2_000_000_000
"""Time between two lines of progress."""

COUNTED: Final = (
    "bit/s and % are counts of this run; [low,high] are 95 % limits, however often one looks"
)
"""Said once, before the first figure."""

LINES_AT_ONCE: Final = 12
"""Lines printed for one look at the messages; what is beyond is counted in a line."""


@dataclass(frozen=True, slots=True)
class Reporter:
    """What was said already; `report` gives the next lines and the next reporter.

    ``told`` is the session and the step k that the last line of progress was about.
    """

    before: State = field(default_factory=State)
    next_progress_ns: int = 0
    told: tuple[str, int] | None = None

    def report(self, state: State, now_ns: int) -> tuple[list[str], "Reporter"]:
        """Lines for what is new since the last call, at most `LINES_AT_ONCE` and one more."""
        lines = list(_events(self.before, state))
        if len(lines) > LINES_AT_ONCE:
            more = len(lines) - LINES_AT_ONCE
            lines = [*lines[:LINES_AT_ONCE], f"... and {more} events more"]
        now = (state.plant.session, state.plant.k) if state.plant is not None else None
        if now is None or now == self.told or now_ns < self.next_progress_ns:
            return lines, replace(self, before=state)
        return [*lines, progress(state)], Reporter(state, now_ns + PROGRESS_NS, now)


def progress(state: State) -> str:
    """One line on where the loop, the message and the strongest tap stand."""
    plant = state.plant
    assert plant is not None
    recovered, sent = len(letters(state.recovered)), len(letters(state.sent))
    distilled = state.model is not None and bool(state.model.keys_claim)
    # `sealed` agrees on no key symbol: its message travels under distilled keys
    agreed = [f"keys {plant.agreements}"] if plant.agreements or not distilled else []
    parts = [
        f"step {plant.k}",
        f"x ({', '.join(component(v) for v in plant.x)})",
        *agreed,
        f"missed {plant.missed}",
        rate_in_words(state),
        f"recovered {recovered}/{sent} {_quoted(state.recovered)}",
    ]
    if distilled:
        parts.append(f"distilled keys {plant.keys_made}, {held(state, 99)[0]}")
    if state.alarms:
        parts.append(state.alarms)
    left = time_left_s(state)
    if left is not None:
        parts.append(f"{duration(left)} to go")
    its = secrecy(state)
    if its.strongest:
        tap = state.taps[its.strongest]
        scored = score(state, tap)
        right, total = characters_right(state, tap)
        old = "" if truth_for(state, tap.status.message) == state.sent else ", old"
        parts.append(
            f"{printable(its.strongest)}: {keys_right(scored)} % of key symbols,"
            f" {right}/{total} characters{old}"
        )
    return "  ".join(parts)


def secrecy_line(state: State) -> str:
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
    source: Source,
    *,
    until: Callable[[], bool],
    out: IO[str] | None = None,
    story: bool = False,
) -> Ending:
    """Print lines until ``until()`` or Ctrl-C; as `wyner.dashboard.app.run_dashboard` draws.

    Lines carry no control codes. Whoever reads them may go away: a broken pipe is the caller's.
    """
    stream = out or sys.stdout
    state, reporter = State(), Reporter()
    told: set[int] = set()
    said: list[str] = []

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
            state = replace(reduce_all(state, source.drain()), unreadable=source.malformed)
            lines, reporter = reporter.report(state, source.now_ns())
            say(lines)
            said = lines[-1:] or said
            while story and (found := next_moment(state, told)) is not None:
                told.add(found[0])
                title, *captions = found[1].caption
                say([f"* {title}", *(f"  {line}" for line in captions)])
            if finished:
                break
            time.sleep(REFRESH_S)
    except KeyboardInterrupt:
        ending = Ending.INTERRUPTED
    if state.plant is not None:
        last = progress(state)
        say([*([] if said == [last] else [last]), secrecy_line(state)])
    for line in source.problems():
        print(line, file=sys.stderr)
    return ending


def _events(before: State, state: State) -> Iterator[str]:
    plant, was = state.plant, before.plant
    if plant is not None:
        yield from _session(before, plant, state.model)
        if was is None or was.phase != plant.phase:
            yield f"{in_words('plant', plant.phase)}{_because(plant.detail)}"
        if plant.attack and (was is None or was.attack != plant.attack):
            yield f"attack: {plant.attack}"
        if was is not None and plant.symbol_errors > was.symbol_errors:
            more = plant.symbol_errors - was.symbol_errors
            keys = "key" if more == 1 else "keys"
            yield f"{more} wrong {keys} at step {plant.k}: not the input that the plant applied"
        if was is not None and plant.frames_refused > was.frames_refused:
            more = plant.frames_refused - was.frames_refused
            frames = "frame" if more == 1 else "frames"
            yield f"{more} {frames} refused by the check at step {plant.k}"
        if plant.messages > (was.messages if was is not None else 0):
            how = (
                "is the last recovered" if was is None else f"recovered at step {_whole_at(plant)}"
            )
            yield f"message {plant.messages} {how}: {_quoted(plant.last_message)}"
    controller, was_controller = state.controller, before.controller
    if controller is not None and (
        was_controller is None or was_controller.phase != controller.phase
    ):
        yield f"{in_words('controller', controller.phase)}{_because(controller.detail)}"
    for name, tap in state.taps.items():
        yield from _tap_events(printable(name), before, tap, state)
    yield from _key_events(before, state)
    if state.malformed > before.malformed:
        yield f"{state.malformed - before.malformed} messages were malformed"


def _session(before: State, plant: PlantStatus, model: PlantModel | None) -> Iterator[str]:
    """Which session this is, of which plant: as soon as both are known."""
    if model is None:
        return
    first = before.plant is None or before.model is None
    if not first and before.plant is not None and before.plant.session == plant.session:
        return
    law = printable(model.law)
    what = f"{printable(model.scenario)}, alpha {model.alpha:g}, law {law}"
    yield f"session {plant.session}{'' if first else ' began'}: {what}"
    if first:
        yield COUNTED
    if model.seeded:
        yield "random choices are seeded: an experiment, nothing here is secret"


def _whole_at(plant: PlantStatus) -> int:
    """The step of the last message, or where the plant does not know any more, the step now."""
    return plant.message_k if plant.message_k >= 0 else plant.k


def _tap_events(name: str, before: State, tap: TapState, state: State) -> Iterator[str]:
    was, text = before.taps.get(tap.status.name), tap.status.message
    if was is None:
        yield f"tap {name} listens"
    failed, before_it = tap.status.failed, "" if was is None else was.status.failed
    if failed and failed != before_it:
        yield f"tap {name} FAILED: {printable(failed)}"
    elif before_it and not failed:
        yield f"tap {name} guesses again"
    solved = tap.status.solved_k
    newly_sure = solved >= 0 and (was is None or was.status.solved_k != solved)
    if tap.exact and (was is None or not (was.exact or newly_sure)):
        # Where the truth is what came last, she may have held the message for long.
        new = state.plant is not None and was is not None and text in before.texts
        at = f" by step {state.plant.k}" if state.plant is not None and new else ""
        unsure = ", and is not sure yet" if at and solved < 0 else ""
        yield f"tap {name} holds the true message{at}{unsure}: {_quoted(text)}"
    if newly_sure:
        judged = ", and it is the true one" if tap.exact else ", but it is not a true one"
        if not state.texts:  # a replay: nobody here knows the truth
            judged = f": {_quoted(text)}"
        elif not tap.watched:  # it may have been another message than the one that she holds now
            judged = ""
        yield f"tap {name} was sure of a message at step {solved}{judged}"


def _key_events(before: State, state: State) -> Iterator[str]:
    """The first bits that she holds, and what has come up against the claim."""
    was, now = attacker(before), attacker(state)
    if now is None:
        return
    if now.key_bits_held and not (was is not None and was.key_bits_held):
        yield f"tap {printable(now.name)} holds {now.key_bits_held} bits of keys"
    known = {text.split()[1] for text in contradictions(before)}
    for text in contradictions(state):
        if text.split()[1] not in known:
            yield printable(text)


def _because(detail: str) -> str:
    return f": {printable(detail)}" if detail else ""


def _quoted(text: str, room: int = 72) -> str:
    shown = text if len(text) <= room else "..." + text[-room:]
    return f'"{printable(shown)}"'
