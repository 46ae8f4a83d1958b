"""The screen as a pure function: a state, a size and what the user asked for, to a layout.

The panels are regions of rich's `Layout`, each of a height that is known beforehand. The screen is
whole from 80x24 on. On a smaller one whole panels go, in the order of `DROPPED_FIRST`.
"""

import re
from textwrap import wrap
from typing import Final

from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.layout import Layout
from rich.padding import Padding
from rich.panel import Panel
from rich.text import Text

from wyner.dashboard import keymap
from wyner.dashboard.model import State
from wyner.dashboard.panels import Panels, ViewState
from wyner.dashboard.parts import labelled, line, rule, titled
from wyner.dashboard.secrecy_panel import curves, distilled, eavesdroppers, explanation, verdict
from wyner.dashboard.text import count, drawn, in_words, longest, number

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
    "keys: those of both ends, the strongest eavesdropper's below; ^ is a wrong one.",
    "paper's rule: bits that it counts as secret. true: what the best eavesdropper",
    "leaves of them at most. keys found: per cent, [95 % limits, however often you",
    "look]. secret bit/key: -log2 of her chance, at most. texts tried: ways to read",
    "the steps that she keeps. model error: of her A, B. whole at step: when she was",
    "sure of the text. bit/s is a count and her odds are her own: no interval. When",
    "keys were agreed may stay hidden: at most f log2(2N + 1) bit for f widths.",
    "missed: steps whose input did not come in time. wrong keys: the ends differ.",
    "x1 said: the state as it is reported; x1 true: as it is, under an attack.",
    "A small screen drops, in turn: picture; key symbols and automata; taps; loop;",
    "message. `wyner report` draws any step of a run that is over.",
)


_LABEL: Final = re.compile(r" +|\S+(?: \S+)? {2,}")
"""What stands before the text of a line: spaces, or what it is about."""


def _indent(line: str) -> str:
    """What a line goes on below: its text where it has a label."""
    label = _LABEL.match(line)
    return " " * (len(label[0]) if label else 3)


def screen(state: State, width: int, height: int, view: ViewState, now_ns: int) -> RenderableType:
    """What fills ``height`` lines of ``width`` cells."""
    page = _Page(state, width, view, now_ns)
    shown: RenderableType
    if width < SMALLEST[0] or height < SMALLEST[1]:
        small = f"{width}x{height} is too small: {SMALLEST[0]}x{SMALLEST[1]} needed"
        shown = _stacked([(1, line(small)), (1, verdict(page.secrecy, width))], height)
    elif view.help:
        shown = page.help(height)
    else:
        shown = page.whole(height)
    return shown


_BLANK: Final = Text(" ")
"""A region without anything; rich takes an empty text for none."""


def _stacked(regions: list[tuple[int, RenderableType]], height: int) -> Layout:
    """Regions of so many lines each, one below the other; what is left stays blank."""
    left = height
    parts = []
    for wanted, shown in [*regions, (left, _BLANK)]:
        rows = min(wanted, left)
        if rows > 0:
            parts.append(Layout(shown, size=rows))
        left -= rows
    layout = Layout()
    layout.split_column(*parts)
    return layout


class _Page(Panels):
    def whole(self, height: int) -> Layout:
        """The panels that fit, the picture growing with the screen."""
        shown = {"message", "loop", "taps", "key symbols and automata", "picture"}
        if self.width < WHOLE[0]:
            shown.discard("picture")
        if self.view.caption:
            shown.discard("taps")
        for panel in DROPPED_FIRST:
            if self._needed(shown) <= height:
                break
            shown.discard(panel)
        spare = height - self._needed(shown)
        bar = "message" in shown and spare > 0
        spare -= bar
        tap_rows = 1
        if "taps" in shown:
            tap_rows += max(0, min(spare, len(self.taps) - 1, 7))
            spare -= tap_rows - 1
        explained = spare >= 4
        spare -= explained
        tap_messages = 1
        if "message" in shown and spare >= 8:
            tap_messages += max(0, min((spare - 4) // 2, len(self.taps) - 1))
            spare -= 2 * (tap_messages - 1)
        top_extra = max(0, spare) if shown & {"picture", "loop"} else 0
        regions: list[tuple[int, RenderableType]] = [(1, self.header())]
        top = self._top_rows(shown) + top_extra
        if top:
            regions.append((top, self._top(shown, top, top_extra)))
        if "message" in shown:
            regions.append((3 + bar + 2 * tap_messages, self.message(tap_messages, bar=bar)))
        regions += self._secrecy(tap_rows if "taps" in shown else 0, explained=explained)
        if self.view.caption:
            regions.append((self._caption_rows(), self._caption()))
        rows = sum(size for size, _ in regions)
        regions.append((max(0, height - 1 - rows), _BLANK))
        if rows >= height:  # the last line is the footer's, whatever a caption takes
            regions = [(height - 1, _stacked(regions, height - 1))]
        return _stacked([*regions, (1, self.footer())], height)

    def _needed(self, shown: set[str]) -> int:
        rows = 1 + 1 + 3  # header, footer, rule and curves of the secrecy panel
        rows += self._caption_rows() + len(distilled(self.state, self.width))
        return rows + self._top_rows(shown) + 5 * ("message" in shown) + 2 * ("taps" in shown)

    def _caption_lines(self) -> list[str]:
        return [
            row
            for line in self.view.caption[1:]
            for row in wrap(drawn(line), self.width - 2, subsequent_indent=_indent(line))
        ]

    def _caption_rows(self) -> int:
        return 1 + len(self._caption_lines()) if self.view.caption else 0

    def _caption(self) -> Group:
        """A pause of the story, or the end of the run."""
        title = rule(drawn(self.view.caption[0]), self.width)
        return titled(title, *(line(f" {row}") for row in self._caption_lines()))

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
        shown = line(" ", "reverse")
        for part in parts:
            text = Text(part[1])
            text.truncate(least(part) + max(0, left), overflow="ellipsis")
            left -= text.cell_len - least(part)
            shown.append_text(text).append("  ")
        shown.right_crop(2)
        shown.truncate(self.width, pad=True)
        return shown

    def _parts(self) -> list[tuple[int, str]]:
        """What the first line says, each with its rank: the highest goes first."""
        plant, model = self.state.plant, self.state.model
        parts: list[tuple[int, str]] = [(0, self.view.title or "wyner")]
        if plant is None:
            parts.append((0, "waiting for the plant"))
        else:
            if model is not None:
                parts += [
                    (5, drawn(model.scenario)),
                    (4, f"pace {drawn(model.pace)}"),
                    (7, f"alpha {number(model.alpha)}"),
                ]
            known = plant.phase in ("running", "refused")
            phase = plant.phase if known else in_words("plant", plant.phase)
            parts += [(8, f"session {plant.session[:8]}"), (2, phase)]
            if model is not None and model.seeded:
                parts.append((3, "SEEDED: no secret"))
            if plant.frames_refused:
                parts.append((2, f"{count(plant.frames_refused)} frames refused"))
            if plant.attack:
                parts.append((1, f"ATTACK: {drawn(plant.attack)}"))
            if plant.detail:
                parts.append((DETAIL_RANK, drawn(plant.detail)))
        controller = self.state.controller
        if controller is not None and controller.phase != "running":
            parts.append((1, in_words("controller", controller.phase)))
            if controller.detail:
                parts.append((DETAIL_RANK, drawn(controller.detail)))
        if self.view.frozen:
            steps = self.view.held_steps
            parts.append((0, f"FROZEN, {'new session' if steps is None else f'{steps} steps on'}"))
        return parts + [(1, f"{name} silent") for name in self._silent()]

    def _silent(self) -> list[str]:
        """Who is not heard any more, and has not said that it stops."""
        plant, controller = self.state.plant, self.state.controller
        seen: dict[str, int | None] = {}
        if plant is not None and plant.phase != "stopped":
            seen["plant"] = self.state.plant_seen_ns
        if controller is not None and controller.phase != "stopped":
            seen["controller"] = self.state.controller_seen_ns
        if self.state.taps:
            seen["tap"] = max(tap.seen_ns for tap in self.state.taps.values())
        return [
            name
            for name, at in seen.items()
            if at is not None and self.now_ns - at > SILENT_AFTER_NS
        ]

    def footer(self) -> Text:
        """One line: how to go on, a note, or the keys."""
        if self.view.caption and not self.view.note:
            shown = line(f" {self.view.press}", "reverse")
            shown.truncate(self.width, pad=True)
            return shown
        if self.view.note:
            return line(f" {self.view.note}", "bold")
        messages = f"{count(self.state.received)} messages"
        malformed = f"{count(self.state.malformed)} malformed"
        tails = (f"{messages}, {malformed}", malformed) if self.state.malformed else (messages,)
        keys = self._keys(named=self.width >= FOOTER_NAMED)
        if self.state.malformed and keys.cell_len + len(malformed) + 2 > self.width:
            keys = self._keys(named=False, room=self.width - len(malformed) - 2)
        tail = longest(self.width - keys.cell_len - 2, *tails)
        if tail:
            keys.append(tail.rjust(self.width - keys.cell_len - 1), style="dim")
        return keys

    def _keys(self, *, named: bool, room: int | None = None) -> Text:
        keys = line()
        for key in keymap.KEYS:
            if not key.short or (room is not None and keys.cell_len + len(key.label) + 3 > room):
                continue
            keys.append(f" {key.label} ", style="reverse")
            held = key.action is keymap.Action.FREEZE and self.view.frozen
            keys.append(f" {'go on' if held else key.short}  " if named else " ")
        return keys

    def _top(self, shown: set[str], rows: int, extra: int) -> Layout:
        picture = "picture" in shown
        left_width = 40 if self.width < 100 else min(54, self.width // 2 - 6)
        width = left_width if picture else self.width
        regions: list[tuple[int, RenderableType]] = []
        left = rows
        if "loop" in shown:
            regions.append(self.loop(width, min(extra, MORE_LOOP)))
            left -= regions[0][0]
        if "key symbols and automata" in shown:
            regions.append((4, self.keys(width)))
            left -= 4
        if left >= 4 and picture:
            regions.append((left, self.last_steps(width, left)))
        panels = _stacked(regions, rows)
        if not picture:
            return panels
        panels.size = left_width + 1
        top = Layout()
        drawn = self.picture(self.width - left_width - 1, rows)
        beside = Layout(Padding(panels, (0, 1, 0, 0)), size=left_width + 1)
        top.split_row(beside, Layout(drawn))
        return top

    def _secrecy(self, taps: int, *, explained: bool) -> list[tuple[int, RenderableType]]:
        """What the paper's rule counts against the truth, and a table of the taps, best first."""
        note = ""
        if 0 < taps < len(self.taps):
            note = f"the strongest {taps} of {len(self.taps)} eavesdroppers"
        rows = curves(self.state, self.secrecy, self.width)
        rows += distilled(self.state, self.width)
        regions: list[tuple[int, RenderableType]] = [
            (1 + len(rows), titled(rule("Secrecy", self.width, note), labelled(rows)))
        ]
        if taps:
            found = eavesdroppers(self.state, self.taps[:taps], self.width)
            regions.append((1 + max(1, min(taps, len(self.taps))), Padding(found, (0, 0, 0, 1))))
        if explained:
            regions.append((1, explanation(self.secrecy, self.width)))
        return regions

    def help(self, height: int) -> Layout:
        """The keys from their table, then how to read the screen."""
        keys = labelled((key.label, line(key.meaning)) for key in keymap.KEYS)
        reading = Group(*map(line, HELP))
        regions: list[tuple[int, RenderableType]] = [
            (len(keymap.KEYS) + 2, Panel(keys, title="Keys", title_align="left", padding=0)),
            (
                len(HELP) + 1,
                titled(rule("How to read it", self.width), Padding(reading, (0, 0, 0, 1))),
            ),
        ]
        return _stacked([(height - 1, _stacked(regions, height - 1)), (1, self.footer())], height)
