"""The panels of the screen, each a function of the board to lines of a given width."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from rich.cells import cell_len
from rich.text import Text

from dashboard import plane
from dashboard.model import Board, TapView
from dashboard.score import Score, Secrecy, ranked, secrecy, truth_for
from dashboard.text import (
    ASCII,
    LABEL,
    STYLES,
    UNICODE,
    count,
    fit,
    longest,
    number,
    printable,
    row,
    sparkline,
)


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the user asked of the view, and what the terminal can show.

    ``held_steps`` counts the steps made since the view was frozen; ``typing`` is set while the
    filter is being typed; ``note`` stands in the last line instead of the keys.
    """

    frozen: bool = False
    held_steps: int = 0
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
        lines.append(Text(f" step k {plant.k}   {seconds:.1f} s of plant time"))
        states = [self.board.states[k] for k in sorted(self.board.states)]
        lines += self._states(plant.x, states, width, 2 + max(0, extra))
        index = f" set i(k) {controller.set_index} of {controller.horizon}" if controller else ""
        line = Text(index)
        line.append("  missed ")
        line.append(str(plant.missed), style=STYLES["bad"] if plant.missed else "")
        line.append("  late ")
        line.append(str(plant.late), style=STYLES["bad"] if plant.late else "")
        lines.append(line)
        if extra > 0:
            errors = f" {plant.rate_hz:.1f} steps/s  session {plant.sessions}"
            lines.append(Text(f"{errors}  unlike b_r {plant.symbol_errors}"))
        return lines

    def _states(
        self, x: Sequence[float], states: Sequence[Sequence[float]], width: int, rows: int
    ) -> list[Text]:
        """Each component with its history: one to a row, or where rows are short two."""
        per_row = 1 if len(x) <= rows else -(-len(x) // rows)
        each = (width - 1) // per_row
        bars = max(0, each - 14)
        cells = []
        for i, value in enumerate(x):
            history = [state[i] for state in states if i < len(state)][-bars:] if bars else []
            bar = sparkline(history, self.glyphs.levels)
            cells.append(f" x{i + 1} {value:+8.3f}  {bar}".ljust(each)[:each])
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
            lines += [row("no tap heard", Text()), Text()]
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
        gauges = "  ".join(f"g{i} {g:.2f}" for i, g in enumerate(plant.pictured_gauges))
        lines.append(Text(f" {gauges}  (D_c 1, D_e {number(plant.alpha)})"))
        return [fit(line, width) for line in lines]

    def message(self, taps: int) -> list[Text]:
        """Sent, recovered and guessed, one below the other, wrong characters marked with ^."""
        board = self.board
        sent, recovered = board.sent, board.recovered
        room = self.width - LABEL - 2
        start = 0
        if len(sent) > room:
            start = min(max(0, len(recovered) - room * 3 // 4), len(sent) - room)
        notes = [f"{len(recovered)} of {len(sent)} characters"]
        if board.controller is not None:
            its = board.controller
            notes.insert(0, f"{notes[0]}, {its.frame_symbols} of {its.frame_length} symbols")
            done = f"{its.delivered} delivered, {its.queue} queued"
            notes[:0] = [f"{notes[0]}, {done}", f"{notes[1]}, {done}"]
        lines = [self.rule("Message", self.width, *notes)]
        lines.append(row("sent", self._text(sent, start, room)))
        lines.append(row("recovered", self._marked(recovered, sent, start, room)[0]))
        shown = [tap for tap, _ in self.filtered()[:taps]]
        for tap in shown:
            truth = truth_for(board, tap.status.message)
            same = truth == sent
            guess, marks = self._marked(tap.status.message, truth, start if same else 0, room)
            lines.append(row(tap.status.name, guess))
            wrong = f"{marks.plain.count('^')} wrong"
            lines.append(row(wrong if same else f"{wrong}, old", marks))
        if not shown:
            lines += [row("no tap heard", Text()), Text()]
        return lines

    def _text(self, text: str, start: int, room: int) -> Text:
        return Text(printable(text[start : start + room]))

    def _marked(self, text: str, truth: str, start: int, room: int) -> tuple[Text, Text]:
        shown, marks = Text(), Text()
        for i in range(start, min(len(text), start + room)):
            right = i < len(truth) and text[i] == truth[i]
            shown.append(printable(text[i]), style=STYLES["good" if right else "wrong"])
            marks.append(" " if right else "^", style=STYLES["bad"])
        return shown, marks

    def filtered(self) -> list[tuple[TapView, Score]]:
        """The taps that the filter lets through, strongest first."""
        wanted = self.wishes.filter.lower()
        return [pair for pair in self.taps if wanted in pair[0].status.name.lower()]
