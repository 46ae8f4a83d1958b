"""The screen as a pure function: a state, a size and what the user asked for, to a group of panels.

Every panel is a renderable of rich's with a known number of lines. The screen is whole from 80x24
on; on a smaller one whole panels go, in the order of `DROPPED_FIRST`.
"""

import itertools
import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from textwrap import wrap
from typing import Final

from rich.cells import cell_len, set_cell_size
from rich.console import Group, RenderableType
from rich.layout import Layout
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from wyner.dashboard import keymap
from wyner.dashboard.model import State
from wyner.dashboard.parts import VALUE_AT, Row, labelled, line, rule, titled
from wyner.dashboard.picture import agreement
from wyner.dashboard.score import ranked, rate_in_words, secrecy, time_left_s, truth_for
from wyner.dashboard.secrecy_panel import curves, distilled, eavesdroppers, explanation
from wyner.dashboard.text import (
    FAINT,
    LEVELS,
    STYLES,
    component,
    count,
    drawn,
    duration,
    glyph,
    in_words,
    letters,
    longest,
    number,
    sparkline,
    symbol_of,
)

WHOLE: Final = (80, 24)
"""The size, columns and rows, from which every panel is shown."""

DROPPED_FIRST: Final = ("picture", "taps", "loop", "message")
"""Panels that a small screen does without, in turn."""

SILENT_AFTER_NS: Final = 2_000_000_000
"""A service that has not been heard for this long is called silent."""

REASON_AT_LEAST: Final = 12
"""Cells of a reason in the first line, which is cut there; it gets more where there is room."""

MORE_LOOP: Final = 4
"""Rows that the panel of the loop takes of those to spare; the last steps have the others."""

TOO_MANY: Final = 20
"""One missed step in so many is shown as trouble."""

STATE_CELLS: Final = 13
"""Cells of a component of the state with its name, its history aside."""

BAR: Final = 30
"""Cells of the bar of a message on its way."""

DOING: Final = ("-", "wait for a key", "use the key")
"""What an end is at, by the state of its automaton; 0 is not known."""

HELP: Final = (
    "Bars: how far the next state lies from where each input would have led: up to",
    "the edge of D_c (1), then of D_e = alpha D_c. A key is agreed when one bar",
    "alone ends in D_c and none beyond D_e. Below: the same in the plane of states.",
    "keys: those of both ends, the strongest eavesdropper's below; ^ is a wrong one.",
    "paper's rule: bits that it counts as secret. true: what the best eavesdropper",
    "leaves of them at most. keys found: per cent, [95 % limits, however often you",
    "look]. secret bit/key: -log2 of her chance, at most. texts tried: ways to read",
    "the steps that she keeps. model error: of her A, B. whole at step: when she was",
    "sure of the text. bit/s is a count and her odds are her own: no interval. When",
    "keys were agreed may stay hidden: at most f log2(2N + 1) bit for f widths.",
    "missed: steps whose input did not come in time. wrong keys: the ends differ.",
    "x1 said: the state as it is reported; x1 true: as it is, under an attack.",
    "A small screen drops, in turn: picture; taps; loop and keys; message.",
    "`wyner report` draws any step of a run that is over.",
)

Letters = tuple[str, ...]
Region = tuple[int, RenderableType]
"""Some lines, and what fills them."""

_NOBODY: Final[list[Row]] = [("no tap heard", line()), ("", line())]
_BLANK: Final = Text(" ")
"""A region without anything; rich takes an empty text for none."""

_LABEL: Final = re.compile(r" +|\S+(?: \S+)? {2,}")
"""What stands before the text of a line: spaces, or what it is about."""


@dataclass(frozen=True, slots=True)
class ViewState:
    """What the user asked of the view.

    ``held_steps`` counts the steps made since the view was frozen, None when another session began
    meanwhile; ``note`` stands in the last line instead of the keys; ``step`` is the pictured one
    that a caption is about. ``caption`` is a title and its lines: a pause of the story, or the end
    of the run, and ``press`` says how to go on.
    """

    frozen: bool = False
    held_steps: int | None = 0
    help: bool = False
    step: int | None = None
    title: str = ""
    caption: tuple[str, ...] = ()
    press: str = ""
    note: str = ""


def screen(state: State, width: int, height: int, view: ViewState, now_ns: int) -> RenderableType:
    """What fills ``height`` lines of ``width`` cells."""
    page = _Page(state, width, view, now_ns)
    body = page.help() if view.help else page.body(height - 1)
    return _stacked([(height - 1, _stacked(body, height - 1)), (1, page.footer())], height)


def _stacked(regions: Sequence[Region], height: int) -> Layout:
    """Regions one below the other; what is left stays blank."""
    left, parts = height, []
    for wanted, shown in [*regions, (height, _BLANK)]:
        rows = min(wanted, left)
        if rows > 0:
            parts.append(Layout(shown, size=rows))
        left -= rows
    layout = Layout()
    layout.split_column(*parts)
    return layout


class _Page:
    def __init__(self, state: State, width: int, view: ViewState, now_ns: int) -> None:
        self.state, self.width, self.view, self.now_ns = state, width, view, now_ns
        self.taps = ranked(state)
        self.secrecy = secrecy(state, self.taps)

    def body(self, height: int) -> list[Region]:
        """The panels that fit, the picture growing with the screen."""
        caption = self._caption()
        keys = distilled(self.state, self.width)
        fixed = 4 + len(keys) + sum(rows for rows, _ in caption)  # header, secrecy, caption
        sizes = {"picture": 0, "message": 5, "loop": 9, "taps": 2}
        if self.view.caption:
            del sizes["taps"]
        if self.width < WHOLE[0]:
            del sizes["picture"]
        for panel in DROPPED_FIRST:
            if fixed + sum(sizes.values()) <= height:
                break
            sizes.pop(panel, None)
        spare = height - fixed - sum(sizes.values())
        bar = int("message" in sizes and spare > 0)
        more_taps = max(0, min(spare - bar, len(self.taps) - 1, 7)) if "taps" in sizes else 0
        spare -= bar + more_taps
        explained = int(spare >= 4)
        spare -= explained
        texts = 1
        if "message" in sizes and spare >= 8:
            texts += max(0, min((spare - 4) // 2, len(self.taps) - 1))
            spare -= 2 * (texts - 1)
        regions: list[Region] = [(1, self.header())]
        if "loop" in sizes:
            rows = sizes["loop"] + max(0, spare)
            regions.append((rows, self._top(rows, max(0, spare), picture="picture" in sizes)))
        if "message" in sizes:
            regions.append((3 + bar + 2 * texts, self.message(texts, bar=bool(bar))))
        shown = self.taps[: 1 + more_taps] if "taps" in sizes else []
        note = ""
        if 0 < len(shown) < len(self.taps):
            note = f"the strongest {len(shown)} of {len(self.taps)} eavesdroppers"
        lines = [*curves(self.state, self.secrecy, self.width), *keys]
        regions.append((1 + len(lines), titled(rule("Secrecy", self.width, note), labelled(lines))))
        if "taps" in sizes:
            found = eavesdroppers(self.state, shown, self.width)
            regions.append((1 + max(1, len(shown)), Padding(found, (0, 0, 0, 1))))
        if explained:
            regions.append((1, explanation(self.secrecy, self.width)))
        return [*regions, *caption]

    def _caption(self) -> list[Region]:
        """A pause of the story, or the end of the run."""
        if not self.view.caption:
            return []
        title, *told = self.view.caption
        rows = [
            row
            for text in told
            for row in wrap(drawn(text), self.width - 2, subsequent_indent=_indent(text))
        ]
        shown = titled(rule(drawn(title), self.width), *(line(f" {row}") for row in rows))
        return [(1 + len(rows), shown)]

    def header(self) -> Text:
        """One line: what is watched and how it is; the less telling parts go where it is narrow."""
        parts, reasons = self._parts()
        least = sum(2 + min(cell_len(text), REASON_AT_LEAST) for text in reasons)
        while len(parts) > 1 and least + sum(2 + cell_len(t) for _, t in parts) > self.width:
            parts.remove(max(parts, key=lambda part: part[0]))
        shown = line(" " + "  ".join([*(text for _, text in parts), *reasons]), "reverse")
        shown.truncate(self.width, overflow="ellipsis", pad=True)
        return shown

    def _parts(self) -> tuple[list[tuple[int, str]], list[str]]:
        """What the first line says, each with its rank: the highest goes first; and the reasons."""
        plant, model, controller = self.state.plant, self.state.model, self.state.controller
        parts: list[tuple[int, str]] = [(0, self.view.title or "wyner")]
        if plant is None:
            parts.append((0, "waiting for the plant"))
        else:
            if model is not None:
                parts += [(5, drawn(model.scenario)), (4, f"pace {drawn(model.pace)}")]
                parts += [(7, f"alpha {number(model.alpha)}")]
            known = plant.phase in ("running", "refused")
            phase = plant.phase if known else in_words("plant", plant.phase)
            parts += [(8, f"session {plant.session[:8]}"), (2, phase)]
            if model is not None and model.seeded:
                parts.append((3, "SEEDED: no secret"))
            if plant.frames_refused:
                parts.append((2, f"{count(plant.frames_refused)} frames refused"))
            if plant.attack:
                parts.append((1, f"ATTACK: {drawn(plant.attack)}"))
        if controller is not None and controller.phase != "running":
            parts.append((1, in_words("controller", controller.phase)))
        if self.view.frozen:
            steps = self.view.held_steps
            parts.append((0, f"FROZEN, {'new session' if steps is None else f'{steps} steps on'}"))
        parts += [(1, f"{name} silent") for name in self._silent()]
        ends = (end for end in (plant, controller) if end is not None)
        return parts, [drawn(end.detail) for end in ends if end.detail]

    def _silent(self) -> list[str]:
        """Who is not heard any more, and has not said that it stops."""
        state, seen = self.state, {}
        if state.plant is not None and state.plant.phase != "stopped":
            seen["plant"] = state.plant_seen_ns
        if state.controller is not None and state.controller.phase != "stopped":
            seen["controller"] = state.controller_seen_ns
        if state.taps:
            seen["tap"] = max(tap.seen_ns for tap in state.taps.values())
        return [name for name, at in seen.items() if self.now_ns - at > SILENT_AFTER_NS]

    def footer(self) -> Text:
        """One line: how to go on, a note, or the keys."""
        view = self.view
        if view.note or view.caption:
            shown = line(f" {view.note or view.press}", "bold" if view.note else "reverse")
            shown.truncate(self.width, pad=not view.note)
            return shown
        keys = line()
        for key in keymap.KEYS:
            held = key.action is keymap.Action.FREEZE and view.frozen
            keys.append(f" {key.label} ", style="reverse")
            keys.append(f" {'go on' if held else key.short}  ")
        malformed = f"{count(self.state.malformed)} malformed" if self.state.malformed else ""
        heard = f"{count(self.state.received)} messages"
        whole = f"{heard}, {malformed}" if malformed else heard
        tail = longest(self.width - keys.cell_len - 2, whole, malformed)
        keys.append(tail.rjust(self.width - keys.cell_len - 1), style="dim")
        return keys

    def _top(self, rows: int, extra: int, *, picture: bool) -> RenderableType:
        """The loop, its keys and its last steps; the key test beside them."""
        left = 40 if self.width < 100 else min(54, self.width // 2 - 6)
        width = left if picture else self.width
        used, loop = self.loop(width, min(extra, MORE_LOOP))
        regions = [(used, loop), (4, self.keys(width))]
        if (rest := rows - used - 4) >= 4 and picture:
            regions.append((rest, self.last_steps(width, rest)))
        panels = _stacked(regions, rows)
        if not picture:
            return panels
        top = Layout()
        beside = Layout(Padding(panels, (0, 1, 0, 0)), size=left + 1)
        top.split_row(beside, Layout(self.picture(self.width - left - 1, rows)))
        return top

    def loop(self, width: int, extra: int) -> Region:
        """Step, state with history, rate and time left, missed steps."""
        plant, model = self.state.plant, self.state.model
        if plant is None:
            told = line(" no word from the plant yet")
            return 5, titled(rule("Control loop", width), told)
        wrong = f"wrong keys {count(plant.symbol_errors)}"
        notes = [wrong]
        if plant.sessions > 1:
            notes.insert(0, f"{wrong}  session {count(plant.sessions)}")
        style = STYLES["bad"] if plant.symbol_errors else ""
        step = f" step {plant.k}"
        pace = f"  {longest(7, f'{plant.rate_hz:.1f}', number(plant.rate_hz))} steps/s"
        time = ""
        if model is not None:
            seconds = f"  {plant.k * model.period_s:.1f} s"
            room = width - len(step) - len(pace)
            time = longest(room, f"{seconds} of plant time", seconds)
        states = self._states(plant.x, width, 2 + max(0, extra))
        body: list[RenderableType] = [line(step + time + pace), states]
        if extra > 0 or not self.state.alarms:  # an alarm is told however narrow it is
            body.append(self._carried(width))
        if extra > 0 or self.state.alarms:
            body.append(self._control(width))
        title = rule("Control loop", width, *notes, style=style)
        return len(body) + states.row_count, titled(title, *body)

    def _carried(self, width: int) -> Text:
        """What the link carries, and how many steps found no input in time."""
        plant = self.state.plant
        assert plant is not None
        rate, missed, style = f" message {rate_in_words(self.state)}", "", ""
        if plant.missed:
            short = f"  missed {count(plant.missed)}"
            steps = "step" if plant.missed == 1 else "steps"
            missed = longest(width - len(rate), f"{short} {steps}", short)
            if plant.missed * TOO_MANY > plant.transitions + plant.missed:
                style = STYLES["bad"]
        left = time_left_s(self.state)
        wait = "" if left is None else f"  whole in {duration(left)}"
        told = rate + longest(width - len(rate) - len(missed), wait)
        return Text.assemble(line(told), (missed, style), no_wrap=True)

    def _control(self, width: int) -> Text:
        """Where the state is among the controller's sets, or an alarm."""
        controller, alarms = self.state.controller, self.state.alarms
        if alarms:
            short = alarms.partition(": read")[0]
            told = longest(width, f" {alarms}", f" {short}", f" {short.partition(',')[0]}")
            return line(told, STYLES["bad"])
        if controller is None or controller.set_index < 0:
            return line(" control: outside of every set, or silent")
        if controller.set_index == 0:
            return line(" control: inside the target set")
        steps = f"{count(controller.set_index)} steps"
        told = f" control: at most {steps} to the target set"
        return line(longest(width, told, f" control: {steps} off"))

    def _states(self, x: Sequence[float], width: int, rows: int) -> Table:
        """Each component with its history: one to a row, or where rows are short more.

        Of an attacked plant the true one stands beside the one that is reported, in one scale.
        """
        state, attacked = self.state, bool(self.state.true_states)
        entries = len(x) * (1 + attacked)
        longer = len(" said") if attacked else 0
        per_row = max(1, min(-(-entries // rows), (width - 1) // (STATE_CELLS + longer)))
        each = (width - 1) // per_row
        bars = max(0, each - 14 - longer)
        cells: list[Text] = []
        for i, value in enumerate(x):
            shown, true = _history(state.states, i, bars), _history(state.true_states, i, bars)
            told = [(f"x{i + 1} said" if attacked else f"x{i + 1}", value, shown)]
            if attacked:
                told.append((f"x{i + 1} true", true[-1] if true else nan, true))
            for name, now, history in told:
                bar = sparkline(history, LEVELS, [*shown, *true])
                cells.append(line(f" {name} {component(now, '+'):>8}  {bar}"))
        room = per_row * rows
        if len(cells) > room:
            cells[room - 1 :] = [line(f" {len(cells) - room + 1} more")]
        grid = Table.grid()
        for _ in range(per_row):
            grid.add_column(width=each, no_wrap=True, overflow="crop")
        for i in range(0, len(cells), per_row):
            grid.add_row(*cells[i : i + per_row])
        for _ in range(min(2, rows) - grid.row_count):
            grid.add_row()
        return grid

    def keys(self, width: int) -> RenderableType:
        """Key symbols agreed, the strongest shown tap's guesses below them, and both automata."""
        plant, truths = self.state.plant, self.state.truths
        agreed = [k for k in sorted(truths) if truths[k].symbol >= 0]
        if self.taps:  # one that lags is compared at the last steps that she has a guess for
            guesses = self.taps[0][0].guesses
            agreed = [k for k in agreed if k in guesses] or agreed
        size = self.state.candidates
        wide = len(symbol_of(0, size))
        agreed = agreed[-(max(0, width - VALUE_AT) // wide) :]
        truth = "".join(symbol_of(truths[k].symbol, size) for k in agreed)
        total = plant.agreements if plant else 0
        rows: list[Row] = [(f"{count(total)} {'key' if total == 1 else 'keys'}", line(truth))]
        if not self.taps:
            return labelled([*rows, *_NOBODY, self.automata()])
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
        return labelled([*rows, (tap.status.name, guessed), (told, marks), self.automata()])

    def automata(self) -> Row:
        """What both ends are at, and whether they agree on it."""
        plant, controller, both = self.state.plant, self.state.controller, self.state.automata
        if both is not None and both.in_step:
            told = line(DOING[both.sender] + ", ")
            told.append("in step", style=STYLES["good"])
            return "both ends", told
        if both is not None:
            told = line().append("OUT OF STEP ", style=STYLES["bad"])
            told.append(f"controller {both.sender}, plant {both.receiver}")
            return "both ends", told
        sender = controller.automaton if controller else 0
        receiver = plant.automaton if plant else 0
        if not sender and not receiver:
            return "both ends", line("not heard yet")
        return "controller", line(f"{DOING[sender]}; plant: {DOING[receiver]}")

    def last_steps(self, width: int, rows: int) -> RenderableType:
        """What happened in the last transitions, the newest first, and what the tap made of it."""
        tap = self.taps[0][0] if self.taps else None
        whose: tuple[str, ...] = ()
        if tap is not None:
            says = "says, with her own odds"
            whose = (f"and what {drawn(tap.status.name)} {says}", f"and what Eve {says}")
        grid = Table.grid(padding=(0, 2, 0, 0))
        for _ in range(4):
            grid.add_column(no_wrap=True)
        for k in sorted(self.state.truths, reverse=True)[: rows - 1]:
            truth, hers = self.state.truths[k], line()
            what = "message" if truth.role == "message" else "no key"
            if truth.symbol >= 0:
                what = f"key {truth.symbol}"
            guess = tap.guesses.get(k) if tap is not None else None
            if guess is not None:
                wrong = truth.symbol >= 0 and guess.symbol != truth.symbol
                hers.append(f"Eve says {guess.symbol}, {guess.probability:.2f}")
                hers.append("  ^ wrong" if wrong else "", style=STYLES["bad"])
            grid.add_row(line(f"{k:<7}"), line(f"input {truth.coin}"), line(f"{what:<7}"), hers)
        return titled(rule("Last steps", width, *whose), Padding(grid, (0, 0, 0, 1)))

    def picture(self, width: int, rows: int) -> RenderableType:
        """The agreement test of the last pictured step, or of the one that a caption is about."""
        status = self.state.pictured
        if self.view.step is not None:
            status = self.state.pictures.get(self.view.step, status)
        return agreement(self.state.model, status, width, rows)

    def message(self, taps: int, *, bar: bool) -> RenderableType:
        """Sent, recovered and guessed, one below the other, wrong characters marked with ^."""
        state = self.state
        sent, recovered = letters(state.sent), letters(state.recovered)
        shown = [tap for tap, _ in self.taps if tap.status.key_bits_held < 0][:taps]
        start = self._start(sent, len(recovered))
        rows: list[Row] = [
            *([("on its way", self._under_way(len(sent), len(recovered)))] if bar else []),
            ("sent", line("".join(cell for _, cell in self._cells(sent, sent, start)))),
            ("plant has", self._marked(recovered, sent, start)[0]),
        ]
        for tap in shown:
            truth = letters(truth_for(state, tap.status.message))
            same = truth == sent
            hers = letters(tap.status.message)
            hers = hers[: len(truth)] if truth else hers  # noise goes on for pages
            guess, marks = self._marked(hers, truth, start if same else 0)
            rows.append((tap.status.name, guess))
            if tap.status.failed:
                rows.append(("FAILED", line(drawn(tap.status.failed), STYLES["bad"])))
                continue
            wrong = f"{marks.plain.count('^')} wrong" if hers else "no text yet"
            rows.append((wrong if same else f"{wrong}, old", marks))
        if not shown:
            rows += _NOBODY
        title = rule("Message", self.width, "what was sent, what the plant has, what Eve reads")
        return titled(title, labelled(rows))

    def _under_way(self, sent: int, recovered: int) -> RenderableType:
        """How much of the message the plant has, as a bar and in words."""
        its = self.state.controller
        told = [f"{recovered} of {sent} characters"]
        if its is not None:
            told.append(f"{told[-1]}, {its.frame_symbols} of {its.frame_length} symbols")
            told.append(f"{told[-1]}; messages delivered: {its.delivered}, waiting: {its.queue}")
        words = longest(self.width - VALUE_AT - BAR // 2 - 2, *reversed(told))
        room = min(BAR, max(5, self.width - VALUE_AT - 2 - len(words)))
        done = room * min(recovered, sent) // max(1, sent)
        bar = line(LEVELS[-1] * done, STYLES["good"])
        bar.append(FAINT * (room - done), STYLES["label"])
        return bar.append(f"  {words}", style="default")

    def _start(self, sent: Letters, grown: int) -> int:
        """The first character shown of a message that has grown so far."""
        room = self.width - VALUE_AT
        at = list(itertools.accumulate((cell_len(glyph(c)) for c in sent), initial=0))
        if at[-1] <= room:
            return 0
        wanted = at[min(grown, len(sent))] - room * 3 // 4
        return bisect_left(at, min(max(0, wanted), at[-1] - room))

    def _cells(self, text: Letters, truth: Letters, start: int) -> Iterator[tuple[int, str]]:
        """The characters that there is room for, each as wide as the true one in its place."""
        room = self.width - VALUE_AT
        for i in range(start, len(text)):
            shown = glyph(text[i])
            width = cell_len(glyph(truth[i]) if i < len(truth) else shown)
            room -= width
            if room < 0:
                break
            yield i, set_cell_size(shown if cell_len(shown) <= width else "·", width)

    def _marked(self, text: Letters, truth: Letters, start: int) -> tuple[Text, Text]:
        shown, marks = line(), line()
        for i, cell in self._cells(text, truth, start):
            right = i < len(truth) and text[i] == truth[i]
            shown.append(cell, style=STYLES["good" if right else "wrong"])
            marks.append(("" if right else "^").ljust(cell_len(cell)), style=STYLES["bad"])
        return shown, marks

    def help(self) -> list[Region]:
        """The keys from their table, then how to read the screen."""
        keys = labelled((key.label, line(key.meaning)) for key in keymap.KEYS)
        reading = Padding(Group(*map(line, HELP)), (0, 0, 0, 1))
        return [
            (len(keymap.KEYS) + 2, Panel(keys, title="Keys", title_align="left", padding=0)),
            (len(HELP) + 1, titled(rule("How to read it", self.width), reading)),
        ]


def _indent(text: str) -> str:
    """What a line goes on below: its text where it has a label."""
    label = _LABEL.match(text)
    return " " * (len(label[0]) if label else 3)


def _history(states: Mapping[int, Sequence[float]], i: int, bars: int) -> list[float]:
    """The last values of component ``i``, for so many bars: one at least."""
    return [states[k][i] for k in sorted(states) if i < len(states[k])][-max(1, bars) :]
