"""Mermaid's diagrams as SVG, as far as the documents use them: the site needs no script for them.

Read are sequence diagrams (participants, messages, notes, `par`) and state diagrams from left to
right. Anything else is an error, so that no diagram is left out in silence.
"""

import re
from collections.abc import Iterable, Sequence
from html import escape
from itertools import pairwise
from typing import Final, NamedTuple

CHARACTER: Final = 7.0
"""Width that a character of a label is given, in pixels; more than it takes."""
LINE: Final = 17
"""Height of a line of text."""
AIR: Final = 16

STYLE: Final = (
    "font: 13px system-ui, sans-serif; fill: currentColor; stroke: none; max-width: 100%; "
    "height: auto; display: block; margin: 1em auto"
)
LINES: Final = 'fill="none" stroke="currentColor"'
HEAD: Final = (
    '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
    'orient="auto-start-reverse"><path d="M0 0L8 4L0 8z" fill="currentColor" stroke="none"/>'
    "</marker></defs>"
)


class DiagramError(ValueError):
    """A diagram that cannot be drawn; the message names the line."""


def drawn(source: str) -> str:
    """A diagram's source as one SVG element.

    Raises
    ------
    DiagramError
        When it has a line that is not understood.
    """
    kind, *lines = [line.strip() for line in source.splitlines() if line.strip()] or [""]
    if kind == "sequenceDiagram":
        return _sequence(lines)
    if kind == "stateDiagram-v2":
        return _states(lines)
    raise DiagramError(f"got {kind!r}, expected sequenceDiagram or stateDiagram-v2")


def _text(x: float, y: float, rows: Sequence[str], anchor: str = "middle") -> str:
    """Rows of text, the first one's foot at ``y``."""
    return "".join(
        f'<text x="{x:g}" y="{y + LINE * i:g}" text-anchor="{anchor}">{escape(row)}</text>'
        for i, row in enumerate(rows)
    )


def _width(rows: Iterable[str]) -> float:
    return CHARACTER * max(len(row) for row in rows)


def _svg(width: float, height: float, label: str, parts: Iterable[str]) -> str:
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" role="img" '
        f'aria-label="{escape(label)}" style="{STYLE}">{HEAD}{"".join(parts)}</svg>'
    )


# --- sequences ------------------------------------------------------------------------------------

_PARTICIPANT: Final = re.compile(r"participant (\w+) as (.+)")
_MESSAGE: Final = re.compile(r"(\w+)(--?)>>(\w+): (.+)")
_NOTE: Final = re.compile(r"Note over (\w+): (.+)")


def _sequence(lines: Sequence[str]) -> str:
    names: dict[str, str] = {}
    steps: list[tuple[str, ...]] = []
    for line in lines:
        if found := _PARTICIPANT.fullmatch(line):
            names[found[1]] = found[2]
        elif found := _MESSAGE.fullmatch(line):
            steps.append(("message", *found.groups()))
        elif found := _NOTE.fullmatch(line):
            steps.append(("note", *found.groups()))
        elif line.startswith("par ") or line in ("and", "end"):
            steps.append((line.split()[0], line.partition(" ")[2]))
        else:
            raise DiagramError(f"got {line!r}, expected a participant, a message, a note or par")
    x = _columns(names, steps)
    left, right = AIR / 2, max(x.values()) + _half(names, steps, list(names)[-1]) + AIR / 2
    y = 2.0 * LINE
    parts = [_text(x[name], LINE, [title]) for name, title in names.items()]
    frame = 0.0
    for step in steps:
        match step:
            case ("message", sender, dash, receiver, text):
                y += 2 * LINE
                parts.append(_text((x[sender] + x[receiver]) / 2, y - 5, [text]))
                dashes = ' stroke-dasharray="5 3"' if dash == "--" else ""
                parts.append(
                    f'<path {LINES}{dashes} marker-end="url(#head)" '
                    f'd="M{x[sender]:g} {y:g}H{x[receiver]:g}"/>'
                )
            case ("note", who, text):
                rows = text.split("<br/>")
                wide, high = _width(rows) + AIR, LINE * len(rows) + AIR / 2
                y += AIR
                parts.append(
                    f'<rect x="{x[who] - wide / 2:g}" y="{y:g}" width="{wide:g}" '
                    f'height="{high:g}" style="fill: var(--color-background-primary, #fff); '
                    'stroke: currentColor"/>'
                )
                parts.append(_text(x[who], y + LINE, rows))
                y += high
            case ("par", text):
                y += AIR
                frame = y
                parts.append(_text(left + 8, y + LINE, [f"at once, {text}"], "start"))
                y += LINE
            case ("and", _):
                y += AIR
                parts.append(
                    f'<path {LINES} stroke-dasharray="2 3" d="M{left:g} {y:g}H{right:g}"/>'
                )
            case _:
                y += AIR
                parts.append(
                    f'<rect {LINES} x="{left:g}" y="{frame:g}" width="{right - left:g}" '
                    f'height="{y - frame:g}"/>'
                )
    foot = y + AIR
    lives = [
        f'<path {LINES} stroke-opacity=".4" d="M{at:g} {LINE + 6}V{foot:g}"/>' for at in x.values()
    ]
    return _svg(right + AIR / 2, foot + AIR / 2, "a sequence of messages", [*lives, *parts])


def _half(names: dict[str, str], steps: Sequence[tuple[str, ...]], who: str) -> float:
    """Half of the widest thing that stands over a participant."""
    rows = [row for s in steps if s[0] == "note" and s[1] == who for row in s[2].split("<br/>")]
    return (_width([names[who], *rows]) + AIR) / 2


def _columns(names: dict[str, str], steps: Sequence[tuple[str, ...]]) -> dict[str, float]:
    """Where each participant stands: so far apart that notes and messages have room."""
    order = list(names)
    at = AIR / 2 + AIR + _half(names, steps, order[0])
    x = {order[0]: at}
    for before, name in pairwise(order):
        texts = [s[4] for s in steps if s[0] == "message" and {s[1], s[3]} == {before, name}]
        room = _half(names, steps, before) + _half(names, steps, name) + AIR
        at += max([room, *(_width([text]) + 2 * AIR for text in texts)])
        x[name] = at
    return x


# --- states ---------------------------------------------------------------------------------------

_BEGIN: Final = re.compile(r"\[\*\] --> (\w+)")
_STATE: Final = re.compile(r"(\w+) : (.+)")
_ARROW: Final = re.compile(r"(\w+) --> (\w+) : (.+)")

RADIUS: Final = 30


class _Arrow(NamedTuple):
    start: str
    end: str
    rows: list[str]


def _states(lines: Sequence[str]) -> str:
    names: dict[str, str] = {}
    arrows: list[_Arrow] = []
    begin = ""
    for line in lines:
        if found := _BEGIN.fullmatch(line):
            begin = found[1]
        elif found := _ARROW.fullmatch(line):
            arrows.append(_Arrow(found[1], found[2], found[3].split("<br/>")))
        elif found := _STATE.fullmatch(line):
            names[found[1]] = found[2]
        elif line != "direction LR":
            raise DiagramError(f"got {line!r}, expected a state or an arrow, from left to right")
    order = list(names)
    own = {name: [a.rows for a in arrows if a.start == a.end == name] for name in order}
    half = {n: max([2.5 * RADIUS, *(_width(rows) / 2 for rows in own[n])]) for n in order}
    between = max(_width(a.rows) for a in arrows if a.start != a.end) + 3 * RADIUS
    x, at = {}, AIR + half[order[0]]
    x[order[0]] = at
    for before, name in pairwise(order):
        at += max(between, half[before] + half[name] + AIR)
        x[name] = at
    level = 9.5 * LINE
    parts = []
    for name, title in names.items():
        parts.append(f'<circle {LINES} cx="{x[name]:g}" cy="{level:g}" r="{RADIUS}"/>')
        parts.append(_text(x[name], level + 4, [title]))
    if begin:
        start = x[begin] - 2.2 * RADIUS
        parts.append(f'<circle cx="{start:g}" cy="{level:g}" r="5"/>')
        parts.append(
            f'<path {LINES} marker-end="url(#head)" '
            f'd="M{start + 5:g} {level:g}H{x[begin] - RADIUS:g}"/>'
        )
    for arrow in arrows:
        parts += _arrow(arrow, x, level)
    width = max(x[n] + half[n] for n in order) + AIR
    return _svg(width, level + 6.5 * LINE, "states and what leads from one to another", parts)


def _arrow(a: _Arrow, x: dict[str, float], level: float) -> list[str]:
    """An arrow forwards above the states, one backwards below them, one to itself as a loop."""
    one, other, r = x[a.start], x[a.end], RADIUS
    if a.start == a.end:
        top = level - 0.9 * r
        d = f"M{one - 0.45 * r:g} {top:g}C{one - r:g} {top - 70:g} {one + r:g} {top - 70:g} "
        d += f"{one + 0.45 * r:g} {top:g}"
        label = _text(one, top - 59 - LINE * (len(a.rows) - 1), a.rows)
    else:
        way = 1 if other > one else -1
        side = level - way * 0.6 * r
        far = side - way * 40
        d = f"M{one + way * 0.8 * r:g} {side:g}Q{(one + other) / 2:g} {far:g} "
        d += f"{other - way * 0.8 * r:g} {side:g}"
        near = (side + far) / 2
        above = near - 6 - LINE * (len(a.rows) - 1)
        label = _text((one + other) / 2, above if way > 0 else near + LINE, a.rows)
    return [f'<path {LINES} marker-end="url(#head)" d="{d}"/>', label]
