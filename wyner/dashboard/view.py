"""The screen as a pure function: a board, a size and what the user asked for, to lines of text.

Every line is made here to its exact width, so that what a test compares is what a user sees. The
screen is whole from 80x24 on. On a smaller one whole panels go, in the order of `DROPPED_FIRST`.
"""

from textwrap import wrap
from typing import Final

from rich.cells import cell_len
from rich.text import Text

from wyner.dashboard import keymap
from wyner.dashboard.detail import detail
from wyner.dashboard.model import Board
from wyner.dashboard.panels import Panels, ViewState
from wyner.dashboard.secrecy_panel import curves, distilled, explanation, table, verdict
from wyner.dashboard.text import count, drawn, fit, in_ascii, longest, number, row

__all__ = ["DROPPED_FIRST", "HELP", "SILENT_AFTER_NS", "SMALLEST", "WHOLE", "ViewState", "screen"]

WHOLE: Final = (80, 24)
"""The size, columns and rows, from which every panel is shown."""

SMALLEST: Final = (40, 8)
"""Below this only a line that says so is shown, and the secrecy verdict."""

DROPPED_FIRST: Final = ("picture", "key symbols and automata", "taps", "loop", "message")
"""Panels that a small screen does without, in turn; the secrecy verdict always stays."""

SILENT_AFTER_NS: Final = 2_000_000_000
"""A service that has not been heard for this long is called silent."""

DETAIL_AT_LEAST: Final = 12
"""Cells to which a reason in the first line is cut; it gets more where there is room."""

DETAIL_RANK: Final = 6
"""Where a reason stands among the parts of the first line, of which the highest goes first."""

MORE_LOOP: Final = 4
"""Rows that the panel of the loop takes of those to spare; the last steps have the others."""

FOOTER_NAMED: Final = 72
"""From this width on the last line says what its keys do; ? always does."""

HELP: Final = (
    "Bars: how far the next state lies from where each input would have led: up to",
    "the edge of D_c (1), then of D_e = alpha D_c. A key is agreed when one bar",
    "alone ends in D_c and none beyond D_e. Below: the same in the plane of states.",
    "keys: true key symbols, the strongest tap's below; ^ stands under wrong ones.",
    "paper's rule: bits that it counts as secret. true: what the best tap leaves at",
    "most. keys found: [95 %, however often one looks]. bits left: of a key, -log2",
    "of her chance, at most. A bit/s is a count: no interval. readings: those kept.",
    "model error: her A, B, relative. text read: characters right. whole at step:",
    "when she was sure of it. When keys were agreed may stay hidden: at most",
    "log2(2N + 1) bit in N steps. A small screen drops, in turn: picture; key",
    "symbols and automata; taps; loop; message. It is whole from 80x24 on.",
)


def screen(board: Board, width: int, height: int, wishes: ViewState, now_ns: int) -> list[Text]:
    """Exactly ``height`` lines of ``width`` cells each."""
    page = _Page(board, width, wishes, now_ns)
    if width < SMALLEST[0] or height < SMALLEST[1]:
        lines = [
            Text(f"{width}x{height} is too small: {SMALLEST[0]}x{SMALLEST[1]} needed"),
            verdict(page.secrecy, width),
        ]
    elif wishes.help:
        lines = page.help(height)
    elif wishes.detail:
        lines = page.detail(height)
    else:
        lines = page.whole(height)
    lines = [fit(line, width) for line in lines[:height]]
    if not wishes.unicode:
        lines = [in_ascii(line) for line in lines]
    return lines + [fit(Text(), width)] * (height - len(lines))


class _Page(Panels):
    def whole(self, height: int) -> list[Text]:
        """The panels that fit, the picture growing with the screen."""
        shown = {"message", "loop", "taps", "key symbols and automata", "picture"}
        if self.width < WHOLE[0]:
            shown.discard("picture")
        if self.wishes.caption:
            shown.discard("taps")
        for panel in DROPPED_FIRST:
            if self._needed(shown) <= height:
                break
            shown.discard(panel)
        spare = height - self._needed(shown)
        tap_rows = 1
        if "taps" in shown:
            tap_rows += max(0, min(spare, len(self.filtered()) - 1, 7))
            spare -= tap_rows - 1
        explained = spare >= 4
        spare -= explained
        tap_messages = 1
        if "message" in shown and spare >= 8:
            tap_messages += max(0, min((spare - 4) // 2, len(self.filtered()) - 1))
            spare -= 2 * (tap_messages - 1)
        top_extra = max(0, spare) if shown & {"picture", "loop"} else 0
        lines = [self.header()]
        lines += self._top(shown, top_extra)
        if "message" in shown:
            lines += self.message(tap_messages)
        lines += self.secrecy_panel("taps" in shown, tap_rows, explained)
        lines += self._caption()
        lines += [Text()] * (height - 1 - len(lines))
        return [*lines[: height - 1], self.footer()]

    def _needed(self, shown: set[str]) -> int:
        rows = 1 + 1 + 3  # header, footer, rule and curves of the secrecy panel
        rows += len(self._caption()) + len(distilled(self.board, self.width))
        return rows + self._top_rows(shown) + 5 * ("message" in shown) + 2 * ("taps" in shown)

    def _caption(self) -> list[Text]:
        """A pause of the story, or the end of the run: a title and its lines."""
        if not self.wishes.caption:
            return []
        title, *lines = self.wishes.caption
        shown = (wrap(drawn(line), self.width - 2, subsequent_indent="   ") for line in lines)
        return [
            self.rule(drawn(title), self.width),
            *(Text(f" {row}") for rows in shown for row in rows),
        ]

    def _top_rows(self, shown: set[str]) -> int:
        return 5 * ("loop" in shown) + 4 * ("key symbols and automata" in shown)

    def header(self) -> Text:
        """One line: what is watched and how it is; the less telling parts go where it is narrow."""
        parts = self._parts()

        def least(part: tuple[int, str]) -> int:
            rank, text = part
            return min(cell_len(text), DETAIL_AT_LEAST) if rank == DETAIL_RANK else cell_len(text)

        def spare() -> int:
            return self.width - sum(2 + least(part) for part in parts)

        while len(parts) > 1 and spare() < 0:
            parts.remove(max(parts, key=lambda part: part[0]))
        left = spare()
        line = Text(" ")
        for part in parts:
            text = fit(Text(part[1]), min(cell_len(part[1]), least(part) + max(0, left)))
            left -= text.cell_len - least(part)
            line.append_text(text)
            line.append("  ")
        return fit(line[:-2], self.width, style="reverse")

    def _parts(self) -> list[tuple[int, str]]:
        """What the first line says, each with its rank: the highest goes first."""
        plant, model = self.board.plant, self.board.model
        parts: list[tuple[int, str]] = [(0, self.wishes.title or "wyner")]
        if plant is None:
            parts.append((0, "waiting for the plant"))
        else:
            if model is not None:
                parts += [
                    (5, drawn(model.scenario)),
                    (4, drawn(model.pace)),
                    (7, f"alpha {number(model.alpha)}"),
                ]
            parts += [(8, f"session {plant.session[:8]}"), (2, plant.phase)]
            if model is not None and model.seeded:
                parts.append((3, "SEEDED"))
            if plant.frames_refused:
                parts.append((2, f"{count(plant.frames_refused)} frames refused"))
            if plant.attack:
                parts.append((1, f"ATTACK: {drawn(plant.attack)}"))
            if plant.detail:
                parts.append((DETAIL_RANK, drawn(plant.detail)))
        controller = self.board.controller
        if controller is not None and controller.phase != "running":
            parts.append((1, f"controller {controller.phase}"))
            if controller.detail:
                parts.append((DETAIL_RANK, drawn(controller.detail)))
        if self.wishes.frozen:
            steps = self.wishes.held_steps
            parts.append((0, f"FROZEN, {'new session' if steps is None else f'{steps} steps on'}"))
        return parts + [(1, f"{name} silent") for name in self._silent()]

    def _silent(self) -> list[str]:
        seen = {
            "plant": self.board.plant_seen_ns if self.board.plant else None,
            "controller": self.board.controller_seen_ns if self.board.controller else None,
        }
        if self.board.taps:
            seen["tap"] = max(tap.seen_ns for tap in self.board.taps.values())
        return [
            name
            for name, at in seen.items()
            if at is not None and self.now_ns - at > SILENT_AFTER_NS
        ]

    def footer(self) -> Text:
        """One line: the filter being typed, a note, or the keys."""
        if self.wishes.caption and not self.wishes.note:
            return Text(f" {self.wishes.press}", style="reverse")
        if self.wishes.typing:
            return Text(f" show taps whose name holds: {drawn(self.wishes.filter)}_")
        if self.wishes.note:
            return Text(f" {self.wishes.note}", style="bold")
        messages = f"{count(self.board.received)} messages"
        malformed = f"{count(self.board.malformed)} malformed"
        tails = (f"{messages}, {malformed}", malformed) if self.board.malformed else (messages,)
        line = self._keys(named=self.width >= FOOTER_NAMED)
        if self.board.malformed and line.cell_len + len(malformed) + 2 > self.width:
            line = self._keys(named=False, room=self.width - len(malformed) - 2)
        tail = longest(self.width - line.cell_len - 2, *tails)
        if tail:
            line.append(tail.rjust(self.width - line.cell_len - 1), style="dim")
        return line

    def _keys(self, *, named: bool, room: int | None = None) -> Text:
        line = Text()
        for key in keymap.KEYS:
            if not key.short or (room is not None and line.cell_len + len(key.label) + 3 > room):
                continue
            line.append(f" {key.label} ", style="reverse")
            held = key.action is keymap.Action.FREEZE and self.wishes.frozen
            line.append(f" {'go on' if held else key.short}  " if named else " ")
        return line

    def _top(self, shown: set[str], extra: int) -> list[Text]:
        rows = self._top_rows(shown) + extra
        if rows == 0:
            return []
        picture = "picture" in shown
        left_width = 40 if self.width < 100 else min(54, self.width // 2 - 6)
        width = left_width if picture else self.width
        left: list[Text] = []
        if "loop" in shown:
            left += self.loop(width, min(extra, MORE_LOOP))
        if "key symbols and automata" in shown:
            left += self.keys(width)
        if rows - len(left) >= 4 and picture:
            left += self.last_steps(width, rows - len(left))
        left = left[:rows] + [Text()] * (rows - len(left))
        if not picture:
            return left
        right = self.picture(self.width - left_width - 1, rows)
        return [Text.assemble(fit(a, left_width), " ", b) for a, b in zip(left, right, strict=True)]

    def secrecy_panel(self, with_table: bool, rows: int, explained: bool) -> list[Text]:
        """What the paper's rule counts against the truth, and a table of the taps, best first."""
        shown = self.filtered()
        note = ""
        if self.wishes.filter:
            note = f"/{drawn(self.wishes.filter)}: {len(shown)} of {len(self.taps)} taps"
        elif len(shown) > rows and with_table:
            note = f"the strongest {rows} of {len(shown)} taps"
        lines = [self.rule("Secrecy", self.width, note)]
        lines += curves(self.board, self.secrecy, self.width, self.glyphs)
        lines += distilled(self.board, self.width)
        if with_table:
            lines += table(self.board, shown[:rows], self.width, self.wishes.tap)
        if explained:
            lines.append(explanation(self.secrecy, self.width))
        return lines

    def detail(self, height: int) -> list[Text]:
        """The chosen step and tap."""
        chosen = next((p for p in self.taps if p[0].status.name == self.wishes.tap), None)
        if chosen is None and self.filtered():
            chosen = self.filtered()[0]
        lines = [self.header()]
        lines += detail(
            self.board, self.wishes.step, chosen, self.filtered(), self.width, self.glyphs
        )
        lines += [Text()] * (height - 1 - len(lines))
        return [*lines[: height - 1], self.footer()]

    def help(self, height: int) -> list[Text]:
        """The keys from their table, then how to read the screen."""
        lines = [self.rule("Keys", self.width)]
        lines += [row(f"   {key.label}", Text(key.meaning)) for key in keymap.KEYS]
        lines.append(self.rule("How to read it", self.width))
        lines += [Text(f" {line}") for line in HELP]
        return [*lines[: height - 1], self.footer()]
