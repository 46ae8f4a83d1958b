"""Diagrams and tables of the documents, made from what the programs use.

``python -m tools.diagrams --write`` puts them between their markers in docs/architecture.md,
docs/protocol.md and docs/guides.md; a test says when they are stale.
"""

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.link import controller_session as controllers
from protocol.link import plant_session as plants
from protocol.link.distiller import BlockEnded
from protocol.link.events import (
    Alarm,
    AttackBegan,
    Interrupted,
    Missed,
    PowerFailed,
    SessionBegan,
    Timing,
)
from protocol.link.key_events import Appearances
from protocol.link.session import CountedTransition
from protocol.messages import ADVERSARY, FIELD, MANAGEMENT, Message, SendCommand
from protocol.schemes.base import Scheme
from protocol.schemes.registry import SCHEMES, make_scheme, scheme_named
from protocol.topics import key_of
from runtime.errors import DONE, USAGE
from runtime.files import PUBLIC_FILE, write_atomically
from wyner.runs.check import RULES
from wyner.runs.seal import READ, SEAL_ALONE

DOCUMENT: Final = Path(__file__).resolve().parents[1] / "docs" / "architecture.md"
PROTOCOL: Final = DOCUMENT.with_name("protocol.md")
GUIDES: Final = DOCUMENT.with_name("guides.md")

_MARKED: Final = re.compile(
    r"(?P<begin><!-- generated: (?P<name>[a-z-]+) -->\n).*?(?P<end><!-- end -->)", re.DOTALL
)


AGREED: Final = "agreed"
NOT_AGREED: Final = "not agreed"


class Arrow(NamedTuple):
    """What a scheme does in state ``s`` on a verdict: the next state, and what both ends do."""

    s: int
    event: str
    following: int
    action: str


def arrows_of(scheme: Scheme[Any]) -> list[Arrow]:
    """Every arrow of a scheme, in order of appearance from its initial state."""
    found: dict[Arrow, None] = {}
    reached, waiting = {scheme.initial}, [scheme.initial]
    while waiting:
        state = waiting.pop(0)
        for verdict in (*range(scheme.alphabet), NO_SYMBOL):
            after, carry = scheme.advance(state, verdict)
            action = ["m[p] = c - key"] if carry.pad != NO_SYMBOL else []
            action += ["keep the key"] if carry.agreed != NO_SYMBOL else []
            action += ["next c = m[p] + key" if scheme.pad(after) != NO_SYMBOL else "next c random"]
            event = NOT_AGREED if verdict == NO_SYMBOL else AGREED
            found[Arrow(state[0], event, after[0], ", ".join(action))] = None
            if after not in reached:
                reached.add(after)
                waiting.append(after)
    return list(found)


def state_diagram(scheme: Scheme[Any]) -> str:
    """A scheme as a Mermaid state diagram; arrows between the same states share a line."""
    drawn: dict[tuple[int, int, str], list[str]] = {}
    for arrow in arrows_of(scheme):
        drawn.setdefault((arrow.s, arrow.following, arrow.action), []).append(arrow.event)
    lines = ["```mermaid", "stateDiagram-v2", "    direction LR"]
    lines.append(f"    [*] --> s{scheme.initial[0]}")
    lines += [f"    s{s} : s = {s}" for s in sorted({s for s, _, _ in drawn})]
    for (s, following, action), events in drawn.items():
        event = "always" if len(events) == 2 else events[0]
        lines.append(f"    s{s} --> s{following} : {event}<br/>{action}")
    return "\n".join([*lines, "```", ""])


def _drawing(name: str) -> Callable[[], str]:
    return lambda: state_diagram(make_scheme(name, 2))


def wire_table(kinds: Sequence[type[Message]]) -> str:
    """Messages of a bus: the key they travel on, and their fields."""
    lines = ["| message | key | fields |", "|---|---|---|"]
    for kind in kinds:
        fields = ", ".join(f"`{name}`" for name in kind.model_fields)
        lines.append(f"| `{kind.__name__}` | `{key_of(kind, 'LOOP')}` | {fields} |")
    return "\n".join([*lines, ""])


def session_table(table: dict[Any, Any]) -> str:
    """What comes of what happens to an end, state by state."""
    columns = [state for state in dict.fromkeys(state for state, _ in table) if state != "refused"]
    lines = ["| what happens, in state | " + " | ".join(f"*{state}*" for state in columns) + " |"]
    lines.append("|---|" + "---|" * len(columns))
    for what in dict.fromkeys(what for _, what in table):
        cells = [_cell(state, table[state, what]) for state in columns]
        lines.append(f"| {what} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def plant_session() -> str:
    """The plant's."""
    return session_table(plants.TABLE)


def controller_session() -> str:
    """The controller's."""
    return session_table(controllers.TABLE)


def _cell(state: str, row: tuple[str, str]) -> str:
    """A row of the table: the answer, and the next state where it is another one."""
    answer, following = row
    words = ["" if answer == "nothing" else f"**{answer}**"]
    words.append("" if following == state else f"*{following}*")
    return ", ".join(filter(None, words)) or "–"


def check_table() -> str:
    """The rules of `wyner check`: where each comes from, and what must hold."""
    lines = ["| rule | source | what must hold |", "|---|---|---|"]
    lines += [f"| {rule.name} | {rule.source} | {rule.says} |" for rule in RULES]
    return "\n".join([*lines, ""])


def evidence_table() -> str:
    """The files of a run's folder that are evidence, and what holds them to what they were."""
    held = {"rules that read them, and the seal": READ, "the seal alone": SEAL_ALONE}
    lines = ["| held by | files |", "|---|---|"]
    lines += [f"| {by} | {', '.join(f'`{one}`' for one in files)} |" for by, files in held.items()]
    return "\n".join([*lines, ""])


EVENTS: Final[tuple[tuple[str, Callable[..., Any], Any], ...]] = (
    ("both", CountedTransition.as_event, CountedTransition),
    ("both", CountedTransition.report, CountedTransition.report),
    ("plant", Missed.as_event, Missed),
    ("plant", Interrupted.as_event, Interrupted),
    ("both", SessionBegan.as_event, SessionBegan),
    ("plant", AttackBegan.as_event, AttackBegan),
    ("both", PowerFailed.as_event, PowerFailed),
    ("controller", Alarm.as_event, Alarm),
    ("controller", SendCommand.as_event, SendCommand),
    ("plant", Timing.as_event, Timing),
    ("both", BlockEnded.as_event, BlockEnded),
    ("both", Appearances.as_event, Appearances),
)
"""What a trace holds: who writes it, what makes the line, and what says what it is."""


def event_fields(line: Callable[..., Any], kind: Any) -> list[str]:
    """The names in a trace's line of this kind, ``event`` first, as its source gives them."""
    named: list[str] = []
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(line)))):
        if isinstance(node, ast.Dict):
            named += [str(key.value) for key in node.keys if isinstance(key, ast.Constant)]
        elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
            named.append(str(node.slice.value))
        elif isinstance(node, ast.Attribute) and node.attr == "_asdict":
            named += [name for name in vars(kind)["_fields"] if name != "truth"]
    return list(dict.fromkeys(named))


def event_names(line: Callable[..., Any]) -> list[str]:
    """What a trace's lines of this kind call themselves."""
    found = re.findall(r'"event": "(\w+)"', inspect.getsource(line))
    if not found:
        raise ValueError(f"{line.__qualname__}: expected the event's name in its source")
    return found


def event_table() -> str:
    """The lines of a trace: who writes them, their fields, and what their class says of them."""
    lines = ["| event | of | fields | what it says |", "|---|---|---|---|"]
    for side, line, kind in EVENTS:
        fields = ", ".join(f"`{name}`" for name in event_fields(line, kind) if name != "event")
        about = (inspect.getdoc(kind) or "").split("\n\nParameters")[0]
        said = " ".join(about.split()).replace("``", "`")
        names = ", ".join(f"`{name}`" for name in event_names(line))
        lines.append(f"| {names} | {side} | {fields} | {said} |")
    return "\n".join([*lines, ""])


ROOMS: Final = (
    "protocol",
    "runtime",
    "controller_service",
    "plant_service",
    "tap_service",
    "attacker_service",
    "wyner",
    "studies",
)
"""The importable names, each of which imports those above it at most."""


def rooms() -> str:
    """The folders of code, each with the first line of what its package says of itself."""
    lines = ["```text"]
    for room in ROOMS:
        for package in sorted((DOCUMENT.parents[1] / room).rglob("__init__.py")):
            folder = package.parent.relative_to(DOCUMENT.parents[1])
            said = ast.get_docstring(ast.parse(package.read_text(encoding="utf-8"))) or ""
            name = "  " * (len(folder.parts) - 1) + folder.name + "/"
            lines.append(f"{name:<22} {said.splitlines()[0]}")
    return "\n".join([*lines, "```", ""])


DRAWN: Final = tuple(name for name in SCHEMES if not scheme_named(name).corrects)
"""Schemes whose states are few; one that corrects has a state for each word."""

PARTS: Final[dict[str, Callable[[], str]]] = {
    "rooms": rooms,
    **{name: _drawing(name) for name in DRAWN},
    "field": lambda: wire_table(FIELD),
    "management": lambda: wire_table(MANAGEMENT),
    "adversary": lambda: wire_table(ADVERSARY),
}
"""Of docs/architecture.md."""

PROTOCOL_PARTS: Final[dict[str, Callable[[], str]]] = {
    "plant-session": plant_session,
    "controller-session": controller_session,
    "checks": check_table,
}
"""Of docs/protocol.md."""

GUIDES_PARTS: Final[dict[str, Callable[[], str]]] = {
    "events": event_table,
    "evidence": evidence_table,
}
"""Of docs/guides.md."""

DOCUMENTS: Final = {
    DOCUMENT: PARTS,
    PROTOCOL: PROTOCOL_PARTS,
    GUIDES: GUIDES_PARTS,
}


def refreshed(text: str, parts: dict[str, Callable[[], str]] = PARTS) -> str:
    """``text`` with every marked part made anew.

    Raises
    ------
    ValueError
        When a marker names no part, or a part has no marker.
    """
    names = [match["name"] for match in _MARKED.finditer(text)]
    if sorted(names) != sorted(parts):
        lines = "".join(
            f"; add <!-- generated: {name} --> and <!-- end --> where it shall stand"
            for name in sorted(set(parts) - set(names))
        )
        raise ValueError(f"markers: got {sorted(names)}, expected {sorted(parts)}{lines}")
    return _MARKED.sub(lambda m: m["begin"] + parts[m["name"]]() + m["end"], text)


def main(argv: Sequence[str]) -> int:
    """Print the parts, or write them into the documents."""
    if list(argv) == ["--write"]:
        for document, parts in DOCUMENTS.items():
            text = document.read_text(encoding="utf-8")
            try:
                written = refreshed(text, parts)
            except ValueError as error:
                print(f"{document.name}: {error}", file=sys.stderr)
                return USAGE
            write_atomically(document, written.encode(), PUBLIC_FILE)
        return DONE
    if argv:
        print("usage: python -m tools.diagrams [--write]", file=sys.stderr)
        return USAGE
    for parts in DOCUMENTS.values():
        for name, part in parts.items():
            print(f"{name}\n\n{part()}")
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
