"""The panels of the screen, each a function of the board to lines of a given width."""

import itertools
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from rich.cells import cell_len, set_cell_size
from rich.text import Text

from wyner.dashboard import plane
from wyner.dashboard.model import Board, TapView
from wyner.dashboard.score import Score, Secrecy, ranked, secrecy, truth_for
from wyner.dashboard.text import (
    ASCII,
    LABEL,
    STYLES,
    UNICODE,
    component,
    count,
    fit,
    glyph,
    letters,
    longest,
    number,
    row,
    sparkline,
)

Letters = tuple[str, ...]

STATE_CELLS: Final = 13
"""Cells of a component of the state with its name, its history aside."""


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the user asked of the view, and what the terminal can show.

    ``held_steps`` counts the steps made since the view was frozen, None when another session began
    meanwhile; ``typing`` is set while the filter is being typed; ``note`` stands in the last line
    instead of the keys.
    """

    frozen: bool = False
    held_steps: int | None = 0
    help: bool = False
    filter: str = ""
    typing: bool = False
    note: str = ""
    unicode: bool = True


class Panels:
    """The panels that one screen is put together from."""

    def __init__(self, board: Board, width: int, wishes: Wishes, now_ns: int) -> None:
        self.board = board
        self.width = width
        self.wishes = wishes
        self.now_ns = now_ns
        self.glyphs = UNICODE if wishes.unicode else ASCII
        self.taps = ranked(board)
        self.secrecy: Secrecy = secrecy(board, self.taps)

    def rule(self, title: str, width: int, *notes: str) -> Text:
        """A titled rule, with the longest of the notes that there is room for."""
        line = Text()
        line.append(self.glyphs.rule * 2 + " ", style=STYLES["rule"])
        line.append(title, style=STYLES["title"])
        line.append(" ")
        note = longest(width - cell_len(line.plain) - 1, *notes)
        if note:
            line.append(note + " ")
        line.append(self.glyphs.rule * max(0, width - cell_len(line.plain)), style=STYLES["rule"])
        return fit(line, width)

    def loop(self, width: int, extra: int) -> list[Text]:
        """Step, state with history, set index, missed and late steps."""
        plant, controller = self.board.plant, self.board.controller
        lines = [self.rule("Loop", width)]
        if plant is None:
            return [*lines, Text(" no word from the plant yet"), Text(), Text(), Text()]
        seconds = plant.k * plant.period_s
        step = f" step k {plant.k}"
        time = longest(width - len(step), f"   {seconds:.1f} s of plant time", f"  {seconds:.1f} s")
        lines.append(Text(step + time))
        states = [self.board.states[k] for k in sorted(self.board.states)]
        lines += self._states(plant.x, states, width, 2 + max(0, extra))
        trouble = Text("  missed ")
        trouble.append(count(plant.missed), style=STYLES["bad"] if plant.missed else "")
        trouble.append("  late ")
        trouble.append(count(plant.late), style=STYLES["bad"] if plant.late else "")
        index = ""
        if controller is not None:
            at, horizon = count(controller.set_index), count(controller.horizon)
            index = longest(
                width - trouble.cell_len,
                f" set i(k) {at} of {horizon}",
                f" set i(k) {at}",
                f" i(k) {at}",
            )
        lines.append(Text.assemble(index, trouble))
        if extra > 0:
            errors = f"unlike b_r {count(plant.symbol_errors)}"
            session = f"session {count(plant.sessions)}"
            rate = number(plant.rate_hz)
            line = longest(
                width,
                f" {plant.rate_hz:.1f} steps/s  {session}  {errors}",
                f" {rate} steps/s  {session}  {errors}",
                f" {rate}/s  {session}  {errors}",
                f" {rate}/s  {errors}",
            )
            lines.append(Text(line))
        return lines

    def _states(
        self, x: Sequence[float], states: Sequence[Sequence[float]], width: int, rows: int
    ) -> list[Text]:
        """Each component with its history: one to a row, or where rows are short more."""
        per_row = max(1, min(-(-len(x) // rows), (width - 1) // STATE_CELLS))
        each = (width - 1) // per_row
        bars = max(0, each - 14)
        room = per_row * rows
        cells = []
        for i, value in enumerate(x):
            if i == room - 1 < len(x) - 1:
                cells.append(f" {len(x) - i} more")
                break
            history = [state[i] for state in states if i < len(state)][-bars:] if bars else []
            bar = sparkline(history, self.glyphs.levels)
            cells.append(f" x{i + 1} {component(value, '+'):>8}  {bar}"[:each].ljust(each))
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
        agreed = agreed[-room:]
        truth = "".join(str(self.board.truths[k].symbol % 10) for k in agreed)
        total = plant.agreements if plant else 0
        lines = [row(f"{count(total)} keys", Text(truth))]
        if shown:
            tap = shown[0][0]
            guessed, marks = Text(), Text()
            for k in agreed:
                guess = tap.guesses.get(k)
                if guess is None:
                    guessed.append(" ")
                    marks.append(" ")
                    continue
                right = guess.symbol == self.board.truths[k].symbol
                guessed.append(str(guess.symbol % 10), style=STYLES["" if right else "wrong"])
                marks.append(" " if right else "^", style=STYLES["bad"])
            lines += [
                row(tap.status.name, guessed),
                row(f"{marks.plain.count('^')} wrong", marks),
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
            what = f"key {truth.symbol}" if truth.symbol >= 0 else "no key"
            if truth.role == "message":
                what = "m[p]"
            line = Text(f" k {k:<7} b_r {truth.coin}  {what:<7}")
            guess = tap.guesses.get(k) if tap is not None else None
            if guess is not None:
                wrong = truth.symbol >= 0 and guess.symbol != truth.symbol
                line.append(f" tap says {guess.symbol}, {guess.probability:.2f}")
                line.append("  ^ wrong" if wrong else "", style=STYLES["bad"])
            lines.append(line)
        return lines

    def automata(self) -> list[Text]:
        """The states of sender and receiver, what they mean, and whether they are in step."""
        plant, controller, both = self.board.plant, self.board.controller, self.board.automata
        s = both.sender if both else controller.automaton if controller else 0
        sender = ("-", "1 random symbol", "2 m[p] under key")[s]
        s = both.receiver if both else plant.automaton if plant else 0
        line = Text(f" receiver {('-', '1 tests for a key', '2 takes m[p]')[s]}")
        if both is not None:
            line.append("  ")
            line.append(
                "in step" if both.in_step else "OUT OF STEP",
                style=STYLES["good" if both.in_step else "bad"],
            )
        return [Text(f" sender   {sender}"), line]

    def picture(self, width: int, rows: int) -> list[Text]:
        """Figure 4 for the last pictured step, with the verdict in words."""
        plant = self.board.pictured
        if plant is None:
            lines = [self.rule("Agreement", width), Text(" no step pictured yet")]
            return [fit(line, width) for line in lines + [Text()] * (rows - len(lines))]
        axes = plane.axes_of(plant.B, plant.defender_H, plant.defender_h)
        lines = [self.rule(f"Agreement at k {plant.pictured_k}", width, axes.words, axes.short)]
        inner = rows - 3
        cells = plane.draw(plant, width - 2, inner, unicode=self.wishes.unicode)
        for cell_row in cells:
            line = Text(" ")
            for kind, run in itertools.groupby(cell_row, key=lambda cell: cell.kind):
                line.append("".join(cell.character for cell in run), style=STYLES[kind])
            lines.append(line)
        agreed = plant.pictured_symbol >= 0
        lines.append(Text(f" {plane.verdict(plant)}", style=STYLES["good"] if agreed else ""))
        gauges = "  ".join(
            f"g{i} {longest(6, f'{g:.2f}', number(g))}" for i, g in enumerate(plant.pictured_gauges)
        )
        edges = f"  (D_c 1, D_e {number(plant.alpha)})"
        lines.append(Text(f" {gauges}" + longest(width - len(gauges) - 1, edges)))
        return [fit(line, width) for line in lines]

    def message(self, taps: int) -> list[Text]:
        """Sent, recovered and guessed, one below the other, wrong characters marked with ^."""
        board = self.board
        sent, recovered = letters(board.sent), letters(board.recovered)
        shown = [tap for tap, _ in self.filtered()[:taps]]
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
            guess, marks = self._marked(letters(tap.status.message), truth, start if same else 0)
            lines.append(row(tap.status.name, guess))
            wrong = f"{marks.plain.count('^')} wrong"
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

    def filtered(self) -> list[tuple[TapView, Score]]:
        """The taps that the filter lets through, strongest first."""
        wanted = self.wishes.filter.lower()
        return [pair for pair in self.taps if wanted in pair[0].status.name.lower()]
