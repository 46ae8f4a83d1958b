"""The screen as a pure function: a state, a size and what the user asked for, to lines.

It is laid out for 80x24 at least, and a smaller terminal shows the upper left part. Where a caption
takes the room, the message goes, then the loop.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Final

from rich.cells import cell_len
from rich.console import Group
from rich.text import Text

from wyner.dashboard.model import LoopState
from wyner.dashboard.picture import agreement
from wyner.dashboard.score import ranked, rate_in_words, secrecy, truth_for
from wyner.dashboard.secrecy_panel import amounts, distilled, eavesdroppers, explanation
from wyner.dashboard.text import (
    LEVELS,
    STYLES,
    VALUE_AT,
    beside,
    component,
    count,
    drawn,
    in_words,
    labelled,
    letters,
    line,
    longest,
    number,
    rule,
    sparkline,
    symbol_of,
)

SMALLEST: Final = (80, 24)
"""Columns and rows that the screen is laid out for at least."""

SILENT_AFTER_NS: Final = 2_000_000_000
"""A service that has not been heard for this long is called silent."""

LOOP_ROWS: Final = 9
"""Lines of the panel of the loop on a screen of 24."""

HISTORY: Final = 240
"""States of the history, at least as many as the widest sparkline shows."""

TOO_MANY: Final = 20
"""One missed step in so many is shown as trouble."""

KEYS: Final = (
    ("q", "quit", "leave the dashboard"),
    ("?", "help", "show or hide this page"),
    ("Space", "freeze", "hold the view; the run goes on and is counted"),
)
"""What is typed, its meaning in short and as a whole."""

HELP: Final = (
    "Key test: how far the next state lies from where each input would have led,",
    "up to the edge of D_c (1), then of D_e = alpha D_c. A key is agreed when one",
    "bar alone ends in D_c and none beyond D_e. Last steps: Eve's guess, its odds.",
    "keys: those of both ends, the strongest eavesdropper's below; ^ is a wrong one.",
    "wrong keys: keys that are not the plant's input, as under an attack.",
    "missed: steps whose input did not come in time.",
    "paper's rule: bits that it counts as secret. true: what the best eavesdropper",
    "leaves of them at most. bit/s: what was sent, how much of it may be secret.",
    "keys found: per cent, [95 % limits, however often you look]. secret bit/key:",
    "-log2 of Eve's chance, at most. whole at step: when Eve was sure of the text.",
    "Eve's probabilities are its own claims: no interval.",
    "reported, true: what the sensor says and what is so, under an attack.",
    "`wyner report` writes the same comparison as a page, once a run is over.",
)

_NO_TAP: Final = ("no tap", "")

_LABEL: Final = re.compile(r" +|\S+(?: \S+)? {2,}")
"""What stands before the text of a line: spaces, or what it is about."""


@dataclass(frozen=True, slots=True)
class ViewState:
    """What the user asked of the view.

    ``held_steps`` counts the steps made since the view was frozen, None when another session began
    meanwhile; ``note`` stands in the last line instead of the keys. ``caption`` is a title and its
    lines: a pause of the story, or the end of the run, and ``press`` says how to go on.
    """

    frozen: bool = False
    held_steps: int | None = 0
    help: bool = False
    title: str = ""
    caption: tuple[str, ...] = ()
    press: str = ""
    note: str = ""


def screen(state: LoopState, width: int, height: int, view: ViewState, now_ns: int) -> Group:
    """The whole screen, ``height`` lines of at most ``width`` cells."""
    rows = max(height, SMALLEST[1]) - 1
    page = _Page(state, max(width, SMALLEST[0]), view, now_ns)
    body = page.help() if view.help else page.body(rows)
    body += [line()] * (rows - len(body))
    lines = [*body[: height - 1], page.footer()]
    for each in lines:
        each.truncate(width, overflow="ellipsis")
    return Group(*lines)


class _Page:
    def __init__(self, state: LoopState, width: int, view: ViewState, now_ns: int) -> None:
        self.state, self.width, self.view, self.now_ns = state, width, view, now_ns
        self.taps = ranked(state)
        self.secrecy = secrecy(state)

    def body(self, height: int) -> list[Text]:
        """The panels that fit; the loop and its picture grow with the screen."""
        caption, keys = self._caption(), distilled(self.state, self.width)
        table = 0 if caption else 2
        spare = max(0, height - 1 - LOOP_ROWS - 5 - 3 - len(keys) - len(caption) - table)
        more_taps = max(0, min(spare, len(self.taps) - 1, 7)) if table else 0
        spare -= more_taps
        explained = spare >= 4
        spare -= explained
        shown = self.taps[: 1 + more_taps] if table else []
        hidden = 0 < len(shown) < len(self.taps)
        note = f"the strongest {len(shown)} of {len(self.taps)} eavesdroppers" if hidden else ""
        below = [rule("Secrecy", self.width, note), *amounts(self.secrecy, self.width), *keys]
        if table:
            below += eavesdroppers(self.state, shown)
        if explained:
            below.append(explanation(self.secrecy, self.width))
        panels = [self.top(LOOP_ROWS + spare), self.message(), [*below, *caption]]
        for spared in (1, 0):
            if sum(map(len, panels)) > height - 1:
                panels.pop(spared)
        return [self.header(), *(row for panel in panels for row in panel)]

    def _caption(self) -> list[Text]:
        """A pause of the story, or the end of the run."""
        if not self.view.caption:
            return []
        title, *told = self.view.caption
        rows = [
            row
            for text in told
            for row in wrap(drawn(text), self.width - 2, subsequent_indent=_indent(text))
        ]
        return [rule(drawn(title), self.width), *(line(f" {row}") for row in rows)]

    def header(self) -> Text:
        """One line: what is watched and how it is; what tells less is last, and goes first."""
        parts, about = self._parts()
        while about and sum(2 + cell_len(part) for part in (*parts, *about)) > self.width:
            about.pop()
        shown = line(" " + "  ".join([*parts, *about]), "reverse")
        shown.truncate(self.width, overflow="ellipsis", pad=True)
        return shown

    def _parts(self) -> tuple[list[str], list[str]]:
        """What the first line says, and what it can do without."""
        plant, model, controller = self.state.plant, self.state.model, self.state.controller
        parts: list[str] = [self.view.title or "wyner"]
        about: list[str] = []
        if self.view.frozen:
            steps = self.view.held_steps
            parts.append(f"FROZEN, {'new session' if steps is None else f'{steps} steps on'}")
        if plant is None:
            parts.append("waiting for the plant")
        else:
            if model is not None:
                parts.append(drawn(model.scenario))
                about = [f"pace {drawn(model.pace)}", f"alpha {number(model.alpha)}"]
            known = plant.phase in ("running", "refused")
            parts.append(plant.phase if known else in_words("plant", plant.phase))
            about.append(f"session {plant.session[:8]}")
            if model is not None and model.seeded:
                parts.append("SEEDED: no secret")
            if plant.frame.refused:
                parts.append(f"{count(plant.frame.refused)} frames refused")
            if plant.attack:
                parts.append(f"ATTACK: {drawn(plant.attack)}")
        if controller is not None and controller.phase != "running":
            parts.append(in_words("controller", controller.phase))
        ends = (end for end in (plant, controller) if end is not None)
        reasons = [drawn(end.detail) for end in ends if end.detail]
        silent = [f"{name} silent" for name in self._silent()]
        return [*parts, *silent, *reasons], about

    def _silent(self) -> list[str]:
        """The services whose statuses stopped without a last one that says so."""
        ends = {"plant": self.state.plant, "controller": self.state.controller}
        over = {name for name, end in ends.items() if end is not None and end.phase == "stopped"}
        heard = [name for name in (*ends, "tap") if name in self.state.seen and name not in over]
        return [n for n in heard if self.now_ns - self.state.seen[n] > SILENT_AFTER_NS]

    def footer(self) -> Text:
        """One line: how to go on, a note, or the keys."""
        view = self.view
        if view.note or view.caption:
            shown = line(f" {view.note or view.press}", "bold" if view.note else "reverse")
            shown.truncate(self.width, pad=not view.note)
            return shown
        keys = line()
        for key, short, _ in KEYS:
            keys.append(f" {key} ", style="reverse")
            keys.append(f" {'go on' if short == 'freeze' and view.frozen else short}  ")
        malformed = f"{count(self.state.malformed)} malformed" if self.state.malformed else ""
        heard = f"{count(self.state.received)} messages"
        whole = f"{heard}, {malformed}" if malformed else heard
        tail = longest(self.width - keys.cell_len - 2, whole, malformed)
        return keys.append(tail.rjust(self.width - keys.cell_len - 1), style="dim")

    def top(self, rows: int) -> list[Text]:
        """The loop and its keys; the key test and the last steps beside them."""
        left = 40 if self.width < 100 else min(54, self.width // 2 - 6)
        right = self.width - left - 1
        test = agreement(self.state.model, self.state.pictured, right, rows)
        if (rest := rows - len(test)) > 1:
            test += self.last_steps(right, rest)
        lines = beside(self.loop(left, rows), test, left)
        return lines + [line()] * (rows - len(lines))

    def loop(self, width: int, height: int) -> list[Text]:
        """Step, state with history, rate, where the state is, and the keys."""
        plant, model = self.state.plant, self.state.model
        if plant is None:
            waiting = [line(" no word from the plant yet"), *[line()] * 4]
            return [rule("Control loop", width), *waiting, *self.keys(width)]
        counts, wrong = plant.step, plant.step.symbol_errors
        notes = [f"wrong keys {count(wrong)}"]
        if plant.sessions > 1:
            notes.insert(0, f"{notes[0]}  session {count(plant.sessions)}")
        title = rule("Control loop", width, *notes, style=STYLES["bad"] if wrong else "")
        rate_hz = plant.timing.rate_hz
        pace = f"  {longest(7, f'{rate_hz:.1f}', number(rate_hz))} steps/s"
        seconds = "" if model is None else f"  {counts.k * model.period_s:.1f} s"
        missed = f"  missed {count(counts.missed)}" if counts.missed else ""
        room = width - cell_len(missed)
        begun = f" step {counts.k}"
        step = line(longest(room, f"{begun}{seconds}{pace}", f"{begun}{pace}", begun))
        bad = counts.missed * TOO_MANY > counts.transitions + counts.missed
        step.append(missed, STYLES["bad"] if bad else "")
        rate = line(f" {rate_in_words(self.state)}")
        states = self._states(counts.x, width, height - LOOP_ROWS + 2)
        return [title, step, *states, rate, self._control(width), *self.keys(width)]

    def _control(self, width: int) -> Text:
        """Where the state is among the controller's sets, or an alarm.

        The controller only knows the reported state: the line says how far the plant is from it.
        """
        controller, alarms = self.state.controller, self.state.alarms
        if alarms:
            short = alarms.partition(": read")[0]
            told = longest(width, f" {alarms}", f" {short}", f" {short.partition(',')[0]}")
            return line(told, STYLES["bad"])
        if controller is None or controller.set_index < 0:
            where = ("outside of every set, or silent", "outside sets")
        elif controller.set_index == 0:
            where = ("inside the target set", "in target set")
        else:
            steps = f"{count(controller.set_index)} steps"
            where = (f"at most {steps} to the target set", f"{steps} off")
        if not self.state.away:
            return line(longest(width, f" state: {where[0]}", f" state: {where[1]}"))
        off = f"plant {number(self.state.away)} away"
        told = longest(width, f" reported {where[0]}; {off}", f" reported {where[1]}; {off}")
        return line(told, STYLES["bad"])

    def _states(self, x: Sequence[float], width: int, rows: int) -> list[Text]:
        """A row for each component with its history, as far as there is room.

        Of an attacked plant the true component, with its history, stands beside the reported one.
        """
        truths, lines = [self.state.truths[k] for k in sorted(self.state.truths)], []
        attacked = bool(truths and truths[-1].true_x_next)
        history = [row.true_x_next if attacked else row.x for row in truths[-HISTORY:]]
        for i, value in enumerate(x):
            values = [state[i] for state in history if i < len(state)]
            if attacked:
                told = f" x{i + 1} reported {component(value, '+'):>8}, true "
                told += f"{component(values[-1], '+'):>8} "
            else:
                told = f" x{i + 1}  {component(value, '+'):>8}  "
                values.append(value)
            room = max(0, width - len(told))
            lines.append(line(told + sparkline(values[-room:] if room else [], LEVELS)))
        if len(lines) > rows:
            lines[rows - 1 :] = [line(f" and {len(lines) - rows + 1} more states")]
        return lines + [line()] * (2 - len(lines))

    def keys(self, width: int) -> list[Text]:
        """Key symbols agreed, the strongest shown tap's guesses below them, and marks."""
        plant, truths = self.state.plant, self.state.truths
        agreed = [k for k in sorted(truths) if truths[k].symbol >= 0]
        if self.taps:  # one that lags is compared at the last steps that it has a guess for
            guesses = self.taps[0][0].guesses
            agreed = [k for k in agreed if k in guesses] or agreed
        size = self.state.candidates
        wide = len(symbol_of(0, size))
        agreed = agreed[-(max(0, width - VALUE_AT) // wide) :]
        total = plant.step.agreements if plant else 0
        truth = "".join(symbol_of(truths[k].symbol, size) for k in agreed)
        first = labelled(f"{count(total)} {'key' if total == 1 else 'keys'}", line(truth))
        if not self.taps:
            return [first, *(labelled(text, line()) for text in _NO_TAP)]
        tap = self.taps[0][0]
        guessed, marks, wrong = line(), line(), 0
        for k in agreed:
            guess = tap.guesses.get(k)
            bad = guess is not None and guess.symbol != truths[k].symbol
            said = " " * wide if guess is None else symbol_of(guess.symbol, size)
            guessed.append(said, style=STYLES["wrong" if bad else ""])
            marks.append(("^" if bad else " ").ljust(wide), style=STYLES["bad"])
            wrong += bad
        heard = any(k in tap.guesses for k in agreed)
        told = f"{wrong} wrong" if heard else "no guess yet"
        return [first, labelled(tap.status.name, guessed), labelled(told, marks)]

    def last_steps(self, width: int, rows: int) -> list[Text]:
        """What happened in the last transitions, the newest first, and Eve's guess at each.

        Where Eve is behind, the newest steps are those that Eve has guessed at.
        """
        truths, tap = self.state.truths, self.taps[0][0] if self.taps else None
        guesses = {} if tap is None else tap.guesses
        steps, late = sorted(truths, reverse=True), ""
        if guessed := [k for k in steps if k in guesses]:
            behind = steps[0] - guessed[0]
            if behind >= rows:
                late = f"Eve is {count(behind)} steps behind"
                steps = [k for k in steps if k <= guessed[0]]
        lines = [rule("Last steps", width, late)]
        for k in steps[: rows - 1]:
            truth = truths[k]
            what = "message" if truth.role == "message" else "no key"
            what = f"key {truth.symbol}" if truth.symbol >= 0 else what
            row = line(f" {k:<6} input {truth.coin} {what:<7}")
            if (guess := guesses.get(k)) is not None:
                wrong = truth.symbol >= 0 and guess.symbol != truth.symbol
                row.append(f" Eve: {guess.symbol}, {guess.probability:.2f}")
                row.append(" ^" if wrong else "", style=STYLES["bad"])
            lines.append(row)
        return lines

    def message(self) -> list[Text]:
        """Sent, recovered and what Eve has, one below the other, wrong characters marked with ^."""
        state = self.state
        sent, recovered = letters(state.sent), letters(state.recovered)
        room = self.width - VALUE_AT
        start = min(max(0, len(recovered) - room * 3 // 4), max(0, len(sent) - room))
        note = f"{len(recovered)} of {len(sent)} characters"
        if (controller := state.controller) is not None:
            frame = controller.frame
            note += f"; messages delivered: {count(frame.delivered)}, waiting: {count(frame.queue)}"
        lines = [rule("Message", self.width, note)]
        lines.append(labelled("sent", line(drawn(sent)[start:])))
        lines.append(labelled("plant has", self._marked(recovered, sent, start)[0]))
        tap = next((tap for tap, _ in self.taps if tap.status.keys is None), None)
        if tap is None:
            return [*lines, *(labelled(text, line()) for text in _NO_TAP)]
        hers = letters(tap.status.belief.message)
        truth = letters(truth_for(state, tap.status.belief.message))
        same = truth == sent
        hers = hers[: len(truth)] if truth else hers  # noise goes on for pages
        guess, marks = self._marked(hers, truth, start if same else 0)
        lines.append(labelled(tap.status.name, guess))
        if tap.status.failed:
            return [*lines, labelled("FAILED", line(drawn(tap.status.failed), STYLES["bad"]))]
        wrong = f"{marks.plain.count('^')} wrong" if hers else "no text yet"
        return [*lines, labelled(wrong if same else f"{wrong}, old", marks)]

    def _marked(self, text: str, truth: str, start: int) -> tuple[Text, Text]:
        """The characters that there is room for, and a ^ for each that is wrong."""
        shown, marks = line(), line()
        for i, cell in enumerate(drawn(text)):
            if start <= i < start + self.width - VALUE_AT:
                right = i < len(truth) and text[i] == truth[i]
                shown.append(cell, style=STYLES["good" if right else "wrong"])
                marks.append(" " if right else "^", style=STYLES["bad"])
        return shown, marks

    def help(self) -> list[Text]:
        """The keys, then how to read the screen."""
        lines = [rule("Keys", self.width)]
        lines += [labelled(key, line(meaning)) for key, _, meaning in KEYS]
        return [*lines, rule("How to read it", self.width), *(line(f" {text}") for text in HELP)]


def _indent(text: str) -> str:
    """What a line goes on below: its text where it has a label."""
    label = _LABEL.match(text)
    return " " * (len(label[0]) if label else 3)
