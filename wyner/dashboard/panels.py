"""The panels of the screen, each a function of the state to a renderable of rich's."""

import itertools
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Final

from rich.cells import cell_len, set_cell_size
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from wyner.dashboard.model import State
from wyner.dashboard.parts import VALUE_AT, Row, labelled, line, rule, titled
from wyner.dashboard.picture import agreement
from wyner.dashboard.score import (
    SecrecyScore,
    ranked,
    rate_in_words,
    secrecy,
    time_left_s,
    truth_for,
)
from wyner.dashboard.text import (
    FAINT,
    LEVELS,
    STYLES,
    component,
    count,
    drawn,
    duration,
    glyph,
    letters,
    longest,
    number,
    sparkline,
    symbol_of,
)

Letters = tuple[str, ...]

DOING: Final = ("-", "wait for a key", "use the key")
"""What an end is at, by the state of its automaton; 0 is not known."""

TOO_MANY: Final = 20
"""One missed step in so many is shown as trouble."""

STATE_CELLS: Final = 13
"""Cells of a component of the state with its name, its history aside."""

BAR: Final = 30
"""Cells of the bar of a message on its way."""


@dataclass(frozen=True, slots=True)
class ViewState:
    """What the user asked of the view, of its size.

    ``held_steps`` counts the steps made since the view was frozen, None when another session began
    meanwhile; ``note`` stands in the last line instead of the keys; ``step`` is the one that was
    chosen. ``caption`` is a title and its lines: a pause of the story, or the end of the run,
    and ``press`` says how to go on.
    """

    frozen: bool = False
    held_steps: int | None = 0
    help: bool = False
    step: int | None = None
    title: str = ""
    caption: tuple[str, ...] = ()
    press: str = ""
    note: str = ""


class Panels:
    """The panels that one screen is put together from."""

    def __init__(self, state: State, width: int, view: ViewState, now_ns: int) -> None:
        self.state = state
        self.width = width
        self.view = view
        self.now_ns = now_ns
        self.taps = ranked(state)
        self.secrecy: SecrecyScore = secrecy(state, self.taps)

    def loop(self, width: int, extra: int) -> tuple[int, RenderableType]:
        """Step, state with history, rate and time left, missed steps; how many rows."""
        plant, model = self.state.plant, self.state.model
        title = rule("Control loop", width, *self._trouble(), style=self._trouble_style())
        if plant is None:
            return 5, titled(title, line(" no word from the plant yet"))
        step = f" step {plant.k}"
        pace = f"  {longest(7, f'{plant.rate_hz:.1f}', number(plant.rate_hz))} steps/s"
        room = width - len(step) - len(pace)
        time = ""
        if model is not None:
            seconds = plant.k * model.period_s
            time = longest(room, f"  {seconds:.1f} s of plant time", f"  {seconds:.1f} s")
        body: list[RenderableType] = [line(step + time + pace)]
        states = self._states(plant.x, width, 2 + max(0, extra))
        body.append(states)
        if extra > 0 or not self.state.alarms:  # an alarm is told however narrow it is
            body.append(self._carried(width))
        if extra > 0 or self.state.alarms:
            body.append(self._control(width))
        return len(body) + states.row_count, titled(title, *body)

    def _carried(self, width: int) -> Text:
        """What the link carries, and how many steps found no input in time."""
        rate = f" message {rate_in_words(self.state)}"
        missed = self._missed_short(width - len(rate))
        left = time_left_s(self.state)
        room = width - len(rate) - len(missed)
        wait = "" if left is None else f"  whole in {duration(left)}"
        return Text.assemble(
            line(rate + longest(room, wait)), (missed, self._missed_style()), no_wrap=True
        )

    def _missed_short(self, room: int) -> str:
        plant = self.state.plant
        assert plant is not None
        short = f"  missed {count(plant.missed)}"
        steps = "step" if plant.missed == 1 else "steps"
        return longest(room, f"{short} {steps}", short) if plant.missed else ""

    def _missed_style(self) -> str:
        """Red from one step in twenty on: a few are what a busy machine makes."""
        plant = self.state.plant
        assert plant is not None
        steps = plant.transitions + plant.missed
        return STYLES["bad"] if plant.missed * TOO_MANY > steps else ""

    def _trouble(self) -> tuple[str, ...]:
        """Keys that the two ends do not share, and which session it is, in words of any length."""
        plant = self.state.plant
        if plant is None:
            return ()
        wrong = f"wrong keys {count(plant.symbol_errors)}"
        if plant.sessions < 2:
            return (wrong,)
        return f"{wrong}  session {count(plant.sessions)}", wrong

    def _trouble_style(self) -> str:
        plant = self.state.plant
        return STYLES["bad"] if plant is not None and plant.symbol_errors else ""

    def _control(self, width: int) -> Text:
        """Where the state is, among the controller's sets."""
        controller, alarms = self.state.controller, self.state.alarms
        if alarms:
            short = alarms.partition(": read")[0]
            told = longest(width, f" {alarms}", f" {short}", f" {short.partition(',')[0]}")
            return line(told, STYLES["bad"])
        if controller is None or controller.set_index < 0:
            return line(" control: outside of every set, or silent")
        at = controller.set_index
        if at == 0:
            return line(" control: inside the target set")
        told = longest(
            width,
            f" control: at most {count(at)} steps to the target set",
            f" control: {count(at)} steps off",
        )
        return line(told)

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
        plant = self.state.plant
        room = max(0, width - VALUE_AT)
        agreed = [k for k in sorted(self.state.truths) if self.state.truths[k].symbol >= 0]
        if self.taps:
            # A tap that lags is compared at the last steps that she has a guess for.
            guesses = self.taps[0][0].guesses
            agreed = [k for k in agreed if k in guesses] or agreed
        size = self.state.candidates
        wide = len(symbol_of(0, size))
        agreed = agreed[-(room // wide) :]
        truth = "".join(symbol_of(self.state.truths[k].symbol, size) for k in agreed)
        total = plant.agreements if plant else 0
        rows: list[Row] = [(f"{count(total)} {'key' if total == 1 else 'keys'}", line(truth))]
        if self.taps:
            tap = self.taps[0][0]
            guessed, marks = line(), line()
            heard = any(k in tap.guesses for k in agreed)
            for k in agreed:
                guess = tap.guesses.get(k)
                if guess is None:
                    guessed.append(" " * wide)
                    marks.append(" " * wide)
                    continue
                right = guess.symbol == self.state.truths[k].symbol
                said = symbol_of(guess.symbol, size)
                guessed.append(said, style=STYLES["" if right else "wrong"])
                marks.append((" " if right else "^").ljust(wide), style=STYLES["bad"])
            wrong = f"{marks.plain.count('^')} wrong" if heard else "no guess yet"
            rows += [(tap.status.name, guessed), (wrong, marks)]
        else:
            rows += _NOBODY
        return labelled([*rows, self.automata()])

    def last_steps(self, width: int, rows: int) -> RenderableType:
        """What happened in the last transitions, the newest first, and what the tap made of it."""
        tap = self.taps[0][0] if self.taps else None
        whose: tuple[str, ...] = ()
        if tap is not None:
            says = "says, with her own odds"
            whose = (f"and what {drawn(tap.status.name)} {says}", f"and what she {says}")
        grid = Table.grid(padding=(0, 2, 0, 0))
        for _ in range(4):
            grid.add_column(no_wrap=True)
        for k in sorted(self.state.truths, reverse=True)[: rows - 1]:
            truth = self.state.truths[k]
            what = "message" if truth.role == "message" else "no key"
            if truth.symbol >= 0:
                what = f"key {truth.symbol}"
            hers = line()
            guess = tap.guesses.get(k) if tap is not None else None
            if guess is not None:
                wrong = truth.symbol >= 0 and guess.symbol != truth.symbol
                hers.append(f"she says {guess.symbol}, {guess.probability:.2f}")
                hers.append("  ^ wrong" if wrong else "", style=STYLES["bad"])
            grid.add_row(line(f"{k:<7}"), line(f"input {truth.coin}"), line(f"{what:<7}"), hers)
        return titled(rule("Last steps", width, *whose), Padding(grid, (0, 0, 0, 1)))

    def automata(self) -> Row:
        """What both ends are at, and whether they agree on it."""
        plant, controller, both = self.state.plant, self.state.controller, self.state.automata
        if both is not None and both.in_step:
            told = line(DOING[both.sender] + ", ")
            told.append("in step", style=STYLES["good"])
            return "both ends", told
        sender = both.sender if both else controller.automaton if controller else 0
        receiver = both.receiver if both else plant.automaton if plant else 0
        if both is not None:
            told = line().append("OUT OF STEP ", style=STYLES["bad"])
            told.append(f"controller {sender}, plant {receiver}")
            return "both ends", told
        if not sender and not receiver:
            return "both ends", line("not heard yet")
        return "controller", line(f"{DOING[sender]}; plant: {DOING[receiver]}")

    def picture(self, width: int, rows: int) -> RenderableType:
        """The agreement test of the last pictured step, or of the one chosen while frozen."""
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
        title = rule("Message", self.width, "what was sent, what the plant has, what she reads")
        return titled(title, labelled(rows))

    def _under_way(self, sent: int, recovered: int) -> RenderableType:
        """How much of the message the plant has, as a bar and in words."""
        its = self.state.controller
        told = [f"{recovered} of {sent} characters"]
        if its is not None:
            told.append(f"{told[-1]}, {its.frame_symbols} of {its.frame_length} symbols")
            told.append(f"{told[-1]}; messages delivered: {its.delivered}, waiting: {its.queue}")
        words = longest(self.width - VALUE_AT - BAR // 2 - 2, *reversed(told))
        grid = Table.grid(padding=(0, 2, 0, 0))
        room = min(BAR, max(5, self.width - VALUE_AT - 2 - len(words)))
        grid.add_column(width=room)
        grid.add_column(no_wrap=True)
        done = room * min(recovered, sent) // max(1, sent)
        bar = line(LEVELS[-1] * done, STYLES["good"])
        bar.append(FAINT * (room - done), STYLES["label"])
        grid.add_row(bar, line(words))
        return grid

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


_NOBODY: Final[list[Row]] = [("no tap heard", line()), ("", line())]
"""Two rows in place of a tap's."""


def _history(states: Mapping[int, Sequence[float]], i: int, bars: int) -> list[float]:
    """The last values of component ``i``, for so many bars: one at least."""
    return [states[k][i] for k in sorted(states) if i < len(states[k])][-max(1, bars) :]
