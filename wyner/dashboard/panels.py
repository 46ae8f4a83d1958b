"""The panels of the screen, each a function of the board to lines of a given width."""

import itertools
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Final

from rich.cells import cell_len, set_cell_size
from rich.text import Text

from protocol.messages import PlantStatus
from wyner.dashboard.model import Board, TapBoard
from wyner.dashboard.picture import agreement
from wyner.dashboard.score import (
    Score,
    SecrecyScore,
    ranked,
    rate_in_words,
    secrecy,
    time_left_s,
    truth_for,
)
from wyner.dashboard.text import (
    ASCII,
    LABEL,
    STYLES,
    UNICODE,
    component,
    count,
    drawn,
    duration,
    glyph,
    letters,
    longest,
    number,
    row,
    rule,
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


@dataclass(frozen=True, slots=True)
class ViewState:
    """What the user asked of the view, and what the terminal can show.

    ``held_steps`` counts the steps made since the view was frozen, None when another session began
    meanwhile; ``typing`` is set while the filter is being typed; ``note`` stands in the last line
    instead of the keys. ``step`` and ``tap`` are what was chosen, ``detail`` asks for all about
    them. ``caption`` is a title and its lines: a pause of the story, or the end of the run,
    and ``press`` says how to go on.
    """

    frozen: bool = False
    held_steps: int | None = 0
    help: bool = False
    filter: str = ""
    typing: bool = False
    step: int | None = None
    tap: str = ""
    detail: bool = False
    title: str = ""
    caption: tuple[str, ...] = ()
    press: str = ""
    note: str = ""
    unicode: bool = True


class Panels:
    """The panels that one screen is put together from."""

    def __init__(self, board: Board, width: int, wishes: ViewState, now_ns: int) -> None:
        self.board = board
        self.width = width
        self.wishes = wishes
        self.now_ns = now_ns
        self.glyphs = UNICODE if wishes.unicode else ASCII
        self.taps = ranked(board)
        self.secrecy: SecrecyScore = secrecy(board, self.taps)

    def rule(self, title: str, width: int, *notes: str) -> Text:
        """A titled rule, with the longest of the notes that there is room for."""
        return rule(self.glyphs, title, width, *notes)

    def loop(self, width: int, extra: int) -> list[Text]:
        """Step, state with history, rate and time left, missed and late steps."""
        plant, model = self.board.plant, self.board.model
        lines = [self.rule("Loop", width)]
        if plant is None:
            return [*lines, Text(" no word from the plant yet"), Text(), Text(), Text()]
        step = f" step {plant.k}"
        pace = f"  {longest(7, f'{plant.rate_hz:.1f}', number(plant.rate_hz))} steps/s"
        room = width - len(step) - len(pace)
        time = ""
        if model is not None:
            seconds = plant.k * model.period_s
            time = longest(room, f"  {seconds:.1f} s of plant time", f"  {seconds:.1f} s")
        lines.append(Text(step + time + pace))
        lines += self._states(plant.x, width, 2 + max(0, extra))
        lines.append(self._carried(width))
        if extra > 0:
            lines.append(self._trouble(plant, width))
        if extra > 1:
            lines.append(self._control(width))
        return lines

    def _carried(self, width: int) -> Text:
        """What the link carries, and how long the message on its way still takes."""
        rate = f" {rate_in_words(self.board)}"
        left = time_left_s(self.board)
        missed = self._missed_short()
        room = width - len(rate) - len(missed)
        wait = "" if left is None else f"  message whole in {duration(left)}"
        short = "" if left is None else f"  {duration(left)} to go"
        return Text.assemble(rate, longest(room, wait, short), (missed, self._missed_style()))

    def _missed_short(self) -> str:
        plant = self.board.plant
        assert plant is not None
        return f"  missed {count(plant.missed)}" if plant.missed else ""

    def _missed_style(self) -> str:
        """Red from one step in twenty on: a few are what a busy machine makes."""
        plant = self.board.plant
        assert plant is not None
        steps = plant.transitions + plant.missed
        return STYLES["bad"] if plant.missed * TOO_MANY > steps else ""

    def _trouble(self, plant: PlantStatus, width: int) -> Text:
        wrong = f"wrong keys at the plant {count(plant.symbol_errors)}"
        late = f"late {count(plant.late)}"
        session = f"session {count(plant.sessions)}"
        style = STYLES["bad"] if plant.symbol_errors else ""
        told = longest(width, f" {wrong}  {late}  {session}", f" {wrong}  {late}", f" {wrong}")
        return Text(told, style=style)

    def _control(self, width: int) -> Text:
        """Where the state is, among the controller's sets."""
        controller = self.board.controller
        if controller is not None and controller.alarms:
            alarms = controller.alarm_sentence()
            told = longest(width, f" {alarms}", f" {alarms.rpartition(': read')[0]}")
            return Text(told, style=STYLES["bad"])
        if controller is None or controller.set_index < 0:
            return Text(" control: outside of every set, or silent")
        at = controller.set_index
        if at == 0:
            return Text(" control: inside the target set")
        told = longest(
            width,
            f" control: at most {count(at)} steps to the target set",
            f" control: {count(at)} steps off",
        )
        return Text(told)

    def _states(self, x: Sequence[float], width: int, rows: int) -> list[Text]:
        """Each component with its history: one to a row, or where rows are short more.

        Of an attacked plant the true one, t, stands beside the one that is reported, in one scale.
        """
        board, attacked = self.board, bool(self.board.true_states)
        entries = len(x) * (1 + attacked)
        per_row = max(1, min(-(-entries // rows), (width - 1) // STATE_CELLS))
        each = (width - 1) // per_row
        bars = max(0, each - 14)
        cells: list[str] = []
        for i, value in enumerate(x):
            shown, true = _history(board.states, i, bars), _history(board.true_states, i, bars)
            told = [(f"x{i + 1}", value, shown)]
            if attacked:
                told.append((f"t{i + 1}", true[-1] if true else nan, true))
            for name, now, history in told:
                bar = sparkline(history, self.glyphs.levels, [*shown, *true])
                cells.append(f" {name} {component(now, '+'):>8}  {bar}"[:each].ljust(each))
        room = per_row * rows
        if len(cells) > room:
            cells[room - 1 :] = [f" {len(cells) - room + 1} more"]
        lines = [Text("".join(cells[i : i + per_row])) for i in range(0, len(cells), per_row)]
        return lines + [Text()] * (min(2, rows) - len(lines))

    def keys(self, width: int) -> list[Text]:
        """Key symbols agreed, the strongest shown tap's guesses below them, and both automata."""
        plant = self.board.plant
        room = max(0, width - LABEL - 2)
        agreed = [k for k in sorted(self.board.truths) if self.board.truths[k].symbol >= 0]
        shown = self.filtered()
        if shown:
            # A tap that lags is compared at the last steps that she has a guess for.
            guesses = shown[0][0].guesses
            agreed = [k for k in agreed if k in guesses] or agreed
        size = self.board.candidates
        wide = len(symbol_of(0, size))
        agreed = agreed[-(room // wide) :]
        truth = "".join(symbol_of(self.board.truths[k].symbol, size) for k in agreed)
        total = plant.agreements if plant else 0
        lines = [row(f"{count(total)} keys", Text(truth))]
        if shown:
            tap = shown[0][0]
            guessed, marks = Text(), Text()
            heard = any(k in tap.guesses for k in agreed)
            for k in agreed:
                guess = tap.guesses.get(k)
                if guess is None:
                    guessed.append(" " * wide)
                    marks.append(" " * wide)
                    continue
                right = guess.symbol == self.board.truths[k].symbol
                said = symbol_of(guess.symbol, size)
                guessed.append(said, style=STYLES["" if right else "wrong"])
                marks.append((" " if right else "^").ljust(wide), style=STYLES["bad"])
            lines += [
                row(tap.status.name, guessed),
                row(f"{marks.plain.count('^')} wrong" if heard else "no guess yet", marks),
            ]
        else:
            lines += self._nobody()
        lines += self.automata()
        return lines

    def last_steps(self, width: int, rows: int) -> list[Text]:
        """What happened in the last transitions, the newest first, and what the tap made of it."""
        lines = [self.rule("Last steps", width)]
        tap = self.filtered()[0][0] if self.filtered() else None
        for k in sorted(self.board.truths, reverse=True)[: rows - 1]:
            truth = self.board.truths[k]
            what = "message" if truth.role == "message" else "no key"
            if truth.symbol >= 0:
                what = f"key {truth.symbol}"
            line = Text(f" {k:<7} input {truth.coin}  {what:<7} ")
            guess = tap.guesses.get(k) if tap is not None else None
            if guess is not None:
                wrong = truth.symbol >= 0 and guess.symbol != truth.symbol
                line.append(f" she says {guess.symbol}, {guess.probability:.2f}")
                line.append("  ^ wrong" if wrong else "", style=STYLES["bad"])
            lines.append(line)
        return lines

    def automata(self) -> list[Text]:
        """What both ends are at, and whether they agree on it."""
        plant, controller, both = self.board.plant, self.board.controller, self.board.automata
        if both is not None and both.in_step:
            line = row("both ends", Text(DOING[both.sender] + ", "))
            line.append("in step", style=STYLES["good"])
            return [line]
        sender = both.sender if both else controller.automaton if controller else 0
        receiver = both.receiver if both else plant.automaton if plant else 0
        if both is not None:
            line = row("both ends", Text("OUT OF STEP ", style=STYLES["bad"]))
            line.append(f"controller {sender}, plant {receiver}")
            return [line]
        if not sender and not receiver:
            return [row("both ends", Text("not heard yet"))]
        return [row("controller", Text(f"{DOING[sender]}; plant: {DOING[receiver]}"))]

    def picture(self, width: int, rows: int) -> list[Text]:
        """The agreement test of the last pictured step, or of the one chosen while frozen."""
        status = self.board.pictured
        if self.wishes.step is not None:
            status = self.board.pictures.get(self.wishes.step, status)
        return agreement(
            self.board.model, status, width, rows, self.glyphs, unicode=self.wishes.unicode
        )

    def message(self, taps: int) -> list[Text]:
        """Sent, recovered and guessed, one below the other, wrong characters marked with ^."""
        board = self.board
        sent, recovered = letters(board.sent), letters(board.recovered)
        shown = [tap for tap, _ in self.filtered() if tap.status.key_bits_held < 0][:taps]
        start = self._start(sent, len(recovered))
        notes = [f"{len(recovered)} of {len(sent)} characters"]
        if board.controller is not None:
            its = board.controller
            notes.insert(0, f"{notes[0]}, {its.frame_symbols} of {its.frame_length} symbols")
            done = f"{its.delivered} delivered, {its.queue} queued"
            notes[:0] = [f"{notes[0]}, {done}", f"{notes[1]}, {done}"]
        lines = [self.rule("Message", self.width, *notes)]
        lines.append(row("sent", Text("".join(cell for _, cell in self._cells(sent, sent, start)))))
        lines.append(row("recovered", self._marked(recovered, sent, start)[0]))
        for tap in shown:
            truth = letters(truth_for(board, tap.status.message))
            same = truth == sent
            hers = letters(tap.status.message)
            hers = hers[: len(truth)] if truth else hers  # noise goes on for pages
            guess, marks = self._marked(hers, truth, start if same else 0)
            lines.append(row(tap.status.name, guess))
            if tap.status.failed:
                lines.append(row("FAILED", Text(drawn(tap.status.failed), style=STYLES["bad"])))
                continue
            wrong = f"{marks.plain.count('^')} wrong" if hers else "no text yet"
            lines.append(row(wrong if same else f"{wrong}, old", marks))
        if not shown:
            lines += self._nobody()
        return lines

    def _start(self, sent: Letters, grown: int) -> int:
        """The first character shown of a message that has grown so far."""
        room = self.width - LABEL - 2
        at = list(itertools.accumulate((cell_len(glyph(c)) for c in sent), initial=0))
        if at[-1] <= room:
            return 0
        wanted = at[min(grown, len(sent))] - room * 3 // 4
        return bisect_left(at, min(max(0, wanted), at[-1] - room))

    def _cells(self, text: Letters, truth: Letters, start: int) -> Iterator[tuple[int, str]]:
        """The characters that there is room for, each as wide as the true one in its place."""
        room = self.width - LABEL - 2
        for i in range(start, len(text)):
            shown = glyph(text[i])
            width = cell_len(glyph(truth[i]) if i < len(truth) else shown)
            room -= width
            if room < 0:
                break
            yield i, set_cell_size(shown if cell_len(shown) <= width else "·", width)

    def _marked(self, text: Letters, truth: Letters, start: int) -> tuple[Text, Text]:
        shown, marks = Text(), Text()
        for i, cell in self._cells(text, truth, start):
            right = i < len(truth) and text[i] == truth[i]
            shown.append(cell, style=STYLES["good" if right else "wrong"])
            marks.append(("" if right else "^").ljust(cell_len(cell)), style=STYLES["bad"])
        return shown, marks

    def _nobody(self) -> list[Text]:
        """Two lines in place of a tap."""
        why = "none by that name" if self.taps else "no tap heard"
        return [Text(f" {why}", style=STYLES["label"]), Text()]

    def filtered(self) -> list[tuple[TapBoard, Score]]:
        """The taps that the filter lets through, strongest first."""
        wanted = self.wishes.filter.lower()
        return [pair for pair in self.taps if wanted in pair[0].status.name.lower()]


def _history(states: Mapping[int, Sequence[float]], i: int, bars: int) -> list[float]:
    """The last values of component ``i``, for so many bars: one at least."""
    return [states[k][i] for k in sorted(states) if i < len(states[k])][-max(1, bars) :]
